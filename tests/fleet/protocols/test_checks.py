"""The checks of the protocols, on histories that are written down here."""

from __future__ import annotations

from typing import Any

import pytest

from fleet.checks.api import Facts, Failure, Fault, NotJudged, Tick
from fleet.protocols.checks import AgreeAfterHeal, AtMostOneLeader, TrueMean

LINKS = tuple((a, b) for a in range(1, 4) for b in range(1, 4) if a != b)
FACTS = Facts("three", 1, 3, 10.0, 0.1, 0.0, LINKS, {})
CUT = ("partition 1 / 2,3",)


class Seen:
    def __init__(self, number: int, alive: bool, values: dict[str, float]) -> None:
        self.id, self.alive, self._values = number, alive, values

    def __getitem__(self, signal: str) -> float | None:
        return self._values.get(signal.removeprefix("control."))


def first_failure(check: Any, history: list[tuple[Any, ...]], signals: tuple[str, ...]) -> tuple[float, Failure] | None:
    """Feed it [t, faults, per signal a value for each vehicle; None: it is dead, "-": it reports nothing]."""
    for t, faults, *columns in history:
        vehicles = []
        for k in range(3):
            values = [column[k] for column in columns]
            alive = None not in values
            reports = alive and "-" not in values
            vehicles.append(Seen(k + 1, alive, dict(zip(signals, values, strict=True)) if reports else {}))
        active = tuple(Fault(f"f{n}", what, t) for n, what in enumerate(faults))
        if (failure := check.step(Tick(round(10 * t), t, tuple(vehicles), active, ()))) is not None:
            return t, failure
    return None


MEASURED = (10.0, 20.0, 60.0)


@pytest.mark.parametrize(
    ("history", "at", "vehicles"),
    [
        ([(0.0, (), MEASURED, MEASURED), (1.9, (), MEASURED, MEASURED), (2.0, (), MEASURED, (30.0,) * 3)], None, ()),
        ([(0.0, (), MEASURED, MEASURED), (2.0, (), MEASURED, (30.0, 30.2, 29.8))], 2.0, (2, 3)),
        ([(0.0, CUT, MEASURED, MEASURED), (2.0, CUT, MEASURED, (10.0, 40.0, 40.0))], None, ()),
        ([(0.0, CUT, MEASURED, MEASURED), (2.0, CUT, MEASURED, (30.0, 30.0, 30.0))], 2.0, (1,)),
        ([(t, (), (10.0, None, 60.0), (35.0, None, 35.0)) for t in (0.0, 2.0)], None, ()),
        ([(0.0, (), MEASURED, MEASURED), (1.5, CUT, MEASURED, MEASURED), (3.4, CUT, MEASURED, MEASURED)], None, ()),
    ],
    ids=["settles", "two are off", "per side", "not per side", "without the dead", "the sides changed"],
)  # fmt: skip
def test_true_mean(history: list[Any], at: float | None, vehicles: tuple[int, ...]) -> None:
    found = first_failure(TrueMean(FACTS, below=0.1, within="2 s"), history, ("measured", "average"))
    assert (found and found[0], found[1].vehicles if found else ()) == (at, vehicles)


@pytest.mark.parametrize("fault", ["hold 1->2", "hold {links: 1->2, order: reversed}", "down 1->2"])
def test_true_mean_waits_after_a_link_that_leaves_the_sides_as_they_are(fault: str) -> None:
    """A search of the sound protocol found it: one end took back what the other one had not yet given back."""
    check = TrueMean(FACTS, below=0.1, within="2 s")
    sane, off = (30.0,) * 3, (30.0, 32.0, 30.0)
    history = [(0.0, (), sane), (3.0, (), sane), (5.0, (fault,), off), (6.9, (fault,), off), (7.0, (fault,), off)]
    found = first_failure(check, [(t, on, MEASURED, averages) for t, on, averages in history], ("measured", "average"))
    assert found is not None and found[0] == 7.0


