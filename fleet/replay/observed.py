"""observe.json, which a run with --publish writes: where to subscribe, and as which user."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from netem.files import read_json
from netem.limits import OBSERVED
from netem.private_folder import PrivateFolder
from netem.whole_file import write_whole
from netem.wire.credentials import OBSERVER, Credentials
from netem.wire.keys import Keys

if TYPE_CHECKING:
    from netem.wire.open_bus import OpenBus


class Observed(msgspec.Struct):
    """The content of observe.json."""

    endpoint: str
    user: str
    password: str
    run: Annotated[str, msgspec.Meta(pattern=r"^[\w-]+$")]


def read_observed(path: Path) -> Observed:
    """Read observe.json. Raises OSError: it cannot be read; DamagedFile: it holds something else."""
    return read_json(path, Observed, OBSERVED.bytes)


def new_observed(endpoint: str, run: str) -> Observed:
    """The data that an observer of a run will need, with a new password."""
    return Observed(endpoint, OBSERVER, secrets.token_urlsafe(24), run)


def write_observed(path: Path, observed: Observed) -> None:
    """Write observe.json, which only its owner can read. Raises OSError."""
    write_whole(path, msgspec.json.encode(observed))


def host_observed(observed: Observed) -> OpenBus:
    """A router at the endpoint that lets in the observer alone. Raises BusError: the endpoint is not valid,
    or it is in use."""
    from netem.wire.open_bus import OpenBus  # here, because it imports zenoh, which a run in one process does without

    with PrivateFolder() as private:
        credentials = Credentials(observed.user, observed.password)
        return OpenBus.host(observed.endpoint, Keys(observed.run), credentials, private)
