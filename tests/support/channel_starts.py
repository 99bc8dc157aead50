"""The transmissions that an acoustic channel begins, beside what its log says of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from netem.acoustic import AcousticChannel


@contextmanager
def channel_starts() -> Iterator[list[tuple[int, int]]]:
    """(modem, first tick) of each transmission of the channels of this process, as they begin."""
    found: list[tuple[int, int]] = []
    transmit = AcousticChannel._transmit

    def listening(self: AcousticChannel, src: int, start: int, *rest: Any) -> None:
        found.append((src, start))
        transmit(self, src, start, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(AcousticChannel, "_transmit", listening)
        yield found
