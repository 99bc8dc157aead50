"""What `--json` prints of a scenario, of two logs, and as lists: documents that join several structs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from fleet.analysis.border import LinearFleet
from fleet.analysis.link_shares import changing_links, effective_loss
from fleet.analysis.randomness import may_draw
from fleet.analysis.slots import slack
from fleet.analysis.stability import Analysis, oldest_s
from fleet.cli.documents.failure import ProblemRow, problem_rows
from fleet.errors import Problem
from fleet.execution.answers import LiveRunRow
from fleet.execution.past_runs import PastRun
from fleet.logs.deviation import LogComparison
from fleet.logs.difference import Difference
from fleet.logs.fault_intervals import FaultTime
from fleet.scenario.scenario import Scenario, timeline
from netem.condition import Link
from netem.link_states import LinkStates
from netem.link_trace import LinkTrace


class Runs(Struct):
    """`fleet ls --json`: the live runs of this user, and the runs below a directory."""

    live: list[LiveRunRow]
    runs: Annotated[list[PastRun], Meta(description="The newest first.")]
    size_bytes: int


class Eigenvalue(Struct):
    """An eigenvalue of L + B."""

    real: float
    imag: float


class ExpectedByTheory(Struct):
    """Expectations of theory for a fleet: `docs/background/linear-stability.md` says what the numbers mean."""

    parts: Annotated[list[list[int]], Meta(description="Vehicles that links connect, taken both ways; one: connected.")]
    followers: list[int]
    unreached: Annotated[list[int], Meta(description="Vehicles that no chain of links leads to from a follower.")]
    eigenvalues: list[Eigenvalue]
    spectral_radius: float
    oldest_s: Annotated[float, Meta(description="Greatest age of what is heard, without loss.")]
    gain_per_s: Annotated[float | None, Meta(description="Largest gain K that may occur [1/s]; null: no such law.")]
    settled_gain_per_s: Annotated[
        list[float] | None, Meta(description="Gain at which K settles, north, east, down [1/s]; null: no such law.")
    ]
    gain_limit_per_s: Annotated[
        float | None, Meta(description="Gain from which on the linear loop grows [1/s]; null: none, or not computed.")
    ]
    delay_limit_s: Annotated[
        float | None,
        Meta(description="Longest delay of all links that it bears at the largest gain [s]; null: as above."),
    ]
    settled_delay_limit_s: Annotated[
        float | None, Meta(description="The same at the gain at which K settles [s]; null: as above.")
    ]
    clock_difference_s: Annotated[
        float | None, Meta(description="By how much clocks may differ until time slots overlap [s]; null: no slots.")
    ]
    clock_drift: Annotated[
        float | None,
        Meta(description="Drift of each clock, right at the start, that slots bear for the run [s/s]; null: no slots."),
    ]
    not_computed: Annotated[str, Meta(description="Why there are no limits of the linear loop; empty: there are.")]


class ShareOfTime(Struct):
    """A state of links."""

    name: str
    share: Annotated[float, Meta(description="Of the time.")]
    mean_s: float


class ChangingLinksRow(Struct):
    """Links whose condition changes by itself."""

    links: list[str]
    states: Annotated[list[ShareOfTime], Meta(description="Their states; empty: they have a trace.")]
    together: bool
    rows: Annotated[int, Meta(description="Rows of their trace; 0: they have states.")]
    effective_loss: Annotated[float, Meta(description="Share of packets lost in the long run, but for queues.")]


class Checked(Struct):
    """`fleet check --json`: a valid scenario. One that is not valid gives a `FailedCommand` with its problems."""

    valid: bool
    name: str
    title: str
    vehicles: int
    links: int
    duration_s: float
    tick_s: float
    round_ticks: int
    ideal: bool
    expect: Annotated[str, Meta(description="pass, or fail: it is meant to fail a check.")]
    seed: int
    draws: Annotated[list[str], Meta(description="Parts that may draw from the seed; empty: it decides nothing.")]
    theory: ExpectedByTheory
    changing_links: list[ChangingLinksRow]
    faults: list[FaultTime]
    warnings: list[str]
    not_checked: Annotated[list[ProblemRow], Meta(description="Laws that may not run here and were not checked.")]


def check_document(scenario: Scenario, found: Analysis, warnings: list[str], refused: Sequence[Problem]) -> Checked:
    """The document of a valid scenario. `refused`: the laws that were not checked."""
    return Checked(
        valid=True,
        name=scenario.name,
        title=scenario.title,
        vehicles=scenario.vehicles,
        links=len(scenario.graph.links),
        duration_s=scenario.duration_ns / 1e9,
        tick_s=scenario.tick_ns / 1e9,
        round_ticks=scenario.round_ticks,
        ideal=scenario.ideal,
        expect=scenario.spec.expect,
        seed=scenario.seed,
        draws=may_draw(scenario),
        theory=_theory(scenario, found),
        changing_links=[_changing(its, links) for _, its, links in changing_links(scenario)],
        faults=[FaultTime.of(fault) for fault in timeline(scenario)],
        warnings=warnings,
        not_checked=problem_rows(refused),
    )


def _changing(its: LinkStates | LinkTrace, links: Sequence[Link]) -> ChangingLinksRow:
    states: list[ShareOfTime] = []
    rows = 0
    if isinstance(its, LinkTrace):
        rows = len(its.conditions)
    else:
        states = [ShareOfTime(*of) for of in zip(its.names, its.shares, (m / 1e9 for m in its.mean_ns), strict=True)]
    together = isinstance(its, LinkStates) and its.shared is not None
    return ChangingLinksRow([f"{src}->{dst}" for src, dst in links], states, together, rows, effective_loss(its))


def _theory(scenario: Scenario, found: Analysis) -> ExpectedByTheory:
    most, settled, left = found.gain_max, found.settled, slack(scenario)
    gain_limit: float | None = None
    delay_limits: tuple[float | None, float | None] = None, None
    if found.at_most is not None and found.at_settled is not None and most is not None and settled is not None:
        gain_limit = found.at_most.gain_border(most)
        delay_limits = (
            _delay_limit_s(scenario, found.at_most, most),
            _delay_limit_s(scenario, found.at_settled, max(settled)),
        )
    return ExpectedByTheory(
        parts=found.components,
        followers=[i for i, b in enumerate(scenario.b, start=1) if b > 0.0],
        unreached=found.unreached,
        eigenvalues=[Eigenvalue(value.real, value.imag) for value in found.eigenvalues],
        spectral_radius=found.spectral_radius_A,
        oldest_s=oldest_s(scenario),
        gain_per_s=most,
        settled_gain_per_s=None if settled is None else list(settled),
        gain_limit_per_s=gain_limit,
        delay_limit_s=delay_limits[0],
        settled_delay_limit_s=delay_limits[1],
        clock_difference_s=None if left is None else left.difference_s,
        clock_drift=None if left is None else left.drift,
        not_computed=found.not_linear,
    )


def _delay_limit_s(scenario: Scenario, fleet: LinearFleet, gain: float) -> float | None:
    if scenario.ideal or not scenario.graph.links:
        return None
    border = fleet.delay_border(gain)
    return None if border is None else (border - 1) * fleet.tick_s


class SignalRow(Struct):
    """A signal that is not the same in two logs."""

    signal: str
    unit: Annotated[str, Meta(description="Empty: none.")]
    most: Annotated[float | None, Meta(description="Greatest |a - b|.")]
    at_s: float
    messages: int


class Compared(Struct):
    """`fleet diff --json`: what two logs have in common and what not."""

    a: str
    b: str
    same: Annotated[bool, Meta(description="Whether all messages are the same, bit for bit.")]
    from_s: Annotated[float, Meta(description="Compared from then on: where a run goes on from another; else 0.")]
    tolerance: Annotated[float, Meta(description="The most that two numbers may be apart.")]
    within: Annotated[bool, Meta(description="Whether all messages are there in both and within the tolerance.")]
    missing_a: Annotated[str, Meta(description="Empty: the file is whole.")]
    missing_b: str
    messages_same: int
    messages_differing: int
    first: Annotated[Difference | None, Meta(description="null: there is none.")]
    signals: Annotated[list[SignalRow], Meta(description="The greatest first.")]
    others: Annotated[
        dict[str, int], Meta(description="Messages with other texts, flags or bytes, by topic and field.")
    ]
    only_a: Annotated[dict[str, int], Meta(description="By topic.")]
    only_b: Annotated[dict[str, int], Meta(description="By topic.")]
    besides: Annotated[list[str], Meta(description="Metadata, attachments and declarations.")]


def diff_document(
    paths: tuple[Path, Path], missing: tuple[str, str], found: LogComparison, tolerance: float, besides: list[str]
) -> Compared:
    """The document of a comparison."""
    signals = sorted(found.signals.items(), key=lambda item: -item[1].value)
    return Compared(
        a=str(paths[0]),
        b=str(paths[1]),
        same=found.first is None,
        from_s=found.begin_ns / 1e9,
        tolerance=tolerance,
        within=found.within(tolerance),
        missing_a=missing[0],
        missing_b=missing[1],
        messages_same=found.same,
        messages_differing=found.paired,
        first=found.first,
        signals=[SignalRow(name, d.unit, d.value, d.at_ns / 1e9, d.differing) for name, d in signals],
        others=dict(found.others),
        only_a=dict(found.only_a),
        only_b=dict(found.only_b),
        besides=besides,
    )
