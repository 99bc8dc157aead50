"""The sides of a fleet: who can talk with whom while faults are active."""

from __future__ import annotations

import pytest

from fleet.checks.api import Facts, Fault, Tick
from fleet.checks.sides import ReachableGroups

PATH = tuple(link for a in (1, 2, 3) for link in ((a, a + 1), (a + 1, a)))
FACTS = Facts("four", 1, 4, 10.0, 0.01, 0.0, PATH, {})


class Seen:
    """A vehicle of which only is known whether it lives."""

    def __init__(self, number: int, alive: bool) -> None:
        self.id, self.alive = number, alive

    def __getitem__(self, signal: str) -> None:
        return None


def tick(t: float, *faults: str, dead: tuple[int, ...] = ()) -> Tick:
    vehicles = tuple(Seen(i, i not in dead) for i in range(1, 5))
    active = tuple(Fault(f"f{k}", what, t) for k, what in enumerate(faults, start=1))
    return Tick(round(t * 100), t, vehicles, active, ())


ALL = ((1, 2, 3, 4),)


@pytest.mark.parametrize(
    ("faults", "groups"),
    [
        ((), ALL),
        (("partition 1,2 / 3,4",), ((1, 2), (3, 4))),
        (("partition halves",), ((1, 2), (3, 4))),
        (("partition isolate:4",), ((1, 2, 3), (4,))),
        (("down 2->3",), ((1, 2), (3, 4))),  # one way is none
        (("down 2<->3", "up *"), ALL),
        (("up *", "down 2<->3"), ((1, 2), (3, 4))),
        (("partition 1,2 / 3,4", "up *"), ((1, 2), (3, 4))),
        (("mute 2",), ((1,), (2,), (3, 4))),
        (("deaf 2-3",), ((1,), (2,), (3,), (4,))),
        (("pause 4",), ((1, 2, 3),)),
        (("slow {vehicles: 1, by: 5 ticks}", "link *: loss 60%"), ALL),
    ],
)
def test_faults_cut(faults: tuple[str, ...], groups: tuple[tuple[int, ...], ...]) -> None:
    sides = ReachableGroups(FACTS)
    sides.update(tick(0.0, *faults))
    assert sides.groups == groups


def test_who_has_no_agent_is_on_no_side_and_passes_nothing_on() -> None:
    sides = ReachableGroups(FACTS)
    sides.update(tick(0.0, "kill 3", dead=(3,)))
    assert sides.groups == ((1, 2), (4,))


def test_what_matters_is_when_the_sides_changed() -> None:
    sides = ReachableGroups(FACTS)
    changes = []
    for t, faults in ((0.5, ()), (1.0, ("mute 1",)), (2.0, ("mute 1", "freeze 2")), (3.0, ("freeze 2",))):
        sides.update(tick(t, *faults))
        changes.append(sides.since)
    assert changes == [0.0, 1.0, 1.0, 3.0]  # the begin of the run; and another fault changes no side


def test_a_link_may_change_and_leave_the_sides() -> None:
    ring = Facts("four", 1, 4, 10.0, 0.01, 0.0, (*PATH, (4, 1), (1, 4)), {})
    sides = ReachableGroups(ring)
    sides.update(tick(0.0))
    sides.update(tick(2.0, "hold 1->2"))
    assert (sides.groups, sides.since, sides.links_since) == (ALL, 0.0, 2.0)
    sides.update(tick(3.0, "hold 1->2", "slow {vehicles: 1, by: 5 ticks}"))
    assert sides.links_since == 2.0
    sides.update(tick(4.0))
    assert (sides.since, sides.links_since) == (0.0, 4.0)
