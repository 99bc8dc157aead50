"""A live run in Foxglove's viewers: what is fetched, what a viewer can do to it, and what it is told at the end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import pytest
from foxglove_client import viewer
from live import LiveRun
from showing import Fingers, going_on, quiet_line
from traffic import LIMIT_S, endpoint, session
from traffic import log as log
from waiting import wait_for

from fleet.logs.open_log import open_log
from fleet.logs.reader import LogReader
from fleet.logs.tape import Tape
from fleet.replay.observed import Observed, host_observed, new_observed
from fleet.replay.playback import PlaybackOptions, Replay
from fleet.view.foxglove_live import Gaps, LiveBridge
from fleet.view.source import LiveSource, ViewerError, find_source
from netem.wire.access import Credentials
from netem.wire.open_bus import OpenBus


@contextmanager
def joined(observed: Observed) -> Iterator[OpenBus]:
    with session(OpenBus.connect(observed.endpoint, Credentials(observed.user, observed.password))) as bus:
        yield bus


def test_only_what_viewers_want_is_fetched(log: Path, tmp_path: Path) -> None:
    """And what tells the time. The publisher sees who subscribes; a replay stands in for a run here."""
    observed = new_observed(endpoint(), "0123abcd")
    replay = Replay(Tape(log), PlaybackOptions(run=observed.run, rate=0.0))
    publisher = host_observed(observed)
    replay.open(publisher)

    def fetched() -> set[str]:
        prefix = f"fleet/{observed.run}/log/"
        return {key.removeprefix(prefix) for key in set(replay.key_of.values()) - set(replay.unmatched())}

    with joined(observed) as bus:
        bridge = LiveBridge(LiveSource(tmp_path, observed, None), bus, "127.0.0.1", 0, control=False)
        try:
            with going_on(lambda _, line: bridge.run(line)), viewer(bridge.server.endpoint) as watcher:
                assert set(watcher.channels) == {c.topic for c in Tape(log).channels.values()}
                assert not watcher.services and watcher.infos[0]["capabilities"] == ["time"]
                watcher.subscribe("uuv/2/state", "link/1-2")
                wait_for(lambda: fetched() == {"transforms", "uuv/2/state", "link/1-2"}, LIMIT_S, "subscriptions")
                watcher.unsubscribe("link/1-2")
                wait_for(lambda: fetched() == {"transforms", "uuv/2/state"}, LIMIT_S, "the end of one")
                count = len(open_log(log)["uuv/2/state"])
                player = Thread(target=lambda: replay.play(Fingers(), quiet_line()))
                player.start()
                watcher.until(lambda: len(watcher.messages) == count)
                player.join()
                publisher.close()
                watcher.until(lambda: "the run is over" in watcher.told)
        finally:
            bridge.server.close()


def test_who_only_watches_cannot_control(log: Path, tmp_path: Path) -> None:
    """With the observer's credentials and nothing else there are no services, whatever is asked for."""
    observed = new_observed(endpoint(), "0123abcd")
    with session(host_observed(observed)) as publisher, joined(observed) as bus:
        Replay(Tape(log), PlaybackOptions(run=observed.run)).open(publisher)
        with pytest.raises(ViewerError, match="only what an observer needs is at hand"):
            LiveBridge(LiveSource(tmp_path, observed, None), bus, "127.0.0.1", 0, control=True)


def test_a_service_call_cuts_a_link_of_a_live_run(tmp_path: Path) -> None:
    """Every message that a viewer gets is the log's; what it injects is in the log, and it is told of the end."""
    arguments = ["paper", "--duration", "20 s", "--set", "checks={}", "--speed", "2", "--publish"]
    topics = ("uuv/1/state", "link/1-2", "scene", "faults")
    with LiveRun(tmp_path / "runs", *arguments) as run:
        run.until_running(0.5)
        source = find_source(str(run.directory), tmp_path)
        assert isinstance(source, LiveSource)
        with joined(source.observed) as bus:
            bridge = LiveBridge(source, bus, "127.0.0.1", 0, control=True)
            try:
                with going_on(lambda _, line: bridge.run(line)), viewer(bridge.server.endpoint) as watcher:
                    watcher.subscribe(*topics)
                    watcher.until(lambda: watcher.of("link/1-2"))
                    cut = watcher.call("/fleet/inject", what="down '1->2'", id="cut")
                    assert cut["id"] == "cut" and cut["until_healed"]
                    after_ns = int((cut["from_s"] + 0.5) * 1e9)
                    watcher.until(lambda: watcher.of("link/1-2")[-1].log_ns > after_ns)
                    assert [fault["state"] for fault in watcher.call("/fleet/faults")["faults"]] == ["active"]
                    assert "there is a fault cut already" in watcher.call("/fleet/inject", what="down 2->1", id="cut")
                    assert "has no link 1->9" in watcher.call("/fleet/inject", what="down 1->9")
                    assert 'did you mean "down"' in watcher.call("/fleet/inject", what="dawn 1->2")
                    assert "inject takes what, for, id" in watcher.call("/fleet/inject", fault="down 1->2")
                    assert "what? The words of fleet inject" in watcher.call("/fleet/inject")
                    assert watcher.call("/fleet/heal", id="cut")["healed"] == ["cut"]
                    assert watcher.call("/fleet/clock", do="pause")["clock"] == "paused"
                    assert watcher.call("/fleet/clock", do="step")["clock"] == "paused"
                    assert "the clock knows" in watcher.call("/fleet/clock", do="speed", value=-1)
                    watcher.call("/fleet/clock", do="speed", value=10)
                    assert watcher.call("/fleet/clock", do="resume")["clock"] == "10 x real time"
                    watcher.until(lambda: "the run is over" in watcher.told)
                    assert watcher.times == sorted(watcher.times)
            finally:
                bridge.server.close()
        assert run.status() == 0, run.printed
        link = open_log(run.log)["link/1-2"]
        while_cut = (link.sent > cut["from_s"]) & (link.sent < cut["from_s"] + 0.5)
        assert while_cut.any() and set(link.fate[while_cut]) == {"down"}
        records = {topic: [(r.log_ns, r.data) for r in LogReader(run.log) if r.topic == topic] for topic in topics}
    for topic in topics:
        got = [(message.log_ns, message.data) for message in watcher.of(topic)]
        first = records[topic].index(got[0])
        assert got == records[topic][first:]  # nothing is missing, nothing is twice


def test_gaps_are_counted() -> None:
    """Against the least step; a single number has none."""
    gaps = Gaps()
    assert (gaps.came, gaps.lost) == (0, 0)
    for number in (10, 30, 40, 70):
        gaps.add(number)
    assert (gaps.came, gaps.lost) == (4, 3)
    assert Gaps().lost == 0
    gaps = Gaps()
    gaps.add(5)
    assert (gaps.came, gaps.lost) == (1, 0)
