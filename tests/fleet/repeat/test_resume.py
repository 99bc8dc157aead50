"""A run goes on from a moment of its log: the rest is the same to the last bit, or changed where it is asked for."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from failing_laws import failing
from failing_laws import module as module
from fault_histories import EVERYTHING
from in_process_runs import Alone
from marks import slow
from mcap.reader import make_reader
from mcap.writer import Writer
from ranged import DYING
from refusals import check_commands
from small_scenario import small
from tool import invoke

from fleet.addons.page.log_feed import LogFeed
from fleet.addons.pictures.axes import time_axes
from fleet.addons.pictures.exchange import peak_ages
from fleet.addons.pictures.runs import View, load
from fleet.errors import FleetError
from fleet.execution.execute import _policy, execute
from fleet.execution.options import Options
from fleet.execution.triggered import resolve_triggers
from fleet.execution.wiring import Wiring
from fleet.logs.open_log import open_log
from fleet.logs.schemas import OLD_START
from fleet.mcap.reader import LogReader, Record
from fleet.recorder.start import Start
from fleet.repeat.recorded_run import script
from fleet.repeat.resume import continuation, parse_from
from fleet.repeat.verify import verification_lines, verify
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.log_rates import moment_grid
from fleet.scenario.text.overrides import FAULT, NET, Override

CHANGING = (
    "network.links={'*': {states: {good: {mean: 300 ms}, bad: {condition: loss 50% rate 2kbit, mean: 200 ms}}}, "
    '1->2: {trace: "time [s],delivered,delay [ms]\\n0,1,50\\n0.3,0,\\n0.4,1,120.5\\n", loop: true, offset: random}}'
)
LINKS = 'network.links={"*": delay 60ms 30ms 20% loss gemodel 10% 30% duplicate 20% corrupt 20% rate 20kbit}'
INSTRUMENTS = (
    "faults=[{at: 1 s, for: 1 s, dvl: {lost: 50 %}}, {at: 1 s, compass: {bias: 5 deg}}, {at: 1 s, fix: {jump: 2 m}}]"
)
NEMESIS = (
    "nemesis={every: 500 ms, for: 250 ms, pick: [pause, kill, partition, freeze, stuck, off, {slow: {by: 7 ticks}}, "
    "{link *: delay 100ms loss 40%}, {gust: {velocity: 0 1 0 m/s, over: 200 ms}}, {dropout: {probability: 30 %}}]}"
)


def run(s: Scenario, folder: Path, start: Start | None = None) -> Result:
    result = execute(s, Options(folder, in_process=True, quiet=True), wiring=Wiring(start=start))
    assert result.status is Status.PASS, result.reason
    return result


@pytest.fixture
def recorded(alone: Alone) -> Alone:
    """Gives the run of a scenario with overrides, made once. Nobody may write to its directory."""
    return lambda name, *overrides: alone(name, "checks={ledger: balanced, tumbled: waived}", *overrides)


def since(directory: Path, ns: int) -> list[Record]:
    return [record for record in LogReader(directory / "run.mcap") if record.log_ns >= ns]


@pytest.mark.parametrize("part", [0.47, *slow(0.0, 1.0)])
@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("paper", ["duration=2.4 s", LINKS, EVERYTHING]),
        *slow(("paper", ["duration=2.4 s", CHANGING, "faults=[{at: 1 s, for: 500 ms, link: {1->2: loss 50%}}]"])),
        *slow(("ideal", ["duration=1.5 s"])),
        *slow(
            (
                "acoustic-s2c",
                [
                    *("duration=20 s", "faults=[{at: 8 s, for: 6 s, kill: 2}]"),
                    "network.acoustic.ranging=two-way",
                ],
            )
        ),
        *slow(("nemesis", ["duration=3 s", NEMESIS, "sea.current={sigma: 5 5 0 cm/s, time_constant: 2 s}"])),
        (
            "dead-reckoning",
            ["duration=2 s", "per_vehicle.1.navigation.usbl={at: 0 0 0 m, period: 400 ms, delay: 1 s}", INSTRUMENTS],
        ),
        (
            "paper",
            [
                "duration=2 s",
                "faults=[{at: 500 ms, for: 1 s, pause: 2}, {at: 600 ms, for: 1 s, slow: {vehicles: 3, by: 7 ticks}}]",
            ],
        ),
        ("locate-consistent", ["duration=9 s", *DYING]),
        *slow(
            ("crossing", ["duration=2 s", "keep_apart.distance=25 m"]),
            ("helix", ["duration=2 s", "sensors.position_noise=5 cm"]),
            ("rough-sea", ["duration=2 s", "per_vehicle={'2': {controller: bsmc}}", "network.payload=compact"]),
        ),
        *slow(
            (
                "average",
                ["duration=2.4 s", "faults=[{at: 800 ms, for: 1 s, kill: 3}]", "agent.parameters.forget_after_s=1"],
            )
        ),
        *slow(
            ("average-naive", ["duration=1 s", "expect=pass"]),
            ("election", ["duration=3 s", "faults=[{at: 1.5 s, for: 1 s, kill: 1}]", "agent.parameters.lease_s=1"]),
        ),
        (
            "election",
            [
                "duration=3 s",
                "agent.parameters.lease_s=1",
                "agent.clock={drift: {sigma: 900 ppm}, offset: 5 ms}",
                "faults=[{at: 700 ms, for: 900 ms, clock: {vehicles: 2, step: -200 ms, drift: 900 ppm}}]",
            ],
        ),
        *slow(
            (
                "event-triggered",
                ["duration=2 s", "agent.parameters.silence_s=0.5", "agent.parameters.threshold_m=0.02"],
            ),
            ("auction", ["duration=3 s", "faults=[{at: 1 s, kill: 3}]", "agent.parameters.silence_s=0.5"]),
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_rest_is_the_same_to_the_last_bit(
    recorded: Alone, name: str, overrides: list[str], part: float, tmp_path: Path
) -> None:
    """From a round after this part of them, also while an agent is suspended."""
    first = recorded(name, *overrides)
    whole = load_scenario(name, overrides)
    grid = moment_grid(whole.spec)
    rounds = range(grid, whole.ticks, grid)
    at, last = (whole.tick_ns * rounds[min(int(k * len(rounds)), len(rounds) - 1)] for k in (part, 1.0))
    scenario, start = continuation(first.directory, at)
    again = run(scenario, tmp_path, start)
    assert start.tick * scenario.tick_ns == at
    assert since(again.directory, 0) == since(first.directory, at)
    assert again.values["ledger"] == first.values["ledger"]
    # A log of the rest is a log like any other.
    assert script(again.directory) == scenario
    verified = verify(again.directory)
    assert verified.reproduced, verification_lines(verified)
    assert verified.messages == again.values["messages"]
    if at != last:
        later, further = continuation(again.directory, last)
        assert since(run(later, tmp_path, further).directory, last) == since(first.directory, last)


def test_a_change_acts_from_there_on(recorded: Alone, tmp_path: Path) -> None:
    first = recorded("paper", "duration=2 s")
    scenario, start = continuation(first.directory, 1_220_000_000, ["faults=[{at: 1.5 s, mute: 1}]", "duration=3 s"])
    assert start.notes[0].endswith("run.mcap, the last round with a frame before 1.22 s")
    again = run(scenario, tmp_path, start)
    at, mute = 1_200_000_000, 1_500_000_000
    before = [r for r in since(again.directory, at) if r.log_ns < mute]
    assert before == [r for r in since(first.directory, at) if r.log_ns < mute]
    assert again.values["ledger"]["1->2"]["lost"] == {"mute": 15}
    assert again.values["sim_s"] == 3.0


def test_pictures_of_it_begin_where_it_begins(recorded: Alone, tmp_path: Path) -> None:
    """Ages had grown from 0, where the log has nothing; a link that is silent at first has none until it delivers."""
    cut = "faults=[{at: 500 ms, for: 1 s, down: 1->2}]"
    first = recorded("paper", "duration=2 s", cut)
    scenario, start = continuation(first.directory, 1_000_000_000)
    again = run(scenario, tmp_path / "again", start)
    (drawn,) = load([again.directory])
    assert (open_log(first.directory).begin, drawn.log.begin) == (0.0, 1.0)
    assert time_axes(1, [drawn], View())[1][0].get_xlim()[0] == 1.0
    edges = np.array([0.0, 0.8, 1.4, 1.9])
    cut_off, open_link = (peak_ages(drawn, link, edges) for link in ((1, 2), (2, 1)))
    assert np.isnan(open_link).tolist() == [True, False, False] and open_link[1:].max() < 0.3
    assert np.isnan(cut_off).tolist() == [True, True, False]
    samples = LogFeed(again.directory / "run.mcap").whole()["samples"]
    assert all(row[2] == [None] * 4 for row in samples if row[0] < 1.0)
    assert max(age for row in samples if row[0] > 1.2 for age in row[2] if age is not None) < 0.5


def test_a_fault_and_links_in_words_act_from_there_on(recorded: Alone, tmp_path: Path) -> None:
    first = recorded("paper", "duration=1 s")
    mute, down = Override(FAULT, "at 700 ms for 100 ms mute 1"), Override(NET, "3->4 down")
    scenario, start = continuation(first.directory, 500_000_000, [mute, down])
    again = run(scenario, tmp_path, start)
    assert again.values["ledger"]["1->2"]["lost"] == {"mute": 1}
    assert again.values["ledger"]["3->4"]["lost"]["down"] == 5
    assert verify(again.directory).reproduced
    early = Override(FAULT, "at 100 ms for 900 ms mute 1")
    with pytest.raises(FleetError, match="--fault at 100 ms for 900 ms mute 1: it begins before t = 500 ms"):
        continuation(first.directory, 500_000_000, [early])


def test_what_an_agent_remembers_goes_on_as_long_as_it_is_set_up_as_before(recorded: Alone, tmp_path: Path) -> None:
    """Another seed changes what is drawn from there on, and the sea and other vehicles are nothing that it knows of."""
    first = recorded("paper", "duration=1 s")
    for changes, anew in (
        (["seed=7", "sea.current=0.3 0 0 m/s", "network.links.*=loss 20%"], None),
        (["neighbours.extrapolate=reference"], "1, 2, 3, 4"),
        (["per_vehicle={'2': {tracking: {k_u: 3 1/s}}}"], "2"),
    ):
        scenario, start = continuation(first.directory, 500_000_000, changes)
        assert start.notes[1:] == (() if anew is None else (f"set up otherwise: agents {anew} begin without memory",))
        again = open_log(run(scenario, tmp_path, start).directory)
        before = open_log(first.directory)
        for i in (1, 2, 3, 4):
            states = [log[f"uuv/{i}/state"] for log in (before, again)]
            assert states[1].t[0] == 0.5 and states[0].x[50] == states[1].x[0]
            assert states[0].x[-1] != states[1].x[-1]


def test_an_agent_with_another_law_begins_without_memory(recorded: Alone, tmp_path: Path) -> None:
    first = recorded("paper", "duration=1 s")
    scenario, start = continuation(first.directory, 500_000_000, ["per_vehicle={'3': {controller: bsmc}}"])
    assert "agents 3 begin without memory" in start.notes[1]
    again = run(scenario, tmp_path, start)
    before, after = (
        {r.topic: r.data for r in since(d, 500_000_000) if r.log_ns == 500_000_000}
        for d in (first.directory, again.directory)
    )
    changed = {topic for topic in before if before[topic] != after.get(topic)}
    assert changed == {"uuv/3/command", "uuv/3/guidance", "uuv/3/control"}


def test_what_cannot_go_on_says_why(tmp_path: Path) -> None:
    short = ("checks={ledger: balanced, tumbled: waived}", "duration=1 s")
    places = {"LOG": run(load_scenario("paper", short), tmp_path).directory, "HERE": tmp_path}
    check_commands("repeat/what cannot go on", places, "run", "--from")
    assert parse_from("a@b@20 s") == (Path("a@b"), 20_000_000_000)


def test_on_the_command_line(recorded: Alone, tmp_path: Path) -> None:
    first = recorded("paper", "duration=1 s")
    result = invoke("run", "--from", f"{first.directory}@0.5s", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "goes on from t = 500 ms of " in result.stderr
    assert "0.5 s simulated, t = 0.5 to 1 s, in " in result.stdout.splitlines()[-2]
    assert "\nvehicles; settling times count from the start at t = 0.5 s" in result.stdout


def test_times_and_speed_count_from_its_start(recorded: Alone, tmp_path: Path) -> None:
    first = recorded("paper", "duration=12 s", "log.every=5 ticks")
    scenario, start = continuation(first.directory, 2_000_000_000)
    again = run(scenario, tmp_path, start)
    assert (first.values["from_s"], again.values["from_s"], again.values["sim_s"]) == (0.0, 2.0, 12.0)
    assert _policy(scenario, Options(tmp_path, speed=2.0), start).begin == 200
    wall = again.values["wall"]
    assert wall["x_real_time"] == pytest.approx(10.0 / wall["run_s"])
    for i, row in again.values["vehicles"].items():
        e = open_log(again.directory)[f"uuv/{i}/error"]
        below = int((e["e_norm"] >= 0.1 * e["e_norm"][0]).nonzero()[0][-1]) + 1
        assert row["settle_10pct_s"] == pytest.approx(e.t[below] - 2.0)


@pytest.mark.parametrize("at_ms", [400, 600])
def test_an_agent_that_was_gone_is_there_if_nothing_ends_it(at_ms: int, tmp_path: Path) -> None:
    """It begins without memory at that moment. Before, the run waited for it for ever."""
    log = ["checks={tumbled: waived}"]
    gone = run(small(*log, "faults=[{at: 400 ms, kill: 1}]"), tmp_path)
    scenario, start = continuation(gone.directory, at_ms * 1_000_000, ["faults=[]"])
    found = run(scenario, tmp_path, start)
    commands = open_log(found.directory)["uuv/1/command"]
    assert (commands.t[0], len(commands)) == (at_ms / 1e3, (1000 - at_ms) / 10)


def test_triggers_look_at_the_run_that_goes_on(recorded: Alone, tmp_path: Path) -> None:
    """They looked at a run from t = 0. So a moment before the start began a fault, and this one came too early."""
    log = recorded("paper", "duration=2.4 s").directory / "run.mcap"
    x = open_log(log)["uuv/1/state"]
    early, late = (float(x["x"][np.searchsorted(x.t, at_s)]) for at_s in (0.7, 1.7))
    triggers = ", ".join(
        f"{{id: {name}, when: {{topic: state.x, above: {value} m, vehicles: 1}}, for: 100 ms, fault: {{mute: 2}}}}"
        for name, value in (("early", early), ("late", late))
    )
    scenario, start = continuation(log, 10**9, [f"triggers=[{triggers}]"])
    begun = [(fault.id, fault.at) for fault in resolve_triggers(scenario, start).spec.faults]
    assert [name for name, _ in begun] == ["late"]
    assert 1.6e9 < begun[0][1] < 2.0e9
    goes_on = execute(scenario, Options(tmp_path, quiet=True), wiring=Wiring(start=start))
    assert goes_on.status is Status.PASS, goes_on.reason


def test_a_run_goes_on_with_laws_that_cannot_say_what_they_remember(
    module: Callable[[str], str], tmp_path: Path
) -> None:
    """Here how often they were asked, which no log holds."""
    name = module(failing(10**6, "pass").replace("self.config = config", "self.config, self.asked = config, 0")
                  .replace("return (1.0,", "self.asked += 1\n        return (0.1 * self.asked,"))  # fmt: skip
    whole = run(small(f"controller={name}:Law"), tmp_path)
    scenario, start = continuation(whole.directory, 500_000_000)
    assert since(run(scenario, tmp_path, start).directory, 500_000_000) == since(whole.directory, 500_000_000)


CHANGED = "return (1.0, 0.0, 0.0)"


def test_what_does_not_come_out_the_same_does_not_go_on(module: Callable[[str], str], tmp_path: Path) -> None:
    """The code of a law is another by now: where, which message, why, and what to do are said; so says verify.

    Also where it differs in the last round alone, whose packets are not all through.
    """
    name = module(failing(10**6, "pass"))
    law = tmp_path / f"{name}.py"
    whole = run(small(f"controller={name}:Law"), tmp_path)
    scenario, start = continuation(whole.directory, 500_000_000, ["controller=bc"])
    rest = run(scenario, tmp_path, start)
    law.write_text(law.read_text("utf-8").replace(CHANGED, "return (1.0 + (sample.tick > 32), 0.0, 0.0)"), "utf-8")
    del sys.modules[name]
    for options in ((), ("--set", "controller=bc")):
        done = invoke("run", "--from", f"{whole.directory}@0.35s", *options, "--out", tmp_path / "other", "--trust")
        said = " ".join(done.stderr.split())
        assert done.exit_code == 2 and not (tmp_path / "other").exists(), said
        assert f"nothing can go on from {whole.directory}/run.mcap: its run does not come out the same again" in said
        assert "uuv/1/command, tick 33, t = 0.33 s" in said, said
        assert f"likely why: law {name}:Law: recorded with sha256" in said
        assert f"a run with what is here now: fleet run {whole.directory}/scenario.yaml" in said
        early = invoke("run", "--from", f"{whole.directory}@0.3s", *options, "--out", tmp_path / "early", "--trust")
        assert early.exit_code in (0, 1), early.output  # whether it tumbles
    checked = invoke("verify", rest.directory, "--trust")
    assert checked.exit_code == 1 and f"likely why: law {name}:Law: recorded with sha256" in checked.stdout


def test_a_log_that_goes_on_from_a_snapshot_of_an_older_version_says_so(
    recorded: Alone, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = recorded("paper", "duration=1 s")
    monkeypatch.setattr("fleet.recorder.writer.START", OLD_START)
    scenario, start = continuation(first.directory, 500_000_000)
    old = run(scenario, tmp_path, start).directory
    assert len(open_log(old)["uuv/1/state"]) == 51
    for arguments in (["verify", old], ["whatif", old, "--agent", "1"], ["run", "--from", f"{old}@0.8s"]):
        refused = invoke(*arguments)
        said = " ".join(refused.stderr.split())
        assert refused.exit_code == 2, said
        assert f"{old}/run.mcap goes on from a snapshot, which this version does not read; run it anew from " in said
        assert f"anew from {first.directory}/run.mcap, digest " in said


def with_snapshots(source: Path, target: Path) -> None:
    """Copy a log, with a snapshot before the first message of each tick from 200 ms on, as versions up to 1.0 wrote."""
    with source.open("rb") as given, target.open("wb") as file:
        reader, writer = make_reader(given), Writer(file)
        writer.start()
        for attachment in reader.iter_attachments():
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        numbers: dict[str, int] = {}
        before = 0
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.topic not in numbers:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                encoding = channel.message_encoding
                numbers[channel.topic] = writer.register_channel(channel.topic, encoding, known, channel.metadata)
                numbers.setdefault("snapshot", writer.register_channel("snapshot", encoding, known))
            if message.log_time > max(before, 200_000_000):
                before = message.log_time
                writer.add_message(numbers["snapshot"], before, b"old", before)
            times = message.log_time, message.data, message.publish_time, message.sequence
            writer.add_message(numbers[channel.topic], *times)
        writer.finish()


def test_snapshots_in_a_log_of_an_older_version_are_passed_over(recorded: Alone, tmp_path: Path) -> None:
    """They come between other messages, and nobody reads them."""
    first = recorded("paper", "duration=1 s")
    copied = tmp_path / "old.mcap"
    with_snapshots(first.directory / "run.mcap", copied)
    verified = verify(copied)
    assert verified.reproduced and verified.messages == first.values["messages"], verification_lines(verified)
    scenario, start = continuation(copied, 800_000_000)
    assert since(run(scenario, tmp_path, start).directory, 800_000_000) == since(first.directory, 800_000_000)
    assert invoke("info", copied).exit_code == 0
