"""Explanations of failures whose reason is known: a partition, a protocol that is too slow by design, and a drift."""

from __future__ import annotations

import json
from contextlib import nullcontext
from itertools import cycle
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from in_process_runs import recorded as run
from marks import slow
from msgspec import structs
from refusals import check_commands
from small_scenario import SMALL
from study_engine import Here
from tool import invoke

from fleet.addons.pictures.style import panels
from fleet.addons.studies.engine import local_engine
from fleet.addons.studies.explanation.evidence import evidence, first_older
from fleet.addons.studies.explanation.no_return import HealingSearch, remake, without_faults_after
from fleet.addons.studies.explanation.picture import _lanes
from fleet.addons.studies.explanation.why import Explanation, Question, Why, lines
from fleet.addons.studies.modules import NO_MODULES
from fleet.addons.studies.one_run import Task, make_run
from fleet.addons.studies.row import CheckRow
from fleet.addons.studies.shrink import tree_of
from fleet.errors import FleetError
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.wiring import Wiring
from fleet.logs.open_log import Log, open_log
from fleet.logs.topic_names import link_topic
from fleet.repeat.resume import continuation
from fleet.scenario.loading import parse_scenario

LONGER = SMALL.replace("duration: 1 s", "duration: 2 s\ntick: 50 ms")
PUSH = "faults: [{at: 300 ms, for: 1500 ms, id: push, wrench: {vehicles: 1, force: -40 0 0 N}}]\n"
TIGHT = "checks: {formation_error: {below: 5.5 m, vehicles: 1}, tumbled: waived}\n"


# What decides is when messages arrive, so these runs, which are made again and again, may have a coarse step.
COARSE, COARSER = ("tick=50 ms", "log.every=1 tick"), ("tick=100 ms", "log.every=1 tick")


def recorded(folder: Path, name: str, *overrides: str) -> Path:
    directory = run(folder, name, *overrides).directory
    assert directory is not None
    return directory


def explained(log: Path, check: str | None = None, most_runs: int = 24) -> Why:
    explanation = Explanation(Question(log, check, most_runs), lambda doing, runs: None)
    return explanation.find(Here(), NO_MODULES) if explanation.searches else explanation.without_runs()


@pytest.fixture(scope="module")
def small_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A push of 1.5 s that takes vehicle 1 out of its place."""
    folder = tmp_path_factory.mktemp("small")
    (folder / "small.yaml").write_text(LONGER + PUSH + TIGHT, "utf-8")
    return recorded(folder, str(folder / "small.yaml"))


@pytest.fixture(scope="module")
def small_lossy(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """Three seconds of links that lose two messages of three."""
    folder = tmp_path_factory.mktemp("lossy")
    text = LONGER.replace("duration: 2 s", "duration: 3 s").replace(
        "{period: 50 ms", "{period: 50 ms, links: {'*': loss 65%}"
    )
    (folder / "lossy.yaml").write_text(text, "utf-8")
    return open_log(recorded(folder, str(folder / "lossy.yaml")), ["link/*"])


@pytest.fixture(scope="module")
def why(small_log: Path) -> Why:
    """Its explanation."""
    return explained(small_log)


def test_a_partition(tmp_path: Path) -> None:
    """From 3 to 15 s 1 and 2 do not hear 3 and 4. After 5 s of silence both halves claim place 4."""
    why = explained(recorded(tmp_path, "auction-partition", "duration=9600 ms", *COARSE), "NoConflict")
    assert (pytest.approx(9.45), why.others) == (why.at_s, ["AllVisited"])
    assert [(f.id, f.from_s, f.on) for f in why.faults] == [("split", 3.0, True)]
    (gap,) = why.gaps
    assert sorted(gap.links) == ["1->4", "2->3", "3->2", "4->1"]  # all links of the ring between the halves
    assert (gap.cause, gap.from_s, gap.to_s, gap.goes_on) == ("partition", 3.0, 9.4, True)
    assert why.lost == {"partition": gap.messages}
    heard = {one.vehicle: one.sent_s for one in why.vehicles[2].heard}
    assert heard == {2: 2.9, 4: 9.4}
    assert why.no_return.passes_s == 9.0  # a claim of both must last for 1.5 s to be a conflict
    assert why.no_return.fails_s is None


def test_a_run_that_goes_on_from_another_with_another_controller(tmp_path: Path) -> None:
    check = "checks={formation_error: {below: 50 m, after: 2 s}}"
    first = recorded(tmp_path, "rough-sea", "duration=3 s", check)
    scenario, start = continuation(first, 1_000_000_000, ["controller=boc", "checks.formation_error.below=1 cm"])
    result = execute(scenario, Options(tmp_path, in_process=True, quiet=True), wiring=Wiring(start=start))
    assert result.directory is not None
    why = explained(result.directory)
    assert why.differs == ["controller: boc, there nboc", "checks.formation_error.below: 0.01 m, there 50 m"]
    assert why.origin_passed is True
    text = lines(why)
    assert text.index("changed since the run that it goes on from, and this check passed there") < min(
        k for k, line in enumerate(text) if line.startswith(("faults", "no fault", "messages", "all"))
    )
    again = Path(next(word for word in why.no_return.words.split() if word.endswith("scenario.yaml")))
    assert again.exists() and "fleet run" in why.no_return.words
    error = open_log(result.directory, ["uuv/*/error"])
    topics = (error[name] for name in error if len(error[name]))
    over = [topic.t[(topic.t >= 2.0) & (topic.formation_norm >= 0.01)] for topic in topics]
    assert why.failed_s == min(times[0] for times in over if len(times))


def test_the_silence_of_which_it_failed_comes_first(tmp_path: Path) -> None:
    """Not the shorter ones that still go on, nor an earlier one."""
    down = """
