"""A log for Foxglove's viewers: played, held, sought and repeated, by a viewer's own controls or by the keyboard.

Only what a viewer subscribes to is decoded. After a jump, and when a viewer subscribes, the last message of each topic
before that time is sent, so that the picture is whole before the log goes on.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from functools import partial

from fleet.addons.page.foxglove_server import (
    FELL_BEHIND,
    FoxgloveChannel,
    FoxgloveServer,
    PlaybackRequest,
    Subscription,
)
from fleet.mcap.seekable_log import SeekableLog, Track
from fleet.mcap.traffic import ATTACHMENT, DELETE, KIND
from fleet.replay.playback import obey
from fleet.replay.player import SEEK_NS, Player
from fleet.terminal.keyboard import Key, Keyboard
from fleet.terminal.line import Piece
from fleet.terminal.status_line import StatusLine

MOST = 256  # messages between two looks at what viewers ask for
NAP_S = 0.02  # the longest wait without a look at the keyboard
_BESIDE = (ATTACHMENT, DELETE)  # what stands beside the messages of captured traffic


class LogBridge:
    """From a log to a server for viewers. It plays while somebody watches, and never ends by itself."""

    def __init__(self, log: SeekableLog, host: str, port: int | None, *, rate: float, loop: bool) -> None:
        """Listen. `rate`: times the log's own pace. `loop`: begin again at the end. Raises FleetError: there is no
        port."""
        self._log, self._loop = log, loop
        ours = "uuv-fleet" in log.metadata.get("run", {})
        self._begin_ns = 0 if ours else log.due(0)  # simulated time begins at 0, whatever is logged first
        self._end_ns = log.end_ns
        self.server = FoxgloveServer(
            log.path.parent.name if ours else log.path.name,
            host,
            port,
            {n: _channel(log, n) for n, c in log.channels.items() if c.metadata.get(KIND) not in _BESIDE},
            range_ns=(self._begin_ns, self._end_ns),
        )
        self._chosen: set[int] = set()
        self._track = Track(log, ())
        self._player = Player(self._track, self._begin_ns, self._end_ns, rate=rate, paused=True)
        self._begun = False

    def run(self, keyboard: Keyboard, line: StatusLine) -> None:
        while True:
            now = time.monotonic_ns()
            if away := keyboard.suspended_ns():
                self._player.stood_still(away)
            self._send(self._player.due(now, MOST))
            self.server.time(self._player.position(now))
            if self._ended(now) and not self._player.paused:
                self._come_to_the_end(now)
            if self.server.fell_behind():
                line.print(FELL_BEHIND)
            line.update(partial(self._describe, now))
            wait = self._player.wait_ns(time.monotonic_ns())
            events = self.server.events(NAP_S if wait is None else min(NAP_S, wait / 1e9))
            self._choose([event for event in events if isinstance(event, Subscription)])
            for event in events:
                if isinstance(event, PlaybackRequest):
                    self._control(event)
            for key in keyboard.read(0):
                self._obey(key)

    def _choose(self, changes: list[Subscription]) -> None:
        if not changes:
            return
        now, before = time.monotonic_ns(), self._player
        at = before.position(now)
        self._chosen = wanted = self.server.wanted
        self._track = track = Track(self._log, wanted)
        self._player = Player(
            track, self._begin_ns, self._end_ns, rate=before.rate, paused=before.paused, now=now, before=track.before
        )
        self._player.seek(now, at)
        if not wanted and (self._ended(now) or not before.paused):  # nobody watches: it waits for somebody
            self._begun = False
            self._player.pause(now)
        elif wanted and not self._begun:
            self._begun = True
            if at >= self._end_ns:
                self._player.seek(now, at := self._begin_ns)
            self._player.resume(now)
        self._send_last({change.channel for change in changes if change.wanted}, at)
        self._tell(now)

    def _control(self, asked: PlaybackRequest) -> None:
        now = time.monotonic_ns()
        self._begun = True
        if asked.rate > 0:
            self._player.set_rate(now, asked.rate)
        seek_ns = asked.seek_ns
        if seek_ns is None and asked.play and self._ended(now):
            seek_ns = self._begin_ns
        if asked.play:
            self._player.resume(now)
        else:
            self._player.pause(now)
        if seek_ns is None:
            self._tell(now, request=asked.id)
        else:
            self._jump(now, seek_ns, request=asked.id)

    def _obey(self, key: Key) -> None:
        now = time.monotonic_ns()
        self._begun = True
        match key:
            case Key.FORWARD:
                self._jump(now, self._player.position(now) + SEEK_NS)
            case Key.BACK:
                self._jump(now, self._player.position(now) - SEEK_NS)
            case _:
                self._send(obey(self._player, key, now))
                self.server.time(self._player.position(now), now=True)
                self._tell(now)

    def _jump(self, now: int, log_ns: int, request: str = "") -> None:
        """Go to a time. A viewer that did not ask for it forgets what it has if that is earlier."""
        if log_ns < self._player.position(now) and not request:
            self.server.forget()
        self._player.seek(now, log_ns)
        at = self._player.position(now)
        self.server.time(at, now=True)
        self._tell(now, jumped=True, request=request)
        self._send_last(self._chosen, at)

    def _ended(self, now: int) -> bool:
        return self._player.position(now) >= self._end_ns and not self._player.left

    def _come_to_the_end(self, now: int) -> None:
        if self._loop:
            self._jump(now, self._begin_ns)
        else:
            self._player.pause(now)
            self.server.time(self._end_ns, now=True)
            self._tell(now)

    def _tell(self, now: int, *, jumped: bool = False, request: str = "") -> None:
        player = self._player
        status = "Ended" if self._ended(now) else "Paused" if player.paused else "Playing"
        self.server.state(status, player.position(now), player.rate, jumped=jumped, request=request)

    def _send(self, some: range) -> None:
        for _, entry in self._track.entries(some):
            self.server.put(entry.channel.id, entry.data, entry.log_ns)

    def _send_last(self, channels: Iterable[int], log_ns: int) -> None:
        for _, entry in self._log.last(sorted(channels), log_ns):
            self.server.put(entry.channel.id, entry.data, entry.log_ns)

    def _describe(self, now: int) -> list[Piece]:
        player, server = self._player, self.server
        at, end = ((ns - self._begin_ns) / 1e9 for ns in (player.position(now), self._end_ns))
        viewers = f"{server.viewers} viewer{'' if server.viewers == 1 else 's'}"
        return [
            Piece(0, [f"t = {at:.2f} / {end:.2f} s"]),
            Piece(1, [("paused" if player.paused else f"{player.rate:.3g} x real time") if self._begun else "waiting"]),
            Piece(2, [viewers]),
            Piece(3, [f"{len(self._chosen)} of {len(self._log.channels)} topics", ""]),
            Piece(4, [f"{server.sent} messages", ""]),
        ]


def _channel(log: SeekableLog, number: int) -> FoxgloveChannel:
    channel = log.channels[number]
    schema = log.schemas.get(channel.schema_id)
    encoding = channel.message_encoding or "application/octet-stream"
    if schema is None:
        return FoxgloveChannel(channel.topic, encoding, "", "", b"")
    return FoxgloveChannel(channel.topic, encoding, schema.name, schema.encoding, schema.data)
