"""The result of a run: `fleet.run` returns it, `fleet run --json` prints it, and `result.json` holds it.

Reports, lists of runs and studies read it, too. A new number is a field here, and the line that computes it.
"""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any
from warnings import warn

import msgspec
from msgspec import Meta, Struct

from fleet.notebook import html_table
from fleet.result.json_text import json_text
from fleet.result.timing import Punctual, Timing
from fleet.result.verdict import Verdict, sort_failed_first
from netem.ledger import Account, Count

FORMAT = 1  # the format of result.json; a later version may write a larger number
Number = float | None  # null in JSON: not finite, or there is none


class Status(StrEnum):
    """How a run ended."""

    PASS = "pass"
    CHECK_FAILED = "check_failed"
    BROKEN = "broken"
    HUNG_UP = "hung_up"
    INTERRUPTED = "interrupted"

    @property
    def exit(self) -> int:
        """The exit status of `fleet run`."""
        return _EXIT[self]


_EXIT = {Status.PASS: 0, Status.CHECK_FAILED: 1, Status.BROKEN: 3, Status.HUNG_UP: 129, Status.INTERRUPTED: 130}


class SignalValue(Struct):
    """The last value of a signal that an agent reported."""

    value: Number
    unit: Annotated[str, Meta(description="1: none.")]


class VehicleResult(Struct):
    """The result of one vehicle."""

    settle_10pct_s: Annotated[
        Number,
        Meta(description="How long after its start e stays below 10 % of its first value [s]; null: not settled."),
    ]
    settle_5cm_s: Annotated[Number, Meta(description="From when on e stays below 5 cm; null: not settled.")]
    e_rms_m: Annotated[Number, Meta(description="Root mean square of e over the last 10 s.")]
    e_final_m: Annotated[Number, Meta(description="Consensus error.")]
    formation_final_m: Number
    effort_Ns: Annotated[Number, Meta(description="Integral of the surge force [N s].")]
    u_cmd_max_mps: Annotated[Number, Meta(description="Greatest commanded speed [m/s].")]
    qp_failures: Count
    payloads_rejected: Count
    agent: Annotated[str, Meta(description="The whole agent that it runs; empty: the laws of a controller.")] = ""
    signals: Annotated[
        dict[str, SignalValue],
        Meta(description="Last signals of a whole agent, by name; none: it did not report any more."),
    ] = {}


class Formation(Struct, frozen=True):
    """Formation errors of the fleet at one time."""

    worst_m: Number = 0.0
    vehicle: Annotated[int, Meta(description="Whose it is; 0: nothing is known yet.")] = 0
    median_m: Number = 0.0
    vehicles: int = 1

    def __str__(self) -> str:
        if self.vehicles < 2:
            return f"{self.worst_m or 0.0:.3f} m"
        return f"{self.worst_m or 0.0:.3f} m (UUV {self.vehicle}), median {self.median_m or 0.0:.3f} m"


class TumbleSpell(Struct):
    """A period of a tumbled vehicle."""

    vehicle: int
    from_s: float
    to_s: Annotated[Number, Meta(description="When it ended; null: it lasted to the end of the run.")]


class LinkAge(Struct):
    """The age of what a link delivered last."""

    mean_s: float
    p95_s: float
    max_s: float


class FaultEvent(Struct):
    """The beginning or the end of a fault, or of an event of a vehicle."""

    at_s: float
    fault: str
    action: str
    what: Annotated[str, Meta(description="What it does, as a scenario writes it.")]


class Wall(Struct):
    """Wall times."""

    in_process: bool = False
    processes: Annotated[int, Meta(description="Of agents; 0: it was one process.")] = 0
    per_process: Annotated[int, Meta(description="Agents in each, at most.")] = 0
    startup_s: float = 0.0
    run_s: float = 0.0
    cores: Annotated[str, Meta(description="`compiled` or `plain Python`: the cores of world, agents and netem.")] = ""
    machine: Annotated[str, Meta(description="Its processor and C library.")] = ""
    cpu_s: Annotated[float, Meta(description="CPU time of all its processes, of a run of programs; else 0.")] = 0.0
    x_real_time: Annotated[float, Meta(description="Times real time [1].")] = 0.0


class Published(Struct):
    """The journal on zenoh, with `--publish`."""

    messages: int
    dropped: Annotated[int, Meta(description="Messages that their receiver did not take in time.")]


