"""A log that is played on the page: time, jumps and signals."""

from __future__ import annotations

from pathlib import Path

import pytest
from in_process_runs import Alone, log_of
from marks import slow
from mcap.reader import make_reader
from mcap.writer import Writer

from fleet.addons.page.feed import fault_message
from fleet.addons.page.log_feed import LogFeed
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.wiring import Wiring
from fleet.logs.open_log import open_log
from fleet.mcap.reader import LogReadError
from fleet.repeat.resume import continuation

SHORT = (
    "duration=5 s",
    "faults=[{at: 1 s, for: 1 s, id: cut, partition: halves}, {at: 3 s, kill: 4}]",
    "checks={tumbled: waived}",
)


@pytest.fixture
def log(alone: Alone) -> Path:
    return log_of(alone("paper", *SHORT))


@pytest.fixture
def feed(log: Path) -> LogFeed:
    return LogFeed(log)


def test_it_shows_what_the_log_says_at_a_time(feed: LogFeed, log: Path) -> None:
    feed.seek(1.5)
    assert feed.advance()
    frame = feed.picture.frame()
    error = open_log(log)["uuv/3/error"]
    assert frame["t"] == 1.5
    assert frame["errors"][2] == pytest.approx(error.formation_norm[150], abs=1e-3)
    assert [row["id"] for row in frame["faults"] if row["active"]] == ["cut"]
    states = dict(zip(map(tuple, feed.picture.setup()["links"]), frame["links"], strict=True))
    assert states[2, 3] == "cut" and states[1, 2] == "delivering"
    assert frame["packets"] == []  # those of the second before are not on their way


def test_what_was_heard_before_a_run_went_on_is_not_known(tmp_path: Path, alone: Alone) -> None:
    """Its age was counted from 0, although something had been heard in the run before."""
    first = log_of(alone("paper", *SHORT))
    scenario, start = continuation(first, 2_000_000_000, ["faults=[{at: 2 s, mute: 2}]", "duration=3 s"])
    made = execute(scenario, Options(tmp_path, in_process=True, quiet=True), wiring=Wiring(start=start))
    assert made.directory is not None
    feed = LogFeed(made.directory / "run.mcap")
    feed.seek(2.5)
    frame = feed.picture.frame()
    ages = dict(zip(map(tuple, feed.picture.setup()["links"]), frame["ages"], strict=True))
    assert frame["since"] == 2.0 and ages[2, 3] is None and ages[1, 2] < 0.3


def test_time_goes_back_as_well(feed: LogFeed) -> None:
    feed.seek(3.5)
    assert feed.picture.frame()["states"] == {4: "no agent"}
    feed.seek(0.5)
    frame = feed.picture.frame()
    assert frame["states"] == {} and frame["t"] == 0.5
    assert feed.picture.history()["samples"][-1][0] <= 0.5


def test_it_plays_at_its_rate_and_stops_at_the_end(feed: LogFeed) -> None:
    assert feed.clock()["paused"]
    feed.seek(4.5)
    feed.toggle()
    feed.set_rate(1e6)
    while not feed.clock()["over"]:
        feed.advance()
    assert feed.picture.frame()["t"] == 5.0
    assert feed.clock()["text"] == "at the end"
    feed.toggle()  # again, from the beginning
    assert not feed.clock()["paused"] and feed.picture.at_s == 0.0


def test_it_goes_forward_step_by_step_with_every_packet(feed: LogFeed) -> None:
    feed.seek(0.3)
    packets = []
    for at_s in (0.4, 0.6, 0.9):
        feed.forward(at_s)
        frame = feed.picture.frame()
        assert frame["t"] == at_s
        packets += frame["packets"]
    feed.seek(0.3)
    feed.forward(0.9)
    assert feed.picture.frame()["packets"] == packets and len(packets) > 20


