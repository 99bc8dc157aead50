"""The core of a modem that programs open: its address, its queue, what it is doing, and ranging.

Payloads wait here in order, and one at a time is in the channel. So a full queue can refuse, and be emptied. Beside
them wait those whose program has asked for a time to begin.

A range is measured by a request and an answer. The answer says when the request had come, so that the time in between
can be taken off, as a modem with a fixed turn-around does.

| symbol | meaning | unit |
|---|---|---|
| t0, t3 | when the request left, and its answer came | s |
| t1, t2 | when the request came, and the answer left | s |
| c | sound speed | m/s |

range = c ((t3 - t0) - (t2 - t1)) / 2
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from heapq import heapify, heappop, heappush
from itertools import cycle
from pathlib import Path
from struct import Struct
from time import monotonic_ns
from typing import Any, Literal, Protocol

from fleet.addons.modems.delivery import CLEARED, Deliveries, Job
from fleet.addons.modems.line_port import LinePort, Translator
from netem.cause import Cause
from netem.endpoint import (
    EVERYBODY,
    MOST_ADDRESS,
    UNKNOWN,
    HeardFrame,
    Level,
    ModemChannel,
    ModemRequest,
    SentFrame,
    Sound,
)

# Protocol numbers of what modems say to each other. Programs have 0 to 63, so none of theirs means that by chance.
FIRST_OWN = 64
RANGING = FIRST_OWN
PIGGYBACK = FIRST_OWN + 9  # what came with an acknowledgement
_REQUEST = Struct("<B")  # its number
_ANSWER = Struct("<Bq")  # the number of the request, and when it had come [ns since the modems were switched on]
_MOST_OWN = 64  # answers and second tries that wait at most
# What has a time is given to the channel so long before it, since that takes payloads at the ticks of the run.
_LEAD_NS = 50_000_000
FULL = "the queue is full"
_MOST_REMARKS = 8
_MOST_WAIT_S = 3600.0  # the system waits for no more than some weeks, and a program may ask for a time beyond them
SLACK_S = 5.0  # beside travel and airtime, until a range counts as missing: others may be on the air


class ModemLanguage(Translator, Protocol):
    """A translator, and what the modem tells it."""

    link: int | None  # the protocol number of frames that are acknowledged; None: the language has none

    def begin(self, modem: ModemCore) -> None:
        """The channel carries from now on."""

    def on_heard(self, frame: HeardFrame, *, linked: bool) -> None:
        """A payload has arrived for this modem, or for all. `linked`: it came by the link."""

    def on_pinged(self, frame: HeardFrame) -> None:
        """Another modem measures its range to this one."""

    def begins(self, sound: Sound) -> None:
        """A transmission of another modem begins to be heard."""

    def on_spoiled(self, cause: Cause, at_ns: int, level: Level) -> None:
        """A reception has failed."""


@dataclass(slots=True)
class _Ranging:
    to: int
    number: int
    then: Callable[[float | None], None]  # gets the range [m]; None: no answer came
    sent_ns: int = 0


class ModemCore:
    """A modem endpoint in any language. It is handed to the process of the relay before it has begun.

    The thread of the relay calls `listen` to `on_reached`; what a language asks runs on the thread of the port.
    """

    def __init__(
        self,
        number: int,
        make: Callable[[], ModemLanguage],
        port: int = 0,
        host: str = "127.0.0.1",
        terminal: str = "",
        address: int | None = None,
    ) -> None:
        """Prepare it; nothing is opened.

        Args:
            number: of its robot.
            make: makes its language.
            port: on which it listens; 0: any.
            host: of the port; 127.0.0.1 is seen by this machine alone.
            terminal: the path of a pseudo terminal, in place of a port; empty: there is none.
            address: in the water, which programs may change; None: the number.
        """
        self.address = address or number
        self.number, self._make, self._where, self._terminal = number, make, (host, port), terminal
        self.channel: ModemChannel = None  # type: ignore[assignment]  # `begin` sets it, before anything asks
        self._waiting: deque[Job] = deque()
        self._timed: list[Job] = []  # wait for their time
        self._given: dict[int, Job] = {}  # in the channel, by tag
        self._now: int | None = None  # the one of them that has no time
        self._count = 0  # of payloads that were given to the channel
        self._sends_until_ns = self._hears_until_ns = self._refused = 0
        self._remarks: list[str] = []
        self._deliveries: Deliveries | None = None
        self.travel_us = 0  # of sound from the modem that was heard last
        self._ranging: list[_Ranging] = []
        self._alarms: list[tuple[int, int, Callable[[], None]]] = []  # a heap
        self._set = 0
        self._requests = cycle(range(256))  # numbers of ranges

    def listen(self) -> str:
        """See `ModemEndpoint`."""
        self.language = self._make()
        self.line_port = LinePort(self.language, self._tick)
        if self._terminal:
            self.line_port.open_terminal(Path(self._terminal))
            return self._terminal
        self.line_port.listen(*self._where)
        return str(self.line_port.port)

    def begin(self, channel: ModemChannel) -> None:
        """See `ModemEndpoint`."""
        self.channel = channel
        if self.language.link is not None:
            self._deliveries = Deliveries(self.language.link, PIGGYBACK, channel, self._put, self.call_after)
        self.language.begin(self)
        self.line_port.begin()

    def on_sent(self, frame: SentFrame) -> None:
        """See `ModemEndpoint`."""
        self.line_port.post(lambda: self._has_sent(frame))

    def on_dropped(self, tag: Any, cause: Cause) -> None:
        """See `ModemEndpoint`."""
        self.line_port.post(lambda: self._was_dropped(tag, cause))

    def on_heard(self, frame: HeardFrame) -> None:
        """See `ModemEndpoint`."""
        self.line_port.post(lambda: self._hears(frame))

    def on_spoiled(self, cause: Cause, at_ns: int, level: Level = UNKNOWN) -> None:
        """See `ModemEndpoint`."""
        self.line_port.post(lambda: self.language.on_spoiled(cause, at_ns, level))

    def on_reached(self, sound: Sound) -> None:
        """See `ModemEndpoint`."""
        self.line_port.post(lambda: self._at(sound.begin_ns, lambda: self._hears_begin(sound)))

    @property
    def remark(self) -> str:
        """See `ModemEndpoint`."""
        said = ["its modem failed in part: the traceback is in log/relay.log"] if self.line_port.failed else []
        if self._refused:
            some = f"{self._refused} payload{'s' if self._refused > 1 else ''}"
            said.append(f"its modem refused {some}, since {self.channel.queue} were waiting")
        said += self._remarks
        return "; ".join(said)

    def close(self) -> None:
        """See `ModemEndpoint`."""
        self.line_port.close()

    @property
    def state(self) -> Literal["idle", "transmitting", "receiving"]:
        """What it is doing. What it hears may be for others, or be spoiled."""
        now = monotonic_ns()
        if now < self._sends_until_ns:
            return "transmitting"
        return "receiving" if now < self._hears_until_ns else "idle"

    @property
    def room(self) -> int:
        """How many payloads it takes now."""
        return self.channel.queue + (self._now is None) - len(self._waiting)

    @property
    def now_us(self) -> int:
        """The time by its clock [us], which begins when the modems are switched on."""
        return self.us(monotonic_ns())

    def us(self, at_ns: int) -> int:
        """A time of CLOCK_MONOTONIC [ns] as a time by its clock [us]. It is 0 before the run begins."""
        return max(0, at_ns - self.channel.begin_ns) // 1000

    def at_ns(self, us: int) -> int:
        """A time by its clock [us] as a time of CLOCK_MONOTONIC [ns]."""
        return self.channel.begin_ns + us * 1000

    def remark_once(self, text: str) -> None:
        """Tell something in the result of the run; of many different things the first few."""
        if text not in self._remarks and len(self._remarks) < _MOST_REMARKS:
            self._remarks.append(text)

    def submit(self, *jobs: Job) -> str:
        """Take payloads for transmission, all or none. Returns why not; empty: they wait, or are on their way."""
        for job in jobs:
            if why := self._unfit(job):
                return why
        if len(jobs) > self.room:
            self._refused += len(jobs)
            return FULL
        for job in jobs:
            self._put(job)
        return ""

    def submit_at(self, job: Job, at_ns: int) -> str:
        """Take a payload that begins at a time, whoever's turn it is: at the first tick of the run then.

        Args:
            job: the payload.
            at_ns: when its transmission begins [ns, CLOCK_MONOTONIC].

        Returns:
            why that cannot be; empty: it waits, or is on its way.
        """
        now = monotonic_ns()
        if why := self._unfit(job):
            return why
        if self.channel.modem.tries:
            return "its modem tells one neighbour after the other, and so begins at no time that is asked for"
        if at_ns < now:
            return f"the time is past: it is {self.us(now)} us, and {self.us(at_ns)} us were asked for"
        if len(self._timed) >= self.channel.queue:
            self._refused += 1
            return FULL
        job.at_ns = at_ns
        self._timed.append(job)
        self._at(at_ns - _LEAD_NS, partial(self._give_timed, job))
        return ""

    def _unfit(self, job: Job) -> str:
        """Why a payload can never be sent; empty: it can."""
        if len(job.payload) > self.channel.mtu:
            return f"{len(job.payload)} bytes are more than the MTU of {self.channel.mtu}"
        if not EVERYBODY <= job.to <= MOST_ADDRESS:
            return f"there is no address {job.to}: they are 1 to {MOST_ADDRESS}"
        return ""

    def go_on(self, job: Job) -> str:
        """Take one more piece of something that was taken before, whether there is room or not. Returns an empty text,
        as `submit` does."""
        self._put(job)
        return ""

    def deliver(self, job: Job, tries: int, then: Callable[[HeardFrame | None], None], *, goes_on: bool = False) -> str:
        """Send a payload until it is acknowledged. Returns why that cannot be; empty: `then` gets the acknowledgement,
        or None if the payload was not delivered. The language has a link. `goes_on`: see `go_on`."""
        assert self._deliveries is not None
        return self._deliveries.send(job, tries, then, self.go_on if goes_on else self.submit)

    def answer_with(self, to: int, payload: bytes) -> str:
        """Let a payload travel with the next acknowledgement for a modem. The language has a link.

        Args:
            to: its address.
            payload: what it gets.

        Returns:
            why that cannot be; empty: it waits for that.
        """
        assert self._deliveries is not None
        if not EVERYBODY < to <= MOST_ADDRESS or len(payload) > self.channel.mtu:
            return "there is no such address, or the payload is longer than the MTU"
        self._deliveries.answer_with(to, payload)
        return ""

    def unacknowledged(self, job: Job) -> Job:
        """A payload as one of the link that nobody acknowledges. The language has a link."""
        assert self._deliveries is not None
        return self._deliveries.unacknowledged(job)

    def clear(self) -> None:
        """Give up what waits, and what waits for its acknowledgement; what is in the channel goes on."""
        waiting, self._waiting, self._timed = [*self._waiting, *self._timed], deque(), []
        self._alarms = [one for one in self._alarms if getattr(one[2], "func", None) != self._give_timed]
        heapify(self._alarms)
        if self._deliveries is not None:
            self._deliveries.clear()
        for job in waiting:
            job.on_dropped(CLEARED)

    def range_to(self, to: int, then: Callable[[float | None], None]) -> str:
        """Measure the range to a modem. Returns why it cannot be tried; empty: `then` gets the range, or None."""
        air_s = 2 * self.channel.modem.airtime_ns(_ANSWER.size) / 1e9
        ranging = _Ranging(to, next(self._requests), then)

        def left(frame: SentFrame) -> None:
            ranging.sent_ns = frame.at_ns

        if why := self.submit(Job(_REQUEST.pack(ranging.number), to, RANGING, left)):
            return why
        self._ranging.append(ranging)

        def gives_up() -> None:
            if ranging in self._ranging:
                self._ranging.remove(ranging)
                then(None)

        self.call_after(self.channel.there_and_back_s + air_s + 2 * self.channel.access_s + SLACK_S, gives_up)
        return ""

    def call_after(self, wait_s: float, then: Callable[[], None]) -> None:
        """Call something after a time [s], on the thread of the port."""
        self._at(monotonic_ns() + round(wait_s * 1e9), then)

    def _at(self, at_ns: int, then: Callable[[], None]) -> None:
        self._set += 1
        heappush(self._alarms, (at_ns, self._set, then))

    def _put(self, job: Job) -> None:
        """Let a payload wait for its transmission: of the modem's own, it may be one too many."""
        if len(self._waiting) < self.channel.queue + _MOST_OWN:
            self._waiting.append(job)
            self._go_on()
        else:
            job.on_dropped(str(Cause.QUEUE))

    def _go_on(self) -> None:
        if self._now is None and self._waiting:
            self._now = self._give(self._waiting.popleft())

    def _give(self, job: Job) -> int:
        """Give the channel a payload. Returns its tag."""
        tag = self._count = self._count + 1
        self._given[tag] = job
        self.channel.send(
            ModemRequest(self.number, self.address, job.to, job.what, job.payload, tag, job.head, job.at_ns)
        )
        return tag

    def _give_timed(self, job: Job) -> None:
        for number, one in enumerate(self._timed):
            if one is job:  # else it was cleared
                del self._timed[number]
                self._give(job)
                return

    def _has_sent(self, frame: SentFrame) -> None:
        job = self._over(frame.tag)
        if job is not None:
            self._sends_until_ns = max(self._sends_until_ns, frame.at_ns + frame.airtime_ns)
            job.on_sent(frame)
            self._go_on()

    def _was_dropped(self, tag: Any, cause: Cause) -> None:
        job = self._over(tag)
        if job is not None:
            busy = job.at_ns is not None and cause is Cause.QUEUE
            job.on_dropped("the modem was still sending something else at that time" if busy else str(cause))
            self._go_on()

    def _over(self, tag: Any) -> Job | None:
        """Take a payload out of the channel. None: it is out of it, as a modem with tries sends it several times."""
        if tag == self._now:
            self._now = None
        return self._given.pop(tag, None)

    def _hears_begin(self, sound: Sound) -> None:
        self._hears_until_ns = max(self._hears_until_ns, sound.end_ns)
        if sound.begin_ns >= self._sends_until_ns:  # else it is deaf
            self.language.begins(sound)

    def _hears(self, frame: HeardFrame) -> None:
        if frame.to not in (EVERYBODY, self.address):
            return
        self.travel_us = (frame.begin_ns - frame.sent_ns) // 1000
        if self._deliveries is not None and frame.what == self.language.link:
            if (carried := self._deliveries.take_frame(frame)) is not None:
                self.language.on_heard(carried, linked=True)
        elif frame.what != RANGING:
            self.language.on_heard(frame, linked=False)
        elif len(frame.payload) == _REQUEST.size:
            came_ns = frame.begin_ns - self.channel.begin_ns  # clocks of hosts differ, as do real and simulated ones
            self._put(Job(_ANSWER.pack(frame.payload[0], came_ns), frame.src, RANGING))
            self.language.on_pinged(frame)
        elif len(frame.payload) == _ANSWER.size:
            number, came_ns = _ANSWER.unpack(frame.payload)
            for one in [one for one in self._ranging if (one.to, one.number) == (frame.src, number) and one.sent_ns]:
                self._ranging.remove(one)
                travel_ns = (frame.begin_ns - one.sent_ns) - (frame.sent_ns - self.channel.begin_ns - came_ns)
                one.then(self.channel.sound_speed * travel_ns / 2e9)

    def _tick(self) -> float | None:
        while self._alarms and self._alarms[0][0] <= monotonic_ns():
            self.line_port.do(heappop(self._alarms)[2])
        wait_s = (self._alarms[0][0] - monotonic_ns()) / 1e9 if self._alarms else None
        return None if wait_s is None else min(_MOST_WAIT_S, max(0.0, wait_s))
