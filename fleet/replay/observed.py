"""observe.json, which a run with --publish writes: where to subscribe, and as which user."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec

from netem.private_file import parse_json
from netem.whole_file import read_file

_MOST_BYTES = 100_000


class Observed(msgspec.Struct):
    """The content of observe.json."""

    endpoint: str
    user: str
    password: str
    run: Annotated[str, msgspec.Meta(pattern=r"^[\w-]+$")]


def read_observed(path: Path) -> Observed:
    """Read observe.json.

    Raises:
        OSError: it cannot be read.
        DamagedFile: it holds something else.
    """
    return parse_json(read_file(path, _MOST_BYTES), Observed)