def test_it_jumps_to_the_next_fault_and_the_next_loss(feed: LogFeed) -> None:
    times = []
    while (at_s := feed.next_fault()) is not None:
        feed.seek(at_s)
        times.append(at_s)
    assert times == pytest.approx([1.0, 2.0, 3.0])  # a tumble is no fault
    assert feed.next_loss() == pytest.approx(3.0, abs=0.11)  # to the agent that is dead
    feed.seek(0.0)
    assert feed.next_loss() == pytest.approx(1.0, abs=0.11)
    feed.seek(5.0)
    assert feed.next_loss() is None


def test_a_signal_of_the_log_can_be_chosen(feed: LogFeed, log: Path) -> None:
    feed.seek(3.5)
    feed.follow({"uuv/2/command.tau_0"})
    values = feed.picture.history()["signals"]["uuv/2/command.tau_0"]
    tau = open_log(log)["uuv/2/command"]
    for at_s, value in values[:: len(values) // 5]:
        assert value == pytest.approx(tau.tau[round(at_s / 0.01), 0])
    assert feed.signals.by_name["uuv/2/state.z"].unit == "m"
    with pytest.raises(KeyError, match="uuv/2/command"):
        feed.follow({"uuv/2/comand.tau_0"})
    feed.follow(set())
    assert feed.picture.at_s == 3.5 and not feed.picture.history()["signals"]


def test_a_log_that_is_cut_says_so(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    feed = LogFeed(cut)
    assert "not whole" in feed.clock()["note"] and 1.0 < feed.end_s < 5.0
    feed.seek(feed.end_s)
    assert feed.picture.frame()["uuv"]


def test_a_log_without_transforms_plays_and_says_what_it_lacks(alone: Alone) -> None:
    feed = LogFeed(log_of(alone("paper", "duration=2 s", "log={transforms: 0 ticks}", "checks={}")))
    feed.set_rate(1e6)
    feed.toggle()
    while not feed.clock()["over"]:
        feed.advance()
    assert feed.picture.frame()["t"] == 2.0
    assert "transforms" in feed.clock()["note"]


def test_a_damaged_message_of_faults_is_left_out() -> None:
    assert fault_message(b"\x0f\xff") is None


def copied(log: Path, out: Path, schema: str = "", *, late: bool = False) -> Path:
    """The log with a schema of one name damaged, or with one message whose time is the last that there can be."""
    with open(log, "rb") as source, open(out, "wb") as target:
        reader, writer = make_reader(source), Writer(target)
        writer.start("", "")
        summary = reader.get_summary()
        schemas = {
            n: writer.register_schema(s.name, s.encoding, b"\x0a\xff damaged" if s.name == schema else s.data)
            for n, s in summary.schemas.items()
        }
        channels = {
            n: writer.register_channel(c.topic, c.message_encoding, schemas[c.schema_id], c.metadata)
            for n, c in summary.channels.items()
        }
        for one in reader.iter_attachments():
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        for _, channel, message in reader.iter_messages():
            at_ns = (1 << 64) - 1 if late and message.log_time > 2 * 10**9 else message.log_time
            writer.add_message(channels[channel.id], at_ns, message.data, at_ns, message.sequence)
        writer.finish()
    return out


@pytest.mark.parametrize("schema", ["uuv_fleet.State", *slow("uuv_fleet.Error", "uuv_fleet.Packet")])
def test_a_damaged_schema_leaves_out_its_signals_and_no_more(log: Path, tmp_path: Path, schema: str) -> None:
    feed = LogFeed(copied(log, tmp_path / "run.mcap", schema))
    assert ("uuv/1/state.z" in feed.signals.by_name) == (schema != "uuv_fleet.State")
    feed.seek(1.5)
    assert feed.picture.frame()["t"] == 1.5
    errors = {error for _, errors, *_ in feed.whole()["samples"] for error in errors}
    assert (errors == {None}) == (schema == "uuv_fleet.Error")


def test_faults_that_cannot_be_read_are_not_left_out(log: Path, tmp_path: Path) -> None:
    """A picture of the run without its faults would be a wrong one."""
    with pytest.raises(LogReadError, match="the schema of faults cannot be used"):
        LogFeed(copied(log, tmp_path / "run.mcap", "uuv_fleet.Fault"))


def test_an_absurd_time_ends_what_is_shown(log: Path, tmp_path: Path) -> None:
    """As for all readers it is damage: what comes before is shown, and a note says why there is no more."""
    feed = LogFeed(copied(log, tmp_path / "run.mcap", late=True))
    assert 1.0 < feed.end_s < 5.0
    assert "a message whose time is" in feed.clock()["note"]
    whole = LogFeed(log)
    for one in (feed, whole):
        one.seek(1.0)
    assert feed.picture.frame()["uuv"] == whole.picture.frame()["uuv"]


def test_the_curves_of_the_whole_log_are_those_of_its_moments(feed: LogFeed) -> None:
    samples = feed.whole()["samples"]
    assert samples[0][0] == 0.0 and samples[-1][0] == 5.0
    for t, errors, ages, _, _ in samples[5::5]:
        feed.seek(t)
        frame = feed.picture.frame()
        assert errors == pytest.approx(frame["errors"], abs=0.05)
        shown = dict(zip(map(tuple, feed.picture.setup()["links"]), frame["ages"], strict=True))
        assert ages == pytest.approx(
            [max(shown[src, i] for src in sources) for i, sources in feed.picture.neighbours.items()], abs=0.21
        )
    lost = [(t, share) for t, _, _, share, _ in samples]
    assert {share for t, share in lost if t < 0.9} == {0.0}
    assert all(share > 0.0 for t, share in lost if 1.3 < t < 1.7)


def test_a_signal_of_all_vehicles_is_drawn_whole(feed: LogFeed, log: Path) -> None:
    names = feed.signals.names_of("|error.e|")
    assert names == [f"|uuv/{i}/error.e|" for i in range(1, 5)]
    curves = feed.whole(names)["signals"]
    error = open_log(log)["uuv/2/error"]
    for t, value in curves["|uuv/2/error.e|"][1:-1:10]:
        assert value == pytest.approx(error.e_norm[round(t / 0.01)], abs=1e-3)
    with pytest.raises(KeyError, match="control"):
        feed.signals.names_of("contrl.e")


def test_a_log_opens_at_its_first_failed_moment(alone: Alone, made: Alone, feed: LogFeed) -> None:
    assert feed.first_failure_s() == 0.0  # nothing failed
    checks = "checks={formation_error: {below: 5 cm, after: 3 s}, signal: {topic: state.z, below: 2 m, after: 4 s}}"
    failed = LogFeed(log_of(alone("paper", "duration=6 s", checks, "expect=fail")))
    assert failed.charted == ["state.z"]
    assert failed.first_failure_s() == pytest.approx(3.0, abs=0.01)
    assert {row["check"]: row["at_s"] for row in failed.checks["rows"] if row["passed"] is False} == {
        "formation_error": pytest.approx(3.0, abs=0.01), "state.z": pytest.approx(4.0, abs=0.01),
    }  # fmt: skip
    assert failed.checks["verdict"] == {"passed": True, "text": "failed as expected"}
    short = LogFeed(log_of(made("paper", "duration=2 s")))  # ends before the formation is judged
    assert short.checks["verdict"] == {"passed": None, "text": "0 of 6 checks failed, 1 not judged"}


@pytest.mark.parametrize("vehicles", [", vehicles: 4", *slow("")])
def test_a_formation_error_failed_when_a_judged_vehicle_was_too_far_away(alone: Alone, vehicles: str) -> None:
    checks = f"checks={{tumbled: waived, formation_error: {{below: 1.2 m, after: 1 s{vehicles}}}}}"
    placed = "initial={scatter: 10 cm, around: reference, surge: 0.7 m/s}"
    path = log_of(alone("paper", "duration=7 s", placed, "faults=[{at: 1 s, kill: 4}]", checks, "expect=fail"))
    feed, error = LogFeed(path), open_log(path)["uuv/4/error"]
    far = error.t[(error.t >= 1.0) & (error.formation_norm >= 1.2)]  # its agent is dead
    assert far[0] > 2.0 and feed.first_failure_s() == pytest.approx(far[0])