class Result(Struct, kw_only=True):
    """The result of a run. `result.json` has all of it but `run` and `directory`.

    Attributes:
        scenario: name of the scenario.
        seed: the seed of the run.
        status: how the run ended.
        exit: the exit status of `fleet run`.
        lines: what explains `reason`, such as the last lines of a process.
        sim_s: the simulated time that the run reached [s].
        vehicles: the result of each vehicle, by its number as text.
        formation: the formation errors in the last frame [m].
        tumbles: when vehicles were tumbled.
        ledger: the account of the packets of each link, by `1->2`.
        faults: when faults began and ended, in that order.
        python: version of Python.
        wall: wall times [s], processes, and what computed the run.
        notes: what agents and processes reported, a line each.
    """

    run: Annotated[str, Meta(description="Empty: it has no directory.")] = ""
    directory: Annotated[Path | None, Meta(description="null: nothing was written.")] = None
    format: Annotated[int, Meta(description="Format of these fields; a file without it has format 1.")] = FORMAT
    scenario: str = ""
    seed: int = 0
    status: Status
    exit: int = 0
    reason: Annotated[str, Meta(description="Why it broke or was ended; empty: it came to its end.")] = ""
    lines: list[str] = []
    from_s: Annotated[float, Meta(description="Time at which it began; 0, or where it goes on from another.")] = 0.0
    sim_s: float = 0.0
    checks: Annotated[list[Verdict], Meta(description="None if the run did not come to its end.")] = []
    vehicles: dict[str, VehicleResult] = {}
    formation: Formation = Formation()
    tumbles: list[TumbleSpell] = []
    ledger: dict[str, Account] = {}
    ages: Annotated[dict[str, LinkAge], Meta(description="By link; `*`: of all.")] = {}
    middleware_lost: Annotated[int, Meta(description="Messages that zenoh lost; such a run is invalid.")] = 0
    faults: list[FaultEvent] = []
    events: Annotated[list[FaultEvent], Meta(description="When vehicles were tumbled or diverged, in that order.")] = []
    messages: Annotated[int, Meta(description="With `log: none` those it would have.")] = 0
    log_bytes: Annotated[int, Meta(description="0: there is no log.")] = 0
    digest: Annotated[str, Meta(description="SHA-256 of these messages, in hexadecimal.")] = ""
    python: str = ""
    wall: Wall = msgspec.field(default_factory=Wall)
    rejected: Annotated[dict[str, int], Meta(description="By key.")] = {}
    deaths: Annotated[dict[str, list[str]], Meta(description="By vehicle: agents that ended without a fault.")] = {}
    notes: list[str] = []
    published: Annotated[Published | None, Meta(description="With `--publish`; else null.")] = None
    timing: Annotated[Timing | None, Meta(description="With `--clock real`; else null.")] = None
    punctual: Annotated[Punctual | None, Meta(description="Of `fleet netem`; else null.")] = None

    @property
    def verdicts(self) -> list[Verdict]:
        """The name of `checks` in version 1.0; deprecated."""
        warn("Result.verdicts is deprecated, use Result.checks", DeprecationWarning, stacklevel=2)
        return self.checks

    @property
    def passed(self) -> bool:
        """Whether it came to its end and every check passed."""
        return self.status is Status.PASS

    @property
    def values(self) -> dict[str, Any]:
        """All its numbers as plain values, as `result.json` has them: None where one is not finite."""
        found: dict[str, Any] = json.loads(json_text(self))
        del found["run"], found["directory"]
        return found

    @property
    def words(self) -> str:
        """How it ended in a few words, the same on every page and picture."""
        failed = sum(verdict.failed for verdict in self.checks)
        if self.passed:
            return "failed as expected" if failed else "passed"
        if self.status is Status.CHECK_FAILED:
            return f"{failed} of {len(self.checks)} checks failed{self.not_judged}"
        return self.status.replace("_", " ")

    @property
    def not_judged(self) -> str:
        """The number of checks that were not judged, to go on a sentence; empty if there is none."""
        count = sum(not verdict.judged for verdict in self.checks)
        return f", {count} not judged" if count else ""

    def __repr__(self) -> str:
        failed = [verdict.check for verdict in self.checks if verdict.failed]
        said = f"{sum(verdict.passed for verdict in self.checks)} of {len(self.checks)} checks passed"
        said = self.reason or said + (f", failed: {', '.join(failed)}" if failed else "") + self.not_judged
        return f"<Result of {self._run}: {self.status}; {said}>"

    def _repr_html_(self) -> str:
        rows = [(one.check, one.mark, one.asked, one.found) for one in sort_failed_first(self.checks)]
        title = f"{self._run}: {self.status}" + (f", {self.reason}" if self.reason else "")
        return html_table(title, ("check", "", "asked", "found"), rows)

    @property
    def _run(self) -> str:
        return f"{self.scenario or 'a run'} with seed {self.seed}"
