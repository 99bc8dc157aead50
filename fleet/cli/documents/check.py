"""The output of `fleet check --json`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta, Struct

from fleet.analysis.border import LinearFleet
from fleet.analysis.link_shares import effective_loss, written
from fleet.analysis.seed import seeded
from fleet.analysis.stability import Analysis, oldest_s, slack
from fleet.cli.documents.failure import ProblemRow, problem_rows
from fleet.cli.documents.listing import Duration, Expect, Name, Title, Vehicles
from fleet.errors import Problem
from fleet.scenario.scenario import Scenario, timeline
from netem.condition import Link
from netem.link_states import LinkStates
from netem.link_trace import LinkTrace


class Eigenvalue(Struct):
    """An eigenvalue of L + B."""

    real: Annotated[float, Meta(description="Real part.")]
    imag: Annotated[float, Meta(description="Imaginary part.")]


class ExpectedByTheory(Struct):
    """Expectations of theory for a fleet: `docs/background/stability.md` says what the numbers mean."""

    parts: Annotated[list[list[int]], Meta(description="Vehicles that links connect, taken both ways; one: connected.")]
    followers: Annotated[list[int], Meta(description="Vehicles that follow the reference themselves.")]
    unreached: Annotated[list[int], Meta(description="Vehicles that no chain of links leads to from a follower.")]
    eigenvalues: Annotated[list[Eigenvalue], Meta(description="Those of L + B, by real part.")]
    spectral_radius: Annotated[float, Meta(description="Of the adjacency matrix A.")]
    oldest_s: Annotated[float, Meta(description="Greatest age of what is heard, without loss [s].")]
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


class PlannedFault(Struct):
    """One fault of a scenario."""

    id: Annotated[str, Meta(description="Its id.")]
    what: Annotated[str, Meta(description="What it does, as a scenario writes it.")]
    from_s: Annotated[float, Meta(description="When it begins [s].")]
    to_s: Annotated[float, Meta(description="When it ends, at the latest with the run [s].")]


class ShareOfTime(Struct):
    """A state of links."""

    name: Annotated[str, Meta(description="Its name.")]
    share: Annotated[float, Meta(description="Share of the time in the long run.")]
    mean_s: Annotated[float, Meta(description="How long it lasts on average [s].")]


class ChangingLinksRow(Struct):
    """Links whose condition changes by itself."""

    links: Annotated[list[str], Meta(description="Which, such as 1->2.")]
    states: Annotated[list[ShareOfTime], Meta(description="Their states; empty: they have a trace.")]
    together: Annotated[bool, Meta(description="Whether they share their state.")]
    rows: Annotated[int, Meta(description="Rows of their trace; 0: they have states.")]
    effective_loss: Annotated[float, Meta(description="Share of packets lost in the long run, but for queues.")]


class Checked(Struct):
    """`fleet check --json`: a valid scenario. One that is not valid gives a `FailedCommand` with its problems."""

    valid: Annotated[bool, Meta(description="true.")]
    name: Name
    title: Title
    vehicles: Vehicles
    links: Annotated[int, Meta(description="Number of directed links.")]
    duration_s: Duration
    tick_s: Annotated[float, Meta(description="Control period [s].")]
    round_ticks: Annotated[int, Meta(description="Ticks between two rounds of messages.")]
    ideal: Annotated[bool, Meta(description="Whether the network is ideal.")]
    expect: Expect
    seed: Annotated[int, Meta(description="The seed.")]
    draws: Annotated[list[str], Meta(description="Draws from the seed; empty: it decides nothing.")]
    theory: Annotated[ExpectedByTheory, Meta(description="What theory expects.")]
    changing_links: Annotated[list[ChangingLinksRow], Meta(description="Those with states or traces.")]
    faults: Annotated[list[PlannedFault], Meta(description="In the order in which they begin.")]
    warnings: Annotated[list[str], Meta(description="What is valid and hardly intended.")]
    not_checked: Annotated[list[ProblemRow], Meta(description="Laws that may not run here and were not checked.")]


def checked(scenario: Scenario, found: Analysis, warnings: list[str], refused: Sequence[Problem]) -> Checked:
    """The document of a valid scenario.

    Args:
        refused: the laws that were not checked.
    """
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
        draws=seeded(scenario),
        theory=_theory(scenario, found),
        changing_links=[_changing(its, links) for _, its, links in written(scenario)],
        faults=[PlannedFault(name, what, begin_s, end_s) for name, begin_s, end_s, what in timeline(scenario)],
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
