"""A log that is played on the page: time, jumps and signals."""

from __future__ import annotations

from pathlib import Path

import pytest
from in_process_runs import Alone, log_of

from fleet.logs.open_log import open_log
from fleet.view.feed import fault_message
from fleet.view.log_feed import LogFeed

SHORT = (
    "duration=20 s",
    "faults=[{at: 5 s, for: 3 s, id: cut, partition: halves}, {at: 10 s, kill: 4}]",
    "checks={tumbled: waived}",
)


@pytest.fixture
def log(alone: Alone) -> Path:
    return log_of(alone("paper", *SHORT))


@pytest.fixture
def feed(log: Path) -> LogFeed:
    return LogFeed(log)


def test_it_shows_what_the_log_says_at_a_time(feed: LogFeed, log: Path) -> None:
    feed.seek(7.0)
    assert feed.advance()
    frame = feed.picture.frame()
    error = open_log(log)["uuv/3/error"]
    assert frame["t"] == 7.0
    assert frame["errors"][2] == pytest.approx(error.formation_norm[700], abs=1e-3)
    assert [row["id"] for row in frame["faults"] if row["active"]] == ["cut"]
    states = dict(zip(map(tuple, feed.picture.setup()["links"]), frame["links"], strict=True))
    assert states[2, 3] == "down" and states[1, 2] == "delivered"
    assert frame["packets"] == []  # those of the minute before are not on their way


def test_time_goes_back_as_well(feed: LogFeed) -> None:
    feed.seek(12.0)
    assert feed.picture.frame()["states"] == {4: "no agent"}
    feed.seek(1.0)
    frame = feed.picture.frame()
    assert frame["states"] == {} and frame["t"] == 1.0
    assert feed.picture.history()["samples"][-1][0] <= 1.0


def test_it_plays_at_its_rate_and_stops_at_the_end(feed: LogFeed) -> None:
    assert feed.clock()["paused"]
    feed.seek(19.0)
    feed.toggle()
    feed.set_rate(1e6)
    while not feed.clock()["over"]:
        feed.advance()
    assert feed.picture.frame()["t"] == 20.0
    assert feed.clock()["text"] == "at the end"
    feed.toggle()  # again, from the beginning
    assert not feed.clock()["paused"] and feed.picture.at_s == 0.0


def test_it_goes_forward_step_by_step_with_every_packet(feed: LogFeed) -> None:
    feed.seek(3.0)
    packets = []
    for at_s in (3.5, 4.0, 4.5):
        feed.forward(at_s)
        frame = feed.picture.frame()
        assert frame["t"] == at_s
        packets += frame["packets"]
    feed.seek(3.0)
    feed.forward(4.5)
    assert feed.picture.frame()["packets"] == packets and len(packets) > 20


def test_it_jumps_to_the_next_fault_and_the_next_loss(feed: LogFeed) -> None:
    times = []
    while (at_s := feed.next_fault()) is not None:
        feed.seek(at_s)
        times.append(at_s)
    assert times == pytest.approx([5.0, 8.0, 10.0])  # a tumble is no fault
    assert feed.next_loss() == pytest.approx(10.0, abs=0.11)  # to the agent that is dead
    feed.seek(0.0)
    assert feed.next_loss() == pytest.approx(5.0, abs=0.11)
    feed.seek(20.0)
    assert feed.next_loss() is None


def test_a_signal_of_the_log_can_be_chosen(feed: LogFeed, log: Path) -> None:
    feed.seek(12.0)
    feed.follow({"uuv/2/command.tau[0]"})
    values = feed.picture.history()["signals"]["uuv/2/command.tau[0]"]
    tau = open_log(log)["uuv/2/command"]
    for at_s, value in values[:: len(values) // 5]:
        assert value == pytest.approx(tau.tau[round(at_s / 0.01), 0])
    assert feed.signals.by_name["uuv/2/state.z"].unit == "m"
    with pytest.raises(KeyError, match="uuv/2/command"):
        feed.follow({"uuv/2/comand.tau[0]"})
    feed.follow(set())
    assert feed.picture.at_s == 12.0 and not feed.picture.history()["signals"]


def test_a_log_that_is_cut_says_so(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    feed = LogFeed(cut)
    assert "not whole" in feed.clock()["note"] and 1.0 < feed.end_s < 20.0
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