def test_true_mean_that_was_never_judged_is_no_pass() -> None:
    check = TrueMean(FACTS, below=0.1, within="2 s")
    history = [(0.0, (), MEASURED, MEASURED), (1.5, CUT, MEASURED, MEASURED), (3.4, CUT, MEASURED, MEASURED)]
    assert first_failure(check, history, ("measured", "average")) is None
    assert isinstance(check.verdict(), NotJudged)
    assert first_failure(check, [(3.6, CUT, MEASURED, (10.0, 40.0, 40.0))], ("measured", "average")) is None
    assert check.verdict() == "off by 0 degC at most at 3.6 s"


def test_true_mean_says_how_much_is_lost() -> None:
    history = [(0.0, (), MEASURED, (31.0, 31.0, 31.0))]
    found = first_failure(TrueMean(FACTS, within="0 s"), history, ("measured", "average"))
    assert found is not None
    assert found[1].values == {"mean [degC]": 30.0, "sum of all errors [degC]": 3.0}


ONE, TWO = (1.0, 0.0, 0.0), (1.0, 0.0, 1.0)
HELD, SILENT, SILENT_AND_ANOTHER = ("pause 1",), ("-", 0.0, 0.0), ("-", 1.0, 0.0)  # vehicle 1 reports nothing


@pytest.mark.parametrize(
    ("parameters", "history", "at"),
    [
        ({}, [(0.0, (), ONE), (1.0, (), ONE)], None),
        ({}, [(0.0, (), ONE), (1.0, CUT, TWO)], 1.0),
        ({"per": "side"}, [(0.0, CUT, TWO)], None),
        ({"per": "side"}, [(0.0, CUT, (0.0, 1.0, 1.0))], 0.0),
        ({"per": "side", "grace": "1 s"}, [(0.0, CUT, TWO), (3.0, (), TWO), (3.9, (), TWO), (4.0, (), ONE)], None),
        ({"per": "side", "grace": "1 s"}, [(0.0, CUT, TWO), (3.0, (), TWO), (4.0, (), TWO)], 4.0),
        ({}, [(0.0, (), (1.0, 0.0, None)), (1.0, (), (None, 0.0, 1.0))], None),
        ({}, [(0.0, (), ONE), (1.0, HELD, SILENT), (9.0, HELD, SILENT_AND_ANOTHER)], 9.0),  # it has no lease
        ({}, [(0.0, (), ONE), (1.0, HELD, SILENT), (9.0, (), (0.0, 1.0, 0.0))], None),
        ({}, [(0.0, (), ONE), (1.0, (), (None, 0.0, 0.0)), (2.0, HELD, SILENT_AND_ANOTHER)], None),  # a new life
        ({}, [(0.0, (), ONE), (1.0, (), SILENT_AND_ANOTHER)], None),  # without a sample, not suspended
        ({"per": "side"}, [(0.0, (), ONE), (1.0, HELD, SILENT_AND_ANOTHER)], None),  # it is on no side
    ],
)
def test_at_most_one_leader(parameters: Any, history: list[Any], at: float | None) -> None:
    found = first_failure(AtMostOneLeader(FACTS, **parameters), history, ("leads",))
    assert (found and found[0]) == at
    if found:
        assert len(found[1].vehicles) == 2


@pytest.mark.parametrize(
    ("until", "history", "at"),
    [
        (2.0, [(1.9, HELD, SILENT), (2.0, HELD, SILENT_AND_ANOTHER)], None),
        (2.0, [(1.9, HELD, SILENT_AND_ANOTHER)], 1.9),
        (2.0, [(1.0, (), (0.0, 0.0, 0.0)), (1.5, HELD, SILENT_AND_ANOTHER)], None),  # it had stepped down before
    ],
)
def test_a_suspended_leader_leads_until_its_lease_ends(until: float, history: list[Any], at: float | None) -> None:
    """As it reported last, by the true time."""
    told = [(t, faults, leads, (until, 2.0, 2.0)) for t, faults, leads in [(0.0, (), ONE), *history]]
    found = first_failure(AtMostOneLeader(FACTS), told, ("leads", "leads_until"))
    assert (found and found[0]) == at
    if found:
        assert found[1] == Failure("2 vehicles lead at once; 1 by its last report, since it is suspended", (1, 2))


