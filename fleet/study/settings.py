"""What a study wants besides its runs: what it shows, when a point has enough of them, and what it keeps."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

KeepLogs = Literal["none", "failed", "all"]
KEEP_LOGS: tuple[KeepLogs, ...] = get_args(KeepLogs)
MOST_ALLOWED = 1_000_000
LARGEST_SEED = 2**63 - 1
MOST_SEEDS = 1000  # of a point of a study that adds seeds


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """As study.json has them.

    Attributes:
        measures: what its table shows, by name; measures of signals are made because they stand here.
        until: seeds are added to each point until this holds, such as `pass ±5 %`; None: no seed is added.
        most_seeds: of a point, if seeds are added.
        keep_logs: whether the logs of runs are kept: none, those of runs that failed, or all.
    """

    measures: tuple[str, ...] = ()
    until: str | None = None
    most_seeds: Annotated[int, Meta(ge=1, le=MOST_ALLOWED)] = MOST_SEEDS
    keep_logs: KeepLogs = "none"


NOTHING_MORE = Settings()
