"""A live run in Foxglove's viewers: what is fetched, what a viewer can do to it, and what it is told at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgpack
import pytest
from foxglove_client import Viewer, viewer
from hand import began
from live import LiveRun
from showing import Fingers, going_on, quiet_line
from tool import tool
from traffic import LIMIT_S, endpoint, session
from traffic import log as log
from waiting import wait_for

from fleet.addons.page.foxglove_live import OVER, LiveBridge
from fleet.addons.page.source import LiveSource, find_source
from fleet.errors import FleetError
from fleet.logs.open_log import open_log
from fleet.mcap.reader import LogReader
from fleet.mcap.seekable_log import SeekableLog
from fleet.replay.live_journal import LiveJournal, pack_counts
from fleet.replay.observed import Observed, host_observed, new_observed
from fleet.replay.playback import Replay
from fleet.replay.player import PlaybackOptions
from fleet.replay.topics import Stamp, pack
from fleet.terminal.status_line import StatusLine
from netem.wire.credentials import Credentials
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus

KEYS = Keys("0123abcd")
WAITING = 2000  # messages of 10 kB


class Source(NamedTuple):
    """Zenoh's source information, as far as it is read."""

    source_sn: int


class ZBytes(bytes):
    """Zenoh's."""

    def to_bytes(self) -> bytes:
        return self


@contextmanager
def joined(observed: Observed) -> Iterator[OpenBus]:
    with session(OpenBus.connect(observed.endpoint, Credentials(observed.user, observed.password))) as bus:
        yield bus


@contextmanager
def watched(bridge: LiveBridge) -> Iterator[Viewer]:
    with closing(bridge.server), going_on(lambda _, line: bridge.run(line)), viewer(bridge.server.endpoint) as watcher:
        yield watcher


def test_only_what_viewers_want_is_fetched(log: Path, tmp_path: Path) -> None:
    """And what tells the time. The publisher sees who subscribes; a replay stands in for a run here."""
    observed = new_observed(endpoint(), "replay")
    replay = Replay(SeekableLog(log), PlaybackOptions(speed=0.0))
    publisher = host_observed(observed)
    replay.open(publisher)

    def fetched() -> set[str]:
        prefix = f"fleet/{observed.run}/log/"
        return {key.removeprefix(prefix) for key in set(replay.key_of.values()) - set(replay.unmatched_keys())}

    with joined(observed) as bus:
        bridge = LiveBridge(
            LiveSource(tmp_path, observed, None), LiveJournal(bus, Keys(observed.run)), "127.0.0.1", 0, control=False
        )
        with watched(bridge) as watcher:
            assert set(watcher.channels) == {c.topic for c in SeekableLog(log).channels.values()}
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


def test_who_only_watches_cannot_control(log: Path, tmp_path: Path) -> None:
    """With the observer's credentials and nothing else there are no services, whatever is asked for."""
    observed = new_observed(endpoint(), "replay")
    with session(host_observed(observed)) as publisher, joined(observed) as bus:
        Replay(SeekableLog(log), PlaybackOptions()).open(publisher)
        with pytest.raises(FleetError, match="only what an observer needs is at hand"):
            LiveBridge(
                LiveSource(tmp_path, observed, None), LiveJournal(bus, Keys(observed.run)), "127.0.0.1", 0, control=True
            )


class MadeUpBus:
    """A session with a publisher that has one topic, and ends when it is told to."""

    def __init__(self) -> None:
        self.connected = True
        self.subscribed: dict[str, Callable[[Any], None]] = {}

    def ask(self, key: str) -> dict[str, bytes]:
        return {KEYS.topics: msgpack.packb({"a": "S"})} if key == KEYS.topics else {KEYS.schema("S"): b""}

    def subscribe(self, key: str, handler: Callable[[Any], None]) -> Callable[[], None]:
        self.subscribed[key] = handler
        return lambda: None