@pytest.mark.parametrize(("vehicles", "at"), [(6, None), (5, 2.0), (4, 2.0)])
def test_sides_of_half_the_fleet_or_less_may_agree_on_no_leader(vehicles: int, at: float | None) -> None:
    """Three vehicles name nobody."""
    check = AgreeAfterHeal(FACTS._replace(vehicles=vehicles), within="2 s")
    found = first_failure(check, [(0.0, (), *NONE), (2.0, (), *NONE)], ("leads", "leader"))
    assert (found and found[0]) == at


NONE, FIRST, THIRD = ((0.0,) * 3, (0.0,) * 3), (ONE, (1.0,) * 3), ((0.0, 0.0, 1.0), (3.0,) * 3)


@pytest.mark.parametrize(
    ("quorum", "history", "at"),
    [
        ("fleet", [(0.0, (), *NONE), (1.0, (), *FIRST), (9.0, (), *FIRST)], None),
        ("fleet", [(0.0, (), *NONE), (2.0, (), *NONE)], 2.0),
        ("fleet", [(0.0, (), *FIRST), (2.0, (), ONE, (1.0, 1.0, 2.0))], 2.0),
        ("fleet", [(0.0, (), *FIRST), (2.0, (), (0.0,) * 3, (1.0,) * 3)], 2.0),
        ("fleet", [(0.0, (), *FIRST), (5.0, CUT, *FIRST), (7.0, CUT, (0.0, 0.0, 1.0), (0.0, 3.0, 3.0))], None),
        ("side", [(0.0, (), *FIRST), (5.0, CUT, *FIRST), (7.0, CUT, (0.0, 0.0, 1.0), (0.0, 3.0, 3.0))], 7.0),
        ("side", [(0.0, CUT, *NONE), (2.0, CUT, (1.0, 0.0, 1.0), (1.0, 3.0, 3.0)), (3.0, (), *NONE), (5.0, (), *THIRD)],
         None),
        ("fleet", [(0.0, (), *FIRST), (5.0, (), (None, 0.0, 0.0), (None, 1.0, 1.0)), (7.0, (), (None, 0.0, 0.0),
                   (None, 1.0, 1.0))], 7.0),
    ],
)  # fmt: skip
def test_agree_after_heal(quorum: Any, history: list[Any], at: float | None) -> None:
    check = AgreeAfterHeal(FACTS, within="2 s", quorum=quorum)
    found = first_failure(check, history, ("leads", "leader"))
    assert (found and found[0]) == at
    if found:
        assert "after the sides changed" in found[1].message


def test_what_checks_say_has_the_names_of_nodes() -> None:
    """The words were made with numbers, and a regular expression put names in; it changed texts of users, too."""
    facts = FACTS._replace(names=("north", "south", "shore"))
    check = AgreeAfterHeal(facts, within="1 s")
    found = first_failure(check, [(2.0, (), (1.0, 3.0, 0.0), (0.0, 0.0, 0.0))], ("leader", "leads"))
    assert found is not None and found[1].message.endswith("north names north, south names shore, shore names nobody")
    assert [FACTS.name(2), facts.name(2)] == ["2", "south"]


def test_a_run_that_ends_before_there_is_agreement_does_not_pass() -> None:
    check = AgreeAfterHeal(FACTS, within="2 s")
    assert first_failure(check, [(0.0, (), *NONE), (1.0, (), *NONE)], ("leads", "leader")) is None
    assert isinstance(check.verdict(), NotJudged)
    assert first_failure(check, [(1.5, (), *FIRST)], ("leads", "leader")) is None
    assert check.verdict() == "agreed 1.5 s after a change at the latest"
