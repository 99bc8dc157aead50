"""`result.json` as others read it: a file from anybody, so nothing of it is used before it has been checked.

Declared is what reports and pictures need; what else stands in the file is left out.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Annotated, Any

import msgspec

from fleet.errors import FleetError
from netem.whole_file import read_file

_MOST_BYTES = 20_000_000

Number = float | None  # None also where JSON has no word for it
Count = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Times = list[tuple[Annotated[float, msgspec.Meta(gt=0, le=1e15)], Count]]  # up to [ms], how many


class ResultError(FleetError):
    """There is a result, and it cannot be used."""


class _Moment(msgspec.Struct):
    at_s: Annotated[float, msgspec.Meta(ge=0, le=1e15)]
    values: dict[str, Number] = {}


class _Check(msgspec.Struct):
    check: str
    passed: bool
    asked: str
    found: str
    moment: _Moment | None = None
    signals: list[str] = []


class _Vehicle(msgspec.Struct):
    settle_10pct_s: Number
    settle_5cm_s: Number
    e_rms_m: Number
    formation_final_m: Number
    effort_Ns: Number
    u_cmd_max_mps: Number
    qp_failures: Count
    payloads_rejected: Count


class _Account(msgspec.Struct):
    sent: Count
    duplicated: Count
    delivered: Count
    lost: dict[str, Count]
    in_flight: Count
    corrupted: Count


class _Age(msgspec.Struct):
    mean_s: float
    p95_s: float
    max_s: float


class _Result(msgspec.Struct):
    digest: str
    status: str
    reason: str
    checks: list[_Check]
    vehicles: dict[str, _Vehicle]
    ledger: dict[str, _Account]
    ages: dict[str, _Age]


class _Spread(msgspec.Struct):
    negative: Count
    p99_ms: float
    histogram_ms: Times


class _Agent(msgspec.Struct):
    response: _Spread


class _Link(msgspec.Struct):
    injected: _Spread
    measured: _Spread


class _Network(msgspec.Struct):
    hop: _Spread
    links: dict[str, _Link]


class _World(msgspec.Struct):
    period_ms: Annotated[float, msgspec.Meta(gt=0, le=1e9)]


class _Timing(msgspec.Struct):
    world: _World
    netem: _Network
    vehicles: dict[str, _Agent]


def read_result(log: Path) -> dict[str, Any]:
    """The result beside a log.

    Raises:
        FileNotFoundError: there is none.
        ResultError: it is damaged: its text says what is wrong, and where.
    """
    return _convert(log, _values(log), _Result)


def read_timing(log: Path) -> dict[str, Any]:
    """How everyone kept up in a run on a wall clock, as the result beside its log has it. Raises as `read_result`."""
    values = _values(log)
    return _convert(log, values.get("timing") if isinstance(values, dict) else values, _Timing)


def _values(log: Path) -> Any:
    path = _beside(log)
    try:
        # JSON has no word for what is not finite; Python's writer has.
        return json.loads(read_file(path, _MOST_BYTES), parse_constant=lambda _: None, parse_float=_finite)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ResultError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ResultError(f"{path} is damaged: not JSON ({error!s:.100})") from None


def _convert(log: Path, values: Any, kind: type[msgspec.Struct]) -> dict[str, Any]:
    try:
        # Through JSON again, so that no text has what cannot be written, a lone half of a character.
        found: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(msgspec.convert(values, kind)))
    except (ValueError, OverflowError) as error:  # msgspec's own are ValueErrors
        raise ResultError(f"{_beside(log)} is damaged: {error!s:.200}") from None
    return found


def _finite(text: str) -> float | None:
    return value if isfinite(value := float(text)) else None


def _beside(log: Path) -> Path:
    return log.parent / "result.json"


def outcome_words(status: str, passed: Sequence[bool]) -> str:
    """A run in a few words, the same on every page and picture.

    Args:
        status: of the result.
        passed: of each check that was judged.
    """
    failed = sum(not one for one in passed)
    if status == "pass":
        return "failed as expected" if failed else "passed"
    return f"{failed} of {len(passed)} checks failed" if failed else status.replace("_", " ")