faults:
  - {at: 100 ms, for: 500 ms, link: {3->2: down}}
  - {at: 700 ms, for: 800 ms, link: {2->1: down}}
"""
    text = LONGER.replace("{period: 50 ms", "{period: 50 ms, links: {'*': loss 30%, 2->1: loss 0%}")
    (tmp_path / "silent.yaml").write_text(text + down + "checks: {max_age: {below: 750 ms, links: 2->1}}\n", "utf-8")
    why = explained(recorded(tmp_path, str(tmp_path / "silent.yaml")), most_runs=0)
    assert (why.held_until_s, why.failed_s) == (pytest.approx(1.4), pytest.approx(1.4))  # the newest is of 650 ms
    assert (why.gaps[0].links, why.gaps[0].messages) == (["2->1"], 15)


def test_a_sender_that_stopped_comes_before_random_losses(tmp_path: Path) -> None:
    """Killed, paused and restarted senders were not told, and losses of single messages in their place."""
    faults = "faults=[{at: 1 s, for: 2 s, kill: 4}, {at: 4 s, for: 2 s, pause: 2}, {at: 8 s, kill: 3}]"
    loss, check = "network.links={'*': loss 20%}", "checks={max_age: {below: 1500 ms, after: 8 s}, tumbled: waived}"
    log = recorded(tmp_path, "kill-restart", "duration=12 s", faults, loss, check, *COARSE)
    why = explained(log, "max_age", 0)
    text = "\n".join(lines(why))
    first = next(line for line in text.splitlines() if "sent nothing" in line or "message," in line)
    assert first.split() == ["vehicle", "3", "sent", "nothing", "after", "7.9", "s"]
    silent = [(gap.links[0][0], gap.from_s, gap.to_s) for gap in why.gaps if gap.cause == "not sent"]
    assert silent == [("3", 7.9, why.at_s), ("2", 3.9, 6.0), ("4", 0.9, 3.0)]
    across = [gap for gap in why.gaps if gap.links == ["2->1"] and gap.from_s < 5.0 < gap.to_s]
    assert across == []  # losses before and after a pause are two gaps
    lives = {then.vehicle: (then.life, then.life_since_s) for then in why.vehicles}
    assert lives == {1: (1, 0.0), 2: (1, 0.0), 3: (1, 0.0), 4: (2, 3.0)}
    assert "vehicle 4 (life 2, since 3 s; it began without memory)" in text
    named = "\n".join(lines(structs.replace(why, nodes=["auv1", "auv2", "auv3", "ship"])))
    assert "auv3 sent nothing after 7.9 s" in named and "latest from auv2: sent at" in named
    assert "vehicle 3" not in named.partition("\n\n")[2]


def test_messages_that_are_held_come_before_ordinary_losses(tmp_path: Path) -> None:
    """They were sorted behind whatever was lost, however long they had been on the way."""
    faults = "faults=[{at: 3 s, for: 5 s, hold: 2->1}]"
    loss, check = "network.links={'*': loss 20%}", "checks={max_age: {below: 2 s, links: 2->1}, tumbled: waived}"
    why = explained(recorded(tmp_path, "kill-restart", "duration=9 s", faults, loss, check, *COARSE), "max_age", 0)
    assert (why.gaps[0].links, why.gaps[0].cause, why.gaps[0].goes_on) == (["2->1"], "on the way", True)
    assert why.gaps[0].to_s - why.gaps[0].from_s > 1.5


def test_what_becomes_of_a_message_later_is_no_cause(tmp_path: Path) -> None:
    """A message that is on the way when the check fails, to an agent that is killed before it comes."""
    faults = "faults=[{at: 8 s, kill: 1}]"
    slow, check = "network.links={'*': delay 2500ms}", "checks={max_age: {below: 2 s, after: 6 s}, tumbled: waived}"
    log = recorded(tmp_path, "kill-restart", "duration=12 s", faults, slow, check, *COARSE)
    assert "dead receiver" in open_log(log, ["link/*"])["link/2-1"]["fate"].tolist()
    why = explained(log, "max_age", 0)
    assert why.at_s < 8.0 and set(why.lost) == {"on the way"}


def test_the_pause_of_the_vehicle_that_failed_comes_before_losses_on_its_links(tmp_path: Path) -> None:
    """It is over, and no message to it is missing: what it did not send shows that it stood still."""
    faults = "faults=[{at: 4 s, for: 3 s, pause: 2}]"
    loss = "network.links={'*': loss 35%}"
    log = recorded(tmp_path, "kill-restart", "duration=9 s", faults, loss, "checks={tumbled: waived}", *COARSE)
    then = evidence(open_log(log), 8.0, [], [2], protocol=False)
    assert (then.gaps[0].cause, then.gaps[0].links[0][0], then.gaps[0].from_s) == ("not sent", "2", 3.9)


@given(st.integers(0, 8), st.integers(1, 30), st.integers(0, 60), st.booleans())
@example(0, 1, 59, False)  # in the last sample
def test_an_age_fails_at_the_first_tick_at_which_it_is_too_old(
    small_lossy: Log, link: int, below: int, after: int, from_first_packet: bool
) -> None:
    """It was told as the time of the greatest age: 79.455 s in place of 31 s."""
    log, tick_s = small_lossy, 0.05
    chosen = log.links[link % len(log.links)]
    topic = log[link_topic(chosen)]
    arrived = [(round(due / tick_s), round(sent / tick_s))
               for due, sent, fate in zip(topic["due"], topic["sent"], topic["fate"], strict=True)
               if fate == "delivered"]  # fmt: skip
    begin = round(topic["sent"].min() / tick_s) if from_first_packet else 0
    ages = {t: t - max([begin, *(sent for due, sent in arrived if due <= t)]) for t in range(begin, 60)}
    expected = next((t for t, age in ages.items() if t >= after and age >= below), None)
    found = first_older(log, [chosen], below * tick_s, after * tick_s, log.end, from_first_packet=from_first_packet)
    assert (None if found is None else round(found[0] / tick_s)) == expected
    assert found is None or found[1] == chosen


@pytest.mark.parametrize(("from_first_packet", "found"), [(True, None), (False, (1.0, (1, 2)))])
def test_the_age_of_a_link_without_a_packet(from_first_packet: bool, found: tuple[float, Any] | None) -> None:
    """Of nodes it has not begun, of vehicles it counts from the beginning."""

    class Quiet:
        """A log in which the link carries nothing."""

        links, begin, end = ((1, 2),), 0.0, 0.0

        def __getitem__(self, topic: str) -> Any:
            return columns

    class Columns(dict[str, Any]):
        def __missing__(self, field: str) -> Any:
            return np.array([], float)

    columns, log = Columns(), Quiet()
    # The run may have ended long after the last message of its log.
    for end_s, older in ((5.0, found), (0.5, None)):
        assert first_older(log, [(1, 2)], 1.0, 0.0, end_s, from_first_packet=from_first_packet) == older  # type: ignore[arg-type]


def test_a_check_that_is_not_there_is_said_before_anything_is_run(small_log: Path) -> None:
    asked: list[str] = []
    with pytest.raises(FleetError, match="there is no check nosuch; it has formation_error"):
        Explanation(Question(small_log, "nosuch"), lambda doing, runs: asked.append(doing))
    assert not any("once more" in doing for doing in asked)


def test_a_protocol_that_is_too_slow(tmp_path: Path) -> None:
    """Each link takes 1.5 s and nothing is lost: two leaders, whatever is healed."""
    why = explained(recorded(tmp_path, "election-slow", "duration=7 s", *COARSER), "AtMostOneLeader")
    assert why.at_s == 5.5
    assert why.faults == []
    assert set(why.lost) == {"on the way"}
    leads = {then.vehicle: then.signals["control.leads"] for then in why.vehicles}
    assert leads == {1: 1.0, 2: 1.0, 3: 0.0, 4: 0.0, 5: 0.0}
    assert {one.age_s for then in why.vehicles for one in then.heard} == {1.5}
    assert why.no_return.how == "not needed"


def test_healing_does_not_help_a_protocol_that_is_too_slow(tmp_path: Path) -> None:
    """A fault that has nothing to do with it."""
    faults = "faults=[{at: 1 s, for: 3 s, noise: {vehicles: 4, position_noise: 1 cm}}]"
    why = explained(recorded(tmp_path, "election-slow", "duration=7 s", faults, *COARSER), "AtMostOneLeader", 2)
    assert why.no_return.passes_s is None
    assert why.no_return.words.startswith("it fails even without faults (")
    assert [(fault.what.partition(" ")[0], fault.on) for fault in why.faults] == [("noise", False)]


@pytest.mark.slow
def test_a_drift(tmp_path: Path) -> None:
    """No aid has a fix from 20 s on: the vehicles drift, and all believe that they are where they should be."""
    why = explained(recorded(tmp_path, "formation-no-fixes"), "formation_error")
    assert why.held_until_s == why.at_s == pytest.approx(108.6)
    assert [(fault.from_s, fault.on) for fault in why.faults] == [(20.0, True)]
    fifth = why.vehicles[4]
    assert fifth.off_m is not None
    assert fifth.signals["error.formation_norm"] == pytest.approx(fifth.off_m, rel=0.1)  # it is off by what it is wrong
    assert (why.no_return.passes_s, why.no_return.fails_s) == (104.0, 106.0)


def test_a_push(why: Why, small_log: Path) -> None:
    assert (why.check, why.faults[0].id, why.faults[0].on) == ("formation_error", "push", True)
    error = open_log(small_log, ["uuv/1/error"])["uuv/1/error"]
    assert why.held_until_s == why.at_s == pytest.approx(error.t[error.formation_norm >= 5.5][0])
    found = why.no_return
    assert found.how == "bisected"
    assert found.passes_s is not None
    assert found.fails_s is not None
    assert 0.3 <= found.passes_s < found.fails_s <= why.at_s


@pytest.mark.parametrize("backwards", [False, True])
def test_whoever_makes_the_runs(small_log: Path, why: Why, backwards: bool) -> None:
    explanation = Explanation(Question(small_log, None, 24), lambda doing, runs: None)
    assert explanation.find(Here(backwards=backwards), NO_MODULES) == why


@pytest.mark.parametrize(
    "faults",
    [
        "{at: 400 ms, kill: 1}, {at: 700 ms, for: 300 ms, kill: 1-2}, {at: 1500 ms, kill: 3}",
        "{at: 300 ms, for: 1 s, hold: 1->2}, {at: 600 ms, for: 1 s, partition: 1 / 2 / 3}, {at: 700 ms, stuck: 3}",
        *slow(
            "{at: 300 ms, for: 1500 ms, wrench: {vehicles: 1, force: -40 0 0 N}}, {at: 1 s, for: 200 ms, mute: 2}",
            "{at: 300 ms, for: 1 s, pause: 2}, {at: 600 ms, for: 1 s, link 1->2: loss 50 %}",
            "{at: 200 ms, for: 900 ms, freeze: 1}, {at: 300 ms, for: 1 s, slow: {vehicles: 2, by: 7 ticks}}",
        ),
    ],
)
def test_a_run_that_is_healed_on_the_way_is_that_of_the_healed_scenario(faults: str) -> None:
    """To its verdicts and margins, in a copy of a worker, and in this process, which has other threads."""
    recovery = "checks: {recovery_time: {fault: every, below: 500 ms, within: 10 m}, max_age: {below: 200 ms}, "
    text = f"{LONGER}faults: [{faults}]\n{recovery}formation_error: {{below: 5 m}}, tumbled: waived}}\n"
    scenario = parse_scenario(text, "small.yaml")
    tree, ticks = tree_of(scenario), (4, 12, 18, 26, 34)
    each = tuple((tick, json.dumps(without_faults_after(tree, tick * scenario.tick_ns))) for tick in ticks)
    asked = Task("on the way", 0, scenario.seed, scenario.name, json.dumps(tree), 60.0, healed=each)
    alone = [asked._replace(key=str(tick), text=text, healed=()) for tick, text in each]
    rows = {}
    with local_engine(1) as engine:
        engine.make(iter([asked]), lambda more: rows.update({row.key: row for row in more}), lambda: None)
    for found in (rows["on the way"], make_run(asked)):
        assert not found.reason
        expected = [make_run(task) for task in alone]
        assert [one.checks for one in found.futures] == [one.checks for one in expected]


def test_where_passing_has_no_order_that_is_said(small_log: Path) -> None:
    """Some moments are tried over all of the time, and the last that passes counts."""

    class Unordered(Here):
        def rows(self, task):  # type: ignore[no-untyped-def]
            row = super().rows(task)[0]
            passes = cycle((False, True))
            for future in row.futures:
                future.checks["formation_error"] = CheckRow(next(passes))
            return [row]

    explanation = Explanation(Question(small_log, None, 24), lambda doing, runs: None)
    found = explanation.find(Unordered(), NO_MODULES).no_return
    assert found.how == "scanned"
    assert "some that were healed earlier do not pass" in found.words


def test_what_healing_leaves_of_a_scenario() -> None:
    tree = {
        "faults": [{"at": "1 s", "for": "2 s", "kill": "1"}, {"at": "2 s", "id": "on", "deaf": "2"},
                   {"at": "5 s", "id": "later", "mute": "2"}],
        "checks": {"recovery_time": [{"fault": "later", "below": "1 s"}, {"fault": "every", "below": "1 s"}],
                   "signal": {"topic": "state.z", "fault": "later"}},
    }  # fmt: skip
    found = without_faults_after(tree, 2_500_000_000)
    assert found["faults"] == [
        {"id": "f1", "at": "1 s", "for": "1.5 s", "kill": "1"}, {"id": "on", "at": "2 s", "for": "500 ms", "deaf": "2"},
    ]  # fmt: skip
    assert found["checks"] == {"recovery_time": [{"fault": "every", "below": "1 s"}]}
    assert without_faults_after(tree, 0)["faults"] == []
    assert without_faults_after(tree, 3_500_000_000)["faults"][0] == tree["faults"][0] | {
        "id": "f1"
    }  # it is over by then


def test_signals_that_are_true_or_false_have_lanes_of_their_own() -> None:
    """Lines at 0 and 1 hid each other, and a step was a ramp."""
    _, (ax,) = panels(1, 1)
    t = np.array([0.0, 1.0, 2.0])
    _lanes(ax, {3: (t, np.array([0.0, 1.0, 1.0])), 5: (t, np.array([0.0, 0.0, 1.0]))})
    assert [label.get_text() for label in ax.get_yticklabels()] == ["vehicle 5", "vehicle 3"]
    extents = {line.get_gid(): (min(line.get_ydata()), max(line.get_ydata())) for line in ax.lines}
    assert extents["step-5"][1] < extents["step-3"][0]
    assert {line.get_drawstyle() for line in ax.lines} == {"steps-post"}
    assert len({line.get_color() for line in ax.lines}) == 2


@pytest.mark.usefixtures("coarse")
def test_the_command(small_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.addons.studies.engine.engine_of", lambda *_: nullcontext(Here()))
    picture = tmp_path / "why.png"
    result = invoke("why", small_log, "--picture", picture)
    assert result.exit_code == 0, result.output
    assert "small, seed 1: formation_error failed" in result.stdout
    assert "the point of no return" in result.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    document = json.loads(invoke("why", small_log, "--json", "--budget", 0).stdout)
    assert (document["check"], document["no_return"]["how"]) == ("formation_error", "not possible")


def test_what_cannot_be_explained(small_log: Path, tmp_path: Path) -> None:
    passed = recorded(tmp_path, "ideal", "duration=200 ms", "checks={tumbled: waived}")
    check_commands("repeat/what cannot be explained", {"PASSED": passed, "LOG": small_log, "HERE": tmp_path}, "why")


def test_a_run_that_cannot_be_made_again_is_explained_by_its_log(
    small_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "fleet.addons.studies.explanation.why._why_not", lambda *_: "the agent of vehicle 3 is external"
    )
    why = explained(small_log)
    assert (why.check, why.no_return.how) == ("formation_error", "not possible")
    assert why.no_return.words == "the agent of vehicle 3 is external"
    copytree(small_log, tmp_path / "bare")
    (tmp_path / "bare" / "result.json").unlink()
    result = invoke("why", tmp_path / "bare")
    assert result.exit_code == 2 and "there is no verdict to explain" in " ".join(result.stderr.split())


def test_the_words_are_of_the_log(small_log: Path) -> None:
    text = "\n".join(lines(explained(small_log, most_runs=0)))
    assert "on     since 0.3 s: wrench" in text
    assert "vehicle 1: error.formation_norm" in text


def test_a_fault_that_is_over_changes_nothing_by_its_healing() -> None:
    """Its moments need no run: each is the run itself, which fails."""
    text = LONGER + PUSH.replace("1500 ms", "100 ms").replace("-40", "-600") + TIGHT
    scenario = parse_scenario(text, "small.yaml")
    search = HealingSearch(remake(scenario, lambda share: None), "formation_error", Here(), lambda doing, runs: None)
    assert max(one.tick for one in search._moments) * scenario.tick_ns < 400_000_000


def test_of_a_log_that_ends_before_the_check_fails(small_log: Path, tmp_path: Path) -> None:
    """As a run that was stopped leaves it: the run is made again to its end, and the log tells as far as it goes."""
    log = small_log / "run.mcap"
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    why = explained(cut)
    assert why.at_s < why.failed_s == explained(small_log, most_runs=0).failed_s
    assert f"the log ends at {why.at_s:g} s, before the check fails" in why.notes[0]
    assert f"it failed at {why.failed_s:g} s" in "\n".join(lines(why))


def test_whole_numbers_stand_in_lanes() -> None:
    """Lines at 0, 1 and 2 hid each other, on an axis that counted in quarters; a gap belongs to no number."""
    _, (ax,) = panels(1, 1)
    ax.set_xlim(0.0, 6.0)
    t = np.array([0.0, 2.0, 3.0, np.nan, 5.0, 6.0])
    values = np.array([0.0, 2.0, 2.0, np.nan, 1.0, 1.0])
    _lanes(ax, {1: (t, values), 2: (t, np.full(6, 2.0))})
    told = {(text.get_gid(), text.get_text(), text.get_position()[0]) for text in ax.texts}
    assert told == {("value-1", "0", 1.0), ("value-1", "2", 2.5), ("value-1", "1", 5.5), ("value-2", "2", 3.0)}
