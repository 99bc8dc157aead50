"""Faults of links: conditions in place of their own, cuts, packets that are held or come twice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, PlainSerializer

from fleet.quantities import describe_value
from fleet.scenario import value_types as v
from fleet.scenario.faults.kind import FaultKind, LinkFaultKind, Part, Strength, Surroundings, network_fault
from fleet.scenario.faults.partitions import partition
from fleet.scenario.value_types import Section, mistake, word_for
from netem.wire.messages import TimedFault


def _conditions(value: Any) -> Any:
    if isinstance(value, str):
        text = 'expected links with their condition, such as link: {"1->2": loss 30% delay 2s}'
        raise mistake(f"{text}, got {describe_value(value)}")
    return value


class LinkFault(LinkFaultKind):
    """Links have another condition in place of their own."""

    value = Annotated[dict[v.LinkSelector, v.LinkCondition], BeforeValidator(_conditions)]
    example = "link 1<->2 delay 500ms loss 20%"
    every_number_strengthens = True
    offers = (
        ("delay", "link {0} delay 500ms"),
        ("lose", "link {0} loss 30%"),
        ("both", "link {0} delay 500ms 100ms loss 30%"),
    )

    def selectors(self, values: Any) -> list[str]:
        return [*values]

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        return [
            network_fault(times, "link", around.links_named(selector), condition=condition)
            for selector, condition in values.items()
        ]


class DownFault(LinkFaultKind):
    """Nothing passes."""

    example = "down 2->3"
    drawn = "target"
    offers = (("cut", "down {0}"),)


class UpFault(LinkFaultKind):
    """The end of every down, and of the links' own."""

    example = "up 2->3"


class PartitionFault(FaultKind):
    """Nothing passes between groups of vehicles: "1,2 / 3,4", or halves, one, majority, ring, bridge, isolate:3."""

    value = str
    example = "partition 1,2 / 3,4"
    acts_on = "network"
    drawn = "target"
    offers = tuple((name, f"partition {name}") for name in ("halves", "one", "majority", "ring", "bridge"))

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        cut = partition(values, around.vehicles, around.seed, times.id, around.links)
        return [network_fault(times, "partition", tuple(link for link in around.links if link in cut))]


class HoldKeys(Section):
    links: v.LinkSelector
    order: Literal["sent", "reversed"] = "sent"  # reversed: the last one first, at the pace at which they were sent


def _show_hold(hold: HoldKeys | None) -> Any:
    return hold and (hold.model_dump() if hold.order == "reversed" else hold.model_dump()["links"])


class HoldFault(LinkFaultKind):
    """Packets that are sent meanwhile are kept, and come when the fault is over."""

    value = Annotated[HoldKeys, word_for("links"), PlainSerializer(_show_hold)]
    one_word = True
    example = "hold 1->2"
    in_water = False
    drawn = "target"

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        back = (1.0,) if values.order == "reversed" else ()
        return [network_fault(times, "hold", around.links_named(values.links), values=back)]


class DuplicateKeys(Section):
    links: v.LinkSelector
    after: v.Period


class DuplicateFault(LinkFaultKind):
    """Packets that are sent meanwhile come once more, so much later."""

    value = DuplicateKeys
    example = "duplicate links=1->2 after=3s"
    in_water = False
    drawn = "strength"

    def times(self, values: Any) -> list[int]:
        return [values.after]

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        later = values.after // around.tick_ns
        return [network_fault(times, "duplicate", around.links_named(values.links), ticks=later)]

    def of_strength(self, target: str, strength: Strength) -> Any:
        return {"links": target, "after": f"{strength.later_ns} ns"}


OF_LINKS: Sequence[FaultKind] = (
    DownFault(),
    LinkFault(),
    UpFault(),
    PartitionFault(),
    HoldFault(),
    DuplicateFault(),
)
