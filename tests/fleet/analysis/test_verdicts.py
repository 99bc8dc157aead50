"""The checks that decide whether a run passes: canned runs that pass and fail each."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenario import WILD, accepted, read_back, small

from fleet.analysis.stability import analyse
from fleet.analysis.verdicts import judge, standing
from fleet.cli.result_table import show
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.recorder.journal import Journal
from fleet.repeat.recorded_run import script
from fleet.result.json_text import json_text
from fleet.result.result import Result, Status
from fleet.result.verdict import Verdict
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario, frame_every
from netem.wire.messages import Fate, Frame, Life, LinkReport, VehicleFrame

Link = tuple[int, int]


class Nowhere:
    """A sink that keeps nothing."""

    def frame(self, *_: Any) -> None: ...
    def packet(self, _: Any) -> None: ...
    def event(self, _: Any) -> None: ...
    def snapshot(self, _: Any) -> None: ...


def fed(
    scenario: Scenario,
    until: int,
    error: Callable[[int, int], float],
    heard: Callable[[Link, int], bool],
    lives: Callable[[int], tuple[Life, ...]] = lambda tick: (),
    before: Callable[[Journal], None] = lambda journal: None,
) -> Journal:
    """A journal up to a tick; whole if that is the last one.

    Args:
        error: how far east of its place vehicle i is at a tick [m].
        heard: whether what is sent at a round tick over a link arrives, one tick later.
        before: what happens to it first.
    """
    journal = Journal(scenario, Nowhere())
    before(journal)
    for tick in range(0, until + 1, frame_every(scenario)):
        rows = tuple(_row(scenario, i, tick, error(i, tick)) for i in (1, 2, 3))
        journal.frame(Frame(tick, False, lives(tick), (), rows))
    fates: list[Fate] = []
    for k in range(0, min(until + 1, scenario.ticks), scenario.round_ticks):
        journal.links(LinkReport(k, False, False, tuple(fates)))
        links = [link for link in sorted(scenario.graph.links) if heard(link, k)]
        fates = [Fate(k + 1, *link, k, 0, k, k + 1, 0, "delivered", False, b"") for link in links]
    if until == scenario.ticks:
        journal.links(LinkReport(scenario.ticks, True, False, tuple(fates)))
    return journal


def verdict(
    check: str,
    *overrides: str,
    error: Callable[[int, int], float] = lambda i, tick: 0.0,
    heard: Callable[[Link, int], bool] = lambda link, tick: True,
    **more: Any,
) -> Verdict:
    """The verdict on a run of 4 s with three vehicles on a path, 5 m apart, a round every 50 ms."""
    scenario = small("duration=4 s", f"checks={{{check}}}", *overrides)
    journal = fed(scenario, scenario.ticks, error, heard, **more)
    assert journal.complete
    journal.finish()
    # Those that stand in every scenario are asked for by name.
    asked = check.partition(":")[0].strip()
    return next(verdict for verdict in judge(scenario, journal, 0) if verdict.check == asked)


SO_FAR = """{
  formation_error: {below: 1 m, after: 1 s}, min_separation: {above: 4 m, after: 1 s},
  max_age: {below: 500 ms, after: 1 s}, connected: {window: 500 ms}, ledger: balanced,
  recovery_time: [{fault: cut, within: 1 m, below: 800 ms}],
}"""


def so_far(until_s: float, *, off: float = 0.0) -> dict[str, tuple[bool | None, str]]:
    """How checks stand at a time of a run whose link 1->2 is cut at 1 s, and healed at 2 s as far as faults go.

    Args:
        off: how far vehicle 2 is from its place from 1 s on [m].
    """
    cut = "faults=[{id: cut, at: 1 s, for: 1 s, down: 1->2}]"
    scenario = small("duration=4 s", f"checks={SO_FAR}", cut, "graph.reference=[1]")
    until = round(until_s * 1e9) // scenario.tick_ns
    journal = fed(
        scenario,
        until,
        error=lambda i, tick: off if i == 2 and tick >= 100 else 0.0,
        heard=lambda link, k: link != (1, 2) or k < 100,
    )
    rows_found = standing(scenario, journal)
    assert standing(scenario, journal) == rows_found  # asking changes nothing
    return {row["check"]: (row["passed"], row["found"]) for row in rows_found}


def test_a_check_that_has_not_begun_is_not_judged_yet() -> None:
    found = so_far(0.3)
    assert {name for name, (passed, _) in found.items() if passed is None} == {
        "formation_error", "min_separation", "max_age", "connected", "ledger", "recovery_time",
    }  # fmt: skip
    assert all(says == "" for passed, says in found.values() if passed is None)
    assert found["tumbled"] == (True, "0")


def test_checks_of_a_run_that_goes_on_tell_what_holds_now() -> None:
    found = so_far(1.3)
    assert found["formation_error"][0] is found["min_separation"][0] is True
    assert found["max_age"][0] is found["connected"][0] is True
    # Nothing arrives any more over 1->2, and nothing counts the age that grows.
    assert so_far(1.6)["max_age"] == (False, "at most 0.65 s (link 1->2, 1.6 s)")
    passed, says = so_far(1.8)["connected"]
    assert passed is False and "not reached" in says


def test_a_recovery_fails_when_its_time_is_over_and_not_before() -> None:
    assert so_far(1.9)["recovery_time"] == (None, "")  # the fault goes on
    assert so_far(2.5, off=2.0)["recovery_time"] == (None, "")
    passed, says = so_far(3.0, off=2.0)["recovery_time"]
    assert passed is False and says == "2 m (vehicle 2) when this was judged"
    assert so_far(2.5)["recovery_time"][0] is True


def _row(scenario: Scenario, i: int, tick: int, off: float) -> VehicleFrame:
    t = tick * scenario.tick_ns / 1e9
    x, y, z = (
        a + b
        for a, b in zip(scenario.reference.at(t).position, scenario.plans[i - 1].at(t).position, strict=True)
    )  # fmt: skip
    return VehicleFrame(i, (x, y + off, z, 0.0, 0.0), (0.0,) * 5, (), (), b"", (), (), (), ())


# --- max_age ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("check", "heard", "passed", "found"),
    [
        ("{below: 51 ms}", lambda link, k: True, True, "at most 0.05 s (link 1->2, 3.95 s)"),
        ("{below: 200 ms}", lambda link, k: link != (2, 3) or not 100 <= k < 130, False,
         "at most 0.35 s (link 2->3, 1.3 s)"),
        ("{below: 200 ms, links: 1<->2}", lambda link, k: link != (2, 3), True, "at most 0.05 s (link 1->2, 3.95 s)"),
        ("{below: 10 s, links: 2->3}", lambda link, k: link != (2, 3), True, "at most 3.99 s (link 2->3, 3.99 s)"),
        # From 1.3 s on the age that was reached before counts as long as it lasts, from 1.31 s on it does not.
        ("{below: 200 ms, after: 1.3 s}", lambda link, k: link != (2, 3) or not 100 <= k < 130, False,
         "at most 0.35 s (link 2->3, 1.3 s)"),
        ("{below: 200 ms, after: 1.305 s}", lambda link, k: link != (2, 3) or not 100 <= k < 130, True,
         "at most 0.05 s (link 1->2, 3.95 s)"),
        ("{below: 1 s, after: 4 s}", lambda link, k: True, None, "the run ended at 4 s, before the check begins"),
    ],
)  # fmt: skip
def test_max_age(check: str, heard: Callable[[Link, int], bool], passed: bool | None, found: str) -> None:
    result = verdict(f"max_age: {check}", heard=heard)
    assert (result.check, result.outcome, result.found) == ("max_age", passed, found)


def test_max_age_says_what_was_asked() -> None:
    assert verdict("max_age: {below: 51 ms}").asked == "below 0.051 s after 0 s"
    assert verdict("max_age: {below: 1 s, after: 2 s, links: 1->*}").asked == "below 1 s after 2 s, links 1->*"


# --- recovery_time ---------------------------------------------------------

SPLIT = "faults=[{at: 500 ms, for: 500 ms, id: split, partition: '1 / 2,3'}, {at: 3 s, mute: 2, for: 500 ms}]"


def back_at(tick: int, vehicle: int = 3) -> Callable[[int, int], float]:
    """A vehicle is a metre away from 0.6 s until a tick, then where it should be."""
    return lambda i, t: 1.0 if i == vehicle and 60 <= t < tick else 0.0


@pytest.mark.parametrize(
    ("check", "error", "passed", "found"),
    [
        ("{fault: split, below: 1 s, within: 10 cm}", back_at(150), True, "0.5 s (vehicle 3 the last)"),
        ("{fault: split, below: 500 ms, within: 10 cm}", back_at(150), False, "0.5 s (vehicle 3 the last)"),
        ("{fault: split, below: 1 s, within: 10 cm}", back_at(80), True, "0 s (vehicle 1 the last)"),
        ("{fault: split, below: 9 s, within: 10 cm}", back_at(350), False,
         "1 m (vehicle 3) when fault f2 begins at 3 s"),
        ("{fault: split, below: 9 s, within: 10 cm, vehicles: 1-2}", back_at(350), True, "0 s (vehicle 1 the last)"),
        # Away again before the next fault: it did not stay.
        ("{fault: split, below: 1 s, within: 10 cm}", lambda i, t: 1.0 if t == 299 else 0.0, False,
         "1 m (vehicle 1) when fault f2 begins at 3 s"),
        ("{fault: split, below: 1 s, within: 10 cm}", lambda i, t: 1.0 if i == 2 and t == 250 else 0.0, False,
         "1.51 s (vehicle 2 the last)"),
        # What happens after the next fault began is not this one's.
        ("{fault: split, below: 1 s, within: 10 cm}", lambda i, t: 1.0 if t >= 300 else 0.0, True,
         "0 s (vehicle 1 the last)"),
        ("{fault: f2, below: 1 s, within: 10 cm}", back_at(390), True, "0.4 s (vehicle 3 the last)"),
        # One frame within the limit shows nothing.
        ("{fault: f2, below: 1 s, within: 10 cm}", back_at(400), False,
         "0 m (vehicle 3) when the run ends, and not within 0.1 m for the last 0.05 s"),
        ("{fault: f2, below: 1 s, within: 10 cm}", back_at(999), False, "1 m (vehicle 3) when the run ends"),
        ("{fault: f2, below: 1 s, within: 10 cm, error: consensus}", back_at(999, 1), False,
         "2 m (vehicle 1) when the run ends"),
    ],
)  # fmt: skip
def test_recovery_time(check: str, error: Callable[[int, int], float], passed: bool, found: str) -> None:
    result = verdict(f"recovery_time: {check}", SPLIT, error=error)
    assert (result.check, result.outcome, result.found) == ("recovery_time", passed, found)


def test_recovery_under_a_periodic_disturbance_takes_two_periods_to_show() -> None:
    check = "recovery_time: {fault: split, below: 1 s, within: 10 cm}"
    result = verdict(check, SPLIT, "sea.disturbance=paper")
    expected = "0 m (vehicle 1) when fault f2 begins at 3 s, and not within 0.1 m for the last 12.6 s"
    assert (result.passed, result.found) == (False, expected)


def test_recovery_says_what_was_asked() -> None:
    result = verdict("recovery_time: {fault: split, below: 2 s, within: 10 cm, vehicles: 1-2}", SPLIT)
    assert result.asked == "formation error within 0.1 m, less than 2 s after fault split, vehicles 1-2"


def test_recovery_from_a_fault_that_goes_over_into_the_next() -> None:
    faults = "faults=[{at: 1 s, for: 1 s, mute: 2}, {at: 2 s, for: 1 s, mute: 3}]"
    result = verdict("recovery_time: {fault: f1, below: 2 s, within: 10 cm}", faults)
    assert (result.outcome, result.found) == (None, "fault f2 begins at 2 s, before any frame of the log")


def test_recovery_in_a_run_that_was_cut_short() -> None:
    """That is no mistake of the scenario, but nothing shows that the fleet recovers."""
    for faults in ("faults=[{at: 3 s, for: 2 s, mute: 2}]", "faults=[{at: 5 s, for: 1 s, mute: 2}]"):
        result = verdict("recovery_time: {fault: f1, below: 2 s, within: 10 cm}", faults)
        assert (result.outcome, result.found) == (None, "the run ended at 4 s, before the fault did")


def test_recovery_counts_from_a_heal() -> None:
    """Who heals a fault of a live run moves its end."""
    check = "recovery_time: {fault: split, below: 2 s, within: 10 cm}"
    assert verdict(check, SPLIT, error=back_at(150)).found == "0.5 s (vehicle 3 the last)"
    healed = verdict(check, SPLIT, error=back_at(150), before=lambda journal: journal.end_event("split", 80))
    assert healed.found == "0.7 s (vehicle 3 the last)"


NEMESIS = "nemesis={every: 1 s, for: 500 ms, pick: [mute, deaf]}"  # nemesis-1 from 1 s to 1.5 s, and so on


@pytest.mark.parametrize(
    ("fault", "overrides", "found"),
    [
        ("nemesis-1", [NEMESIS], "1 m (vehicle 3) when fault nemesis-2 begins at 2 s"),
        ("nemesis-2", [NEMESIS], "0.1 s (vehicle 3 the last)"),
        ("f1", ["faults=[{at: 1 s, for: 1 s, kill: 2}]"], "0.6 s (vehicle 3 the last)"),
        ("f1", ["faults=[{at: 1 s, gust: {velocity: 1 0 0 m/s, over: 500 ms}}]"], "1.1 s (vehicle 3 the last)"),
    ],
)
def test_recovery_from_what_ends_by_itself(fault: str, overrides: list[str], found: str) -> None:
    """The nemesis, a restart, a gust: whatever has an end in the timeline."""
    check = f"recovery_time: {{fault: {fault}, below: 9 s, within: 10 cm}}"
    assert verdict(check, *overrides, error=back_at(260)).found == found


def test_the_death_of_an_agent_is_a_beginning() -> None:
    check = "recovery_time: {fault: f1, below: 9 s, within: 10 cm}"
    faults = "faults=[{at: 1 s, for: 500 ms, mute: 2}]"
    died = Life(200, 3, False, False)
    result = verdict(check, faults, error=back_at(260), lives=lambda tick: (died,) if tick == died.tick else ())
    assert (result.passed, result.found) == (False, "1 m (vehicle 3) when fault death-3 begins at 2 s")


def test_recovery_from_each_of_several_faults(tmp_path: Path) -> None:
    """A list has a verdict for every entry; a run that goes over processes finds the same."""
    asked = "[{fault: split, below: 1 s, within: 10 cm}, {fault: f2, below: 10 s, within: 10 m}]"
    faults = "faults=[{at: 300 ms, for: 200 ms, id: split, partition: '1 / 2,3'}, {at: 1 s, mute: 2, for: 100 ms}]"
    found = []
    for in_process in (True, False):
        scenario = small(
            "duration=1.5 s", faults,
            f"checks={{recovery_time: {asked}, max_age: {{below: 1 s}}, min_separation: {{above: 1 m}}, "
            "connected: {window: 100 ms}}",
            "graph.reference=[1]",
        )  # fmt: skip
        result = execute(scenario, Options(tmp_path, in_process=in_process, quiet=True))
        assert result.status is Status.CHECK_FAILED, (result.reason, result.lines)
        found.append(result)
    assert found[0].checks == found[1].checks
    assert found[0].values["ages"] == found[1].values["ages"]
    assert [(v.check, v.passed) for v in found[0].checks] == [
        ("recovery_time", False), ("recovery_time", True), ("min_separation", True), ("max_age", True),
        ("connected", False), ("tumbled", False), ("deaths", True), ("qp_infeasible", True),
    ]  # fmt: skip


def test_recovery_from_every_fault(tmp_path: Path) -> None:
    """A verdict for each that ended before the run did; whoever wants none to have ended fails."""
    every = "checks={recovery_time: {fault: every, below: 10 s, within: 10 m}, tumbled: waived}"
    faults = (
        "faults=[{at: 300 ms, for: 200 ms, id: split, partition: '1 / 2,3'}, {at: 600 ms, mute: 2, for: 100 ms}, "
        "{at: 800 ms, mute: 1}]"
    )
    result = execute(small("duration=1 s", faults, every), Options(tmp_path, in_process=True, quiet=True))
    recoveries = [v for v in result.checks if v.check == "recovery_time"]
    assert [v.asked.rsplit("fault ")[1] for v in recoveries] == ["split", "f2"]
    assert result.status is Status.PASS
    again = script(result.directory)
    assert [check.fault for check in again.spec.checks.recovery_time or ()] == ["every"]
    none = execute(small("duration=1 s", "faults=[{at: 800 ms, mute: 1}]", every), Options(tmp_path, in_process=True))
    (found,) = (v for v in none.checks if v.check == "recovery_time")
    assert (found.outcome, found.found) == (None, "no fault ended while the run lasted")


@pytest.mark.parametrize(
    ("check", "limit", "unit", "passes"),
    [
        ("formation_error: {below: 2 m}", 2.0, "m", float.__lt__),
        ("formation_error: {below: 50 cm}", 0.5, "m", float.__lt__),
        ("recovery_time: {fault: split, below: 2 s, within: 10 cm}", 2.0, "s", float.__lt__),
        ("recovery_time: {fault: split, below: 100 ms, within: 10 cm}", 0.1, "s", float.__lt__),
        ("min_separation: {above: 1 m}", 1.0, "m", float.__gt__),
        ("min_separation: {above: 30 m}", 30.0, "m", float.__gt__),
        ("max_age: {below: 51 ms}", 0.051, "s", float.__lt__),
        ("ledger: balanced", 0.0, "links", float.__le__),
        ("qp_infeasible: {at_most: 0}", 0.0, "times", float.__le__),
        ("middleware_loss: {at_most: 0}", 0.0, "messages", float.__le__),
        ("connected: {window: 1 s}", 0.0, "windows", float.__le__),
    ],
)
def test_a_verdict_as_numbers(check: str, limit: float, unit: str, passes: Callable[[float, float], bool]) -> None:
    """result.json holds what was compared: the value, the limit and their unit give the verdict again."""
    found = verdict(check, SPLIT, error=back_at(120))
    assert (found.limit, found.unit) == (limit, unit)
    assert passes(float(found.value), limit) == found.passed


def test_what_was_never_found_is_no_number() -> None:
    values = json.loads(json_text(verdict("formation_error: {below: 1 m, after: 5 s}")))
    assert values["value"] is None and not values["passed"]


# --- min_separation --------------------------------------------------------


@pytest.mark.parametrize(
    ("check", "passed", "found"),
    [
        ("{above: 500 mm}", True, "at least 1 m (vehicles 1 and 2, 1 s)"),
        ("{above: 1 m}", False, "at least 1 m (vehicles 1 and 2, 1 s)"),
        ("{above: 1 m, after: 1.005 s}", True, "at least 5 m (vehicles 1 and 2, 1.01 s)"),
        ("{above: 1 m, vehicles: '2-3'}", True, "at least 5 m (vehicles 2 and 3, "),
        ("{above: 1 m, after: 5 s}", None, "the run ended at 4 s, before the check begins"),
    ],
)
def test_min_separation(check: str, passed: bool | None, found: str) -> None:
    """Vehicle 2, 5 m north or east of vehicle 1, comes to it at 1 s."""
    line = "formation={shape: line, spacing: 5 m, heading: 180 deg}"
    result = verdict(f"min_separation: {check}", line, error=lambda i, tick: -4.0 if (i, tick) == (2, 100) else 0.0)
    assert (result.check, result.outcome) == ("min_separation", passed)
    assert result.found.startswith(found)


# --- connected -------------------------------------------------------------


@pytest.mark.parametrize(
    ("check", "overrides", "heard", "passed", "found"),
    [
        ("{window: 50 ms, after: 1 s}", ["graph.reference=[1]"], lambda link, k: True, True, "in all 296 windows"),
        # Each link is there in turn, never two at once: the union over two rounds is what counts.
        ("{window: 100 ms, after: 1 s}", ["graph.reference=[1]"], lambda link, k: (link == (1, 2)) == (k % 10 == 0),
         True, "in all 291 windows"),
        ("{window: 50 ms, after: 1 s}", ["graph.reference=[1]"], lambda link, k: (link == (1, 2)) == (k % 10 == 0),
         False, "vehicle 3 not reached in the window that ends at 1.04 s, some until 3.99 s; 296 of 296 windows"),
        ("{window: 50 ms, after: 1 s}", ["graph.reference=[1]"], lambda link, k: k % 100 != 0, False,
         "vehicles 2, 3 not reached in the window that ends at 1.04 s, some until 1.05 s; 12 of 296 windows, "
         "3 stretches"),
        ("{window: 200 ms}", ["graph.reference=[1]"], lambda link, k: link != (1, 2) or not 200 <= k < 300, False,
         "vehicles 2, 3 not reached in the window that ends at 2.16 s, some until 3 s; 85 of 381 windows"),
        ("{window: 200 ms, vehicles: 1}", ["graph.reference=[1]"], lambda link, k: False, True,
         "each follows the reference itself"),
        ("{window: 200 ms}", [], lambda link, k: False, True, "each follows the reference itself"),
        ("{window: 1 s, after: 3 s}", ["graph.reference=[2]"], lambda link, k: True, True, "in all 1 windows"),
        ("{window: 2 s, after: 3 s}", [], lambda link, k: True, None,
         "the run ended at 4 s, before the first window did"),
    ],
)  # fmt: skip
def test_connected(
    check: str, overrides: list[str], heard: Callable[[Link, int], bool], passed: bool | None, found: str
) -> None:
    result = verdict(f"connected: {check}", *overrides, heard=heard)
    assert (result.check, result.outcome, result.found) == ("connected", passed, found)


def test_who_knows_the_reference_needs_nobody() -> None:
    """A check that cannot fail is warned of."""
    words = "checks.connected always holds"
    assert any(words in warning for warning in analyse(small("checks.connected={window: 1 s}")).warnings)
    led = small("checks.connected={window: 1 s}", "graph.reference=[1]")
    assert not any(words in warning for warning in analyse(led).warnings)


# --- asking ----------------------------------------------------------------

FAULTS = "faults=[{at: 100 ms, for: 100 ms, id: split, mute: 1}, {at: 300 ms, mute: 2}, {at: 500 ms, kill: 3}]"


@pytest.mark.parametrize(
    "checks",
    [
        "{max_age: {below: 2 s}}",
        "{max_age: {below: 2 s, after: 100 ms, links: 1<->2}}",
        "{recovery_time: {fault: split, below: 20 s, within: 10 cm}}",
        "{recovery_time: [{fault: split, below: 20 s, within: 10 cm, error: consensus, vehicles: 1-2}]}",
        "{recovery_time: [{fault: split, below: 20 s, within: 1 m}, {fault: split, below: 5 s, within: 2 m}]}",
        "{recovery_time: []}",
        "{min_separation: {above: 2 m, after: 1 s, vehicles: '1, 3'}}",
        "{connected: {window: 5 s, after: 1 s}}",
    ],
)
def test_checks_print_back(checks: str) -> None:
    read_back(small(FAULTS, f"checks={checks}"))


def test_one_recovery_prints_without_the_list() -> None:
    s = small(FAULTS, "checks={recovery_time: [{fault: split, below: 20 s, within: 10 cm}]}")
    assert "  recovery_time:\n    fault: split\n    below: 20 s\n    within: 0.1 m\n" in s.to_yaml()


NEMESES = st.sampled_from(
    [[], ["nemesis={every: 100 ms, for: 100 ms, pick: [down]}"], ["nemesis={every: 1 s, for: 3 s, pick: [{}, x]}"],
     ["nemesis={every: 100 ms, for: 50 ms, pick: [down]}", "vehicles=1"], ["faults=[{at: 0 s, link: {}}]"]]
)  # fmt: skip
KEYS = [
    f"{check}{key}"
    for check, keys in {
        "max_age": "below after links",
        "recovery_time": "fault below within error vehicles 1 1.fault 1.below 2.within",
        "min_separation": "above after vehicles",
        "connected": "window after vehicles",
    }.items()
    for key in ("", *(f".{key}" for key in keys.split()))
]
GOOD = st.sampled_from(
    ["split", "f2", "1 s", "5 m", "1-2", "1->2", "formation", "{fault: split, below: 1 s, within: 1 m}"]
)


@given(st.lists(st.tuples(st.sampled_from(KEYS), WILD | GOOD).map("=".join), min_size=1, max_size=8), NEMESES)
def test_any_check_is_accepted_or_a_scenario_error(overrides: list[str], drawn: list[str]) -> None:
    """Wrong values at every key, also of an entry without its list; what is accepted prints back."""
    full = "checks={recovery_time: [{fault: split, below: 1 s, within: 1 m}], max_age: {below: 1 s}}"
    accepted(FAULTS, full, *drawn, *(f"checks.{override}" for override in overrides))


def test_an_ideal_network_has_no_round_to_wait_for() -> None:
    small("network=ideal", "checks={max_age: {below: 10 ms}, connected: {window: 10 ms}}")


def test_scaling_drops_checks_of_what_is_gone() -> None:
    overrides = ["checks={recovery_time: {fault: f1, below: 1 s, within: 1 m}, max_age: {below: 1 s, links: 2->3}, "
                 "min_separation: {above: 1 m}, connected: {window: 1 s, vehicles: 1-3}}"]  # fmt: skip
    text = small("faults=[{at: 0 s, for: 100 ms, mute: 1}]", *overrides).to_yaml()
    checks = parse_scenario(text, "t.yaml", ["vehicles=1"]).spec.checks
    assert checks.model_dump(exclude_none=True) == {"min_separation": {"above": "1 m", "after": "0 s"}}
    assert parse_scenario(text, "t.yaml", ["vehicles=3"]).spec.checks.max_age is not None


def test_a_lonely_vehicle_hears_nobody_and_meets_nobody(tmp_path: Path) -> None:
    scenario = small(
        "vehicles=1", "checks={min_separation: {above: 1 m}, max_age: {below: 1 s}, connected: {window: 1 s}}"
    )
    result = execute(scenario, Options(tmp_path, in_process=True, quiet=True))
    assert [(v.passed, v.found) for v in result.checks][:3] == [
        (True, "one vehicle"), (True, "no link"), (True, "each follows the reference itself"),
    ]  # fmt: skip
    assert result.values["ages"] == {}


# --- what is shown and written ---------------------------------------------


def run(folder: Path, *overrides: str) -> Result:
    scenario = load_scenario("paper", ["checks={}", "log.every=50 ticks", *overrides])
    return execute(scenario, Options(folder, in_process=True, quiet=True))


def test_the_script_of_a_run_asks_nothing_that_cannot_be(tmp_path: Path) -> None:
    """A run cut short before a fault ended: its scenario has that fault to the end, or not at all."""
    asked = ", ".join(f"{{fault: {name}, below: 1 s, within: 20 m}}" for name in "abc")
    faults = (
        "faults=[{at: 100 ms, for: 100 ms, id: a, mute: 1}, {at: 300 ms, for: 9 s, id: b, mute: 2}, "
        "{at: 9 s, for: 1 s, id: c, deaf: 1}]"
    )
    result = run(tmp_path, "duration=500 ms", faults, f"checks={{recovery_time: [{asked}]}}", "log.every=10 ticks")
    assert [v.outcome for v in result.checks if v.check == "recovery_time"] == [True, None, None]
    again = script(result.directory)
    assert [check.fault for check in again.spec.checks.recovery_time or ()] == ["a"]


def test_ages_stand_beside_the_ledger(tmp_path: Path) -> None:
    values = run(tmp_path, "duration=1 s", "network.links.3->4=down").values
    assert list(values["ages"]) == ["*", *values["ledger"]]
    assert values["ages"]["1->2"] == {"mean_s": pytest.approx(0.054), "p95_s": 0.1, "max_s": 0.1}
    assert values["ages"]["3->4"] == {"mean_s": pytest.approx(0.495), "p95_s": 0.94, "max_s": 0.99}
    assert json.loads((tmp_path / "latest" / "result.json").read_text())["ages"] == values["ages"]


def test_what_was_replaced_is_not_called_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Payloads that news overtook in the modem have a column of their own, and do not count on the progress line."""
    from rich.console import Console

    from fleet.execution.progress import ProgressLine
    from fleet.terminal.line import fit
    from fleet.terminal.status_line import StatusLine

    water = "network={period: 1 s, payload: compact, acoustic: {modem: mfsk-1066, mac: tdma, slot: 1500 ms}}"
    scenario = small("duration=8 s", water)
    result = execute(scenario, Options(tmp_path, in_process=True, quiet=True))
    show(result, Console(width=100))
    said = capsys.readouterr().out
    assert "replaced" in said and "lost: replaced" not in said
    journal = Journal(scenario, Nowhere())
    journal.ledger.settle([Fate(k, 1, 2, k, 0, k, k, 0, cause, False, b"") for k, cause in
                           enumerate(("delivered", "replaced", "replaced", "snr"))])  # fmt: skip
    line = ProgressLine(scenario, journal, StatusLine(Console(quiet=True), quiet=True), str)
    assert "packets 1 delivered, 1 lost, 2 replaced" in fit(line._pieces(1.0, ""))