def test_what_waits_for_a_viewer_when_the_run_ends_still_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is told of the end before them, since words overtake messages; and of what did not come from the publisher."""
    bus: Any = MadeUpBus()
    source = LiveSource(tmp_path, Observed("tcp/127.0.0.1:1", "observer", "secret", KEYS.run), None)
    bridge = LiveBridge(source, LiveJournal(bus, KEYS), "127.0.0.1", 0, control=False)

    said: list[str] = []
    say = bridge.server.say
    monkeypatch.setattr(bridge.server, "say", lambda text, **more: (said.append(text), say(text, **more)))
    monkeypatch.setattr("fleet.addons.page.foxglove_live.REST_S", LIMIT_S)  # until the viewer leaves
    monkeypatch.setattr("fleet.addons.page.foxglove_live.COME_S", 0.0)  # all that comes from the publisher is here

    def run(_: Fingers, line: StatusLine) -> None:
        try:
            bridge.run(line)
        finally:
            bridge.server.close()  # as the command does

    # More than sockets hold: the rest is in the server when the run is over.
    with going_on(run), viewer(bridge.server.endpoint, most=10) as slow:
        slow.subscribe("a")
        give = wait_for(lambda: bus.subscribed.get(KEYS.log("a")), LIMIT_S, "the subscription")
        for n in range(WAITING):
            stamp = ZBytes(pack(Stamp(n, n, n, n)))
            info = Source(n + 3 * (n > 5))
            payload = ZBytes(bytes(10_000))
            give(SimpleNamespace(key_expr=KEYS.log("a"), attachment=stamp, payload=payload, source_info=info))
        bus.subscribed[KEYS.log_end](SimpleNamespace(payload=ZBytes(pack_counts({"a": WAITING + 5, "b": 9}))))
        bus.connected = False
        wait_for(lambda: OVER in said, LIMIT_S, "the end")
        slow.until(lambda: len(slow.messages) == WAITING)
        slow.until(lambda: OVER in slow.told)
    assert bridge.missing.of("a") == 3 + 2
    assert [text.partition(" were ")[0] for text in slow.told if "left out" in text][-1] == "5 messages"


def test_a_service_call_cuts_a_link_of_a_live_run(tmp_path: Path) -> None:
    """Every message that a viewer gets is the log's, and it is told how many it did not get; what it injects is in the
    log, and it is told of the end."""
    arguments = ["paper", "--duration", "600 s", "--set", "checks={}", "--speed", "4", "--publish"]
    topics = ("uuv/1/state", "link/1-2", "scene", "faults")
    with LiveRun(tmp_path / "runs", *arguments) as run:
        began(run)
        source = find_source(str(run.directory), tmp_path)
        with joined(source.observed) as bus:
            bridge = LiveBridge(source, LiveJournal(bus, Keys(source.observed.run)), "127.0.0.1", 0, control=True)
            with watched(bridge) as watcher:
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
                assert tool(run.out, "stop").exit_code == 0
                watcher.until(lambda: "the run is over" in watcher.told)  # it may come before the last messages
                watcher.until(lambda: len(watcher.messages) == bridge.server.sent)
                assert watcher.times == sorted(watcher.times)
        assert run.status() == 130, run.printed
        link = open_log(run.log)["link/1-2"]
        while_cut = (link.sent > cut["from_s"]) & (link.sent < cut["from_s"] + 0.5)
        assert while_cut.any() and set(link.fate[while_cut]) == {"down"}
        records = {topic: [(r.log_ns, r.data) for r in LogReader(run.log) if r.topic == topic] for topic in topics}
    for topic in topics:
        got = [(message.log_ns, message.data) for message in watcher.of(topic)]
        if got:
            expected = records[topic][records[topic].index(got[0]) :]
            left = iter(expected)
            assert all(message in left for message in got)  # in order, and nothing is twice
            assert len(expected) - len(got) == bridge.missing.of(topic)  # none, where a machine is not too busy
    assert bool(bridge.missing.count) == any("left out" in text for text in watcher.told)
