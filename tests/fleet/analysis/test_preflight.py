"""What is told before a run: checks that cannot pass, faults that do nothing, logs that grow large."""

from __future__ import annotations

import pytest
from in_process_runs import Alone
from small_scenario import small

from fleet.analysis.preflight import LARGE_MB, log_mb, warnings
from fleet.scenario.catalogue import list_scenarios
from fleet.scenario.loading import load_scenario

WATER = "network={period: 1 s, payload: compact, acoustic: {modem: mfsk-1066, mac: tdma, slot: 1500 ms, guard: 200 ms}}"


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["checks={formation_error: {below: 1 m, after: 4001 ms}}"], "formation_error cannot pass: it begins after 4"),
        (["checks={formation_error: {below: 1 m, after: 4 s}}"], ""),  # the last frame is judged
        (["checks={max_age: {below: 1 s, after: 4 s}}"], "max_age cannot pass: it begins after 4 s"),
        (["checks={max_age: {below: 60 ms}}"], ""),
        (
            ["checks={max_age: {below: 100 ms}}", "network.links={'*': delay 60ms}"],
            "up to 0.1 s old, and the limit is 0.1 s",
        ),
        ([WATER, "checks={max_age: {below: 3 s}}"], "max_age can hardly pass"),
        (["checks={connected: {window: 3 s, after: 2 s}}", "graph.reference=[1]"], "its first window ends at 5 s"),
        (["checks={min_separation: {above: 5 m}}"], "vehicles 1 and 2 end 5 m apart"),
        (["checks={min_separation: {above: 4.9 m}}"], ""),
        (["faults=[{at: 1 s, for: 40 ms, mute: 2}]"], ""),
        (["faults=[{at: 1010 ms, for: 40 ms, id: blip, mute: 2}]"], "fault blip does nothing: agents talk at round"),
        (["faults=[{at: 1010 ms, for: 50 ms, mute: 2}]"], ""),
        (["faults=[{at: 1010 ms, for: 40 ms, pause: 2}]"], ""),
        ([WATER, "faults=[{at: 1100 ms, for: 400 ms, down: 1<->2}]"], "no round tick lies between 1.1 and 1.5 s"),
        (["network.links={'*': loss 10% 25%}"], '"loss 10% 25%" affects 1.75% of the packets'),
        (["network.links={'*': loss 10% 50%}"], '"loss 10% 50%" affects 0.108% of the packets'),
        (["network.links={'*': delay 1ms reorder 25% 50%}"], '"reorder 25% 50%" affects 6.94% of the packets'),
        (["faults=[{at: 1 s, for: 1 s, link 1<->2: loss 1% 90%}]"], "less than one packet in a million"),
        (["network.links={'*': delay 9ms 1ms 25%}"], "the correlation 25% of a delay has no effect"),
        (["network.links={'*': loss 10% delay 9ms 1ms}"], ""),
        (["duration=2000 s"], "log will have about"),
        (["duration=2000 s", "log.every=10 ticks"], ""),
    ],
)
def test_doubts(overrides: list[str], words: str) -> None:
    found = warnings(small("duration=4 s", *overrides))
    assert (len(found) == 1 and words in found[0]) if words else found == [], found


AVERAGE = "agent={law: 'fleet.protocols.average:ExactAverage', parameters: {%s}}"


@pytest.mark.parametrize(
    ("parameters", "network", "words"),
    [
        ("forget_after_s: 2", "loss 60%", "4e-05; forget_after_s: 2.3 makes it 1e-05"),
        ("", "loss 80%", "= 2 s, and the link 2->1 loses 80%"),  # the default of the class
        ("forget_after_s: 5", "loss 80%", "forget_after_s: 5.2 makes it 1e-05"),
        ("forget_after_s: 5.2", "loss 80%", ""),
        ("forget_after_s: 10", "loss 90%", "forget_after_s: 11 makes it 1e-05"),
        ("forget_after_s: 2", "loss 50%", ""),
        ("forget_after_s: 2", "loss 100%", ""),  # silent for good
    ],
)
def test_doubts_about_a_time_after_which_neighbours_are_forgotten(parameters: str, network: str, words: str) -> None:
    found = warnings(small(AVERAGE % parameters, "network.period=100 ms", f"network.links={{'*': {network}}}"))
    assert (len(found) == 1 and words in found[0]) if words else found == [], found


def test_doubts_about_forgetting_during_a_fault() -> None:
    fault = "faults=[{at: 100 ms, for: 500 ms, link 3->2: loss 80%}]"
    (found,) = warnings(small(AVERAGE % "forget_after_s: 2", "network.period=100 ms", fault))
    assert found.startswith(
        "agent 2 takes a neighbour for gone after forget_after_s = 2 s, and the link 3->2 loses 80%"
    )


RECOVERY = "checks={recovery_time: {fault: %s, below: 1 s, within: 1 m}}"


@pytest.mark.parametrize(
    ("asked", "faults", "words"),
    [
        ("f1", "[{at: 1 s, for: 1 s, mute: 2}]", ""),
        ("every", "[{at: 1 s, for: 1 s, mute: 2}, {at: 3 s, mute: 1}]", ""),
        ("every", "[{at: 1 s, mute: 2}]", "cannot pass: no fault ends before the run does"),
        ("f1", "[{at: 3 s, for: 2 s, mute: 2}]", "the run ends at 4 s, before fault f1 does"),
        (
            "every",
            "[{at: 1 s, for: 1 s, mute: 2}, {at: 2 s, for: 1 s, mute: 1}]",
            "f2 begins when fault f1 ends, at 2 s",
        ),
    ],
)
def test_doubts_about_recovery(asked: str, faults: str, words: str) -> None:
    found = warnings(small("duration=4 s", f"faults={faults}", RECOVERY % asked))
    assert (len(found) == 1 and words in found[0]) if words else found == [], found


def test_doubts_about_a_recovery_that_cannot_show_in_time() -> None:
    """Between the waves of a periodic disturbance an error is small for a moment."""
    asked = ["faults=[{at: 1 s, for: 1 s, mute: 2}]", RECOVERY % "f1", "sea.disturbance=paper"]
    (found,) = warnings(small("duration=4 s", *asked))
    assert "fault f1 leaves 2 s to recover, and in this disturbance an error must stay within its limit" in found
    assert warnings(small("duration=20 s", *asked)) == []


def test_nothing_is_doubted_of_what_ships() -> None:
    assert {row.name: found for row in list_scenarios() if (found := warnings(load_scenario(row.name)))} == {}


def test_the_size_of_a_log_is_foreseen(made: Alone) -> None:
    """Within a third of what it becomes, and the result says what it was."""
    for n, every in enumerate(("1 tick", "10 ticks")):
        asked = ["duration=5 s", "checks={}", f"log.every={every}"]
        scenario, result = load_scenario("rough-sea", asked), made("rough-sea", *asked)
        written = result.values["log_bytes"]
        assert written == (result.directory / "run.mcap").stat().st_size
        # The index and the topics' declarations weigh more in a short log.
        assert (
            log_mb(scenario) == pytest.approx(written / 1e6, rel=0.33 if n == 0 else 0.5) and written < LARGE_MB * 1e6
        )
