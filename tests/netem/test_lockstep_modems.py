"""Modems of agents in lockstep: their news are what a relay tells its modems, and frames weigh what they carry."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netem.cause import Cause
from netem.condition import Condition
from netem.config import NetemConfig
from netem.endpoint import HeardFrame, Level, ModemRequest, SentFrame, Sound
from netem.faults import NetFault
from netem.lockstep_modems import read_news
from netem.modem import AcousticConfig, Modem
from netem.modem_frame import MARK, NEWS, SWITCH_ON, ModemFrame, read_frame, size_on_air
from netem.modem_news import Began, FrameArrived, SoundReached, Spoiled, SwitchedOn, Unsent
from netem.network import Netem
from netem.relay import Relay
from netem.robot_message import MODEM as MODEM_MESSAGE
from netem.robot_message import RobotMessage
from netem.wire.messages import Fate

TICK_NS = 10_000_000
# A byte is 10 ms, a tick, on the air, and sound travels 15 m meanwhile.
MODEM = Modem(800.0, 0.0, 25e3, 4e3, 190.0, 0.0, 3000.0, 6000.0, 64, 6.0, 10.0, 10.0, processing=0.02)
PLACES = {1: (0.0, 0.0, 10.0), 2: (150.0, 0.0, 10.0), 3: (0.0, 600.0, 20.0)}
LINKS = tuple((j, i) for j in PLACES for i in PLACES if i != j)
WATER = AcousticConfig(MODEM, buffer=2, refuses=True)


NOISE = NetFault("noise", 0, None, "link", links=LINKS, condition=Condition(corrupt=0.4))


def config(faults: tuple[NetFault, ...] = ()) -> NetemConfig:
    return NetemConfig(1, TICK_NS, 1, tuple(PLACES), LINKS, faults=faults, acoustic=WATER)


class Ear:
    """A modem that writes down what a relay tells it, as the news of the same would be."""

    def __init__(self, number: int) -> None:
        self.number = self.address = number
        self.news: list[Any] = []
        self.frames: list[HeardFrame] = []

    def on_heard(self, frame: HeardFrame) -> None:
        self.frames.append(frame)

    def on_sent(self, frame: SentFrame) -> None:
        self.news.append(Began(frame.tag, frame.at_ns, frame.airtime_ns))

    def on_dropped(self, tag: Any, cause: Cause) -> None:
        self.news.append(Unsent(tag, cause))

    def on_reached(self, sound: Sound) -> None:
        self.news.append(SoundReached(*sound))

    def on_spoiled(self, cause: Cause, at_ns: int, level: Level) -> None:
        self.news.append(Spoiled(cause, at_ns, level))


Said = list[tuple[int, int, bytes, int | None]]  # tick, vehicle, payload, and when it has to begin [ticks later]
SAID = st.lists(
    st.tuples(
        st.integers(0, 60), st.sampled_from(sorted(PLACES)), st.binary(min_size=1, max_size=70),
        st.none() | st.integers(0, 30),
    ),
    max_size=12,
)  # fmt: skip
END = 400


def of_relay(said: Said, faults: tuple[NetFault, ...]) -> dict[int, list[Any]]:
    """What modems learn in a relay, and the frames that arrive, by vehicle."""
    ears = {i: Ear(i) for i in PLACES}
    relay = Relay(config(faults), 0, modems=ears)  # type: ignore[arg-type]
    relay.places.update(PLACES)
    for tick in range(END):
        now = tick * TICK_NS
        for name, (at, src, payload, later) in enumerate(said):
            if at == tick:
                begin = None if later is None else (tick + later) * TICK_NS
                what = ModemRequest(src, src, 0, 7, payload, name, b"head", begin)
                relay.take(RobotMessage(src, MODEM_MESSAGE, "modem", payload, now, what))
        for due in list(relay.due_messages(now)):
            relay.hand_to(ears[due.dst], due)  # type: ignore[arg-type]
            relay.settle(due, now, delivered=True)
    return {i: [*ears[i].news, *ears[i].frames] for i in PLACES}


def of_lockstep(said: Said, faults: tuple[NetFault, ...]) -> dict[int, list[Any]]:
    """The same of agents in lockstep."""
    netem, whole = Netem(config(faults)), set[bytes]()
    news: dict[int, list[Any]] = {i: [] for i in PLACES}
    arrived: dict[int, list[Any]] = {i: [] for i in PLACES}
    for tick in range(END):
        sent: dict[int, tuple[bytes, ...]] = dict.fromkeys(PLACES, (SWITCH_ON,) if tick == 0 else ())
        for name, (at, src, payload, later) in enumerate(said):
            if at == tick:
                begin = None if later is None else (tick + later) * TICK_NS
                sent[src] += (ModemFrame(name, src, 0, 7, payload, b"head", begin).packed(),)
                whole |= {*sent[src]}
        for i, inbox in netem.exchange(tick, sent, PLACES).inboxes.items():
            known: dict[tuple[int, int, int], FrameArrived] = {}
            for delivery in inbox:
                if delivery.payload.startswith(NEWS):
                    assert delivery.src == i
                    events = read_news(delivery.payload)
                    known |= {
                        (each.src, each.seq, each.copy): each for each in events if isinstance(each, FrameArrived)
                    }
                    news[i] += [each for each in events if not isinstance(each, FrameArrived | SwitchedOn)]
                    assert tick > 0 or isinstance(events[0], SwitchedOn)
                elif delivery.payload in whole:
                    heard, frame = known[delivery.src, delivery.seq, delivery.copy], read_frame(delivery.payload)
                    assert frame is not None and delivery.due_tick == -(-heard.end_ns // TICK_NS)
                    arrived[i].append(
                        HeardFrame(
                            frame.src, frame.to, frame.what, frame.payload, heard.sent_ns, heard.begin_ns, heard.end_ns,
                            frame.head, heard.level, heard.away,
                        )
                    )  # fmt: skip
    return {i: [*news[i], *arrived[i]] for i in PLACES}


@given(SAID, st.booleans(), st.booleans())
def test_modems_learn_in_lockstep_what_a_relay_tells_them(said: Said, muted: bool, damaged: bool) -> None:
    faults = (NetFault("quiet", 20, 40, "mute", vehicles=frozenset({2})),) if muted else ()
    faults = (NOISE, *faults) if damaged else faults
    assert of_lockstep(said, faults) == of_relay(said, faults)


def test_a_damaged_frame_is_told_to_who_hears_it() -> None:
    """It was dropped without a word."""
    said: Said = [(3 + 20 * n, 1, b"8 bytes!", None) for n in range(6)]
    heard = of_lockstep(said, (NOISE,))[2]
    causes = [each.cause for each in heard if isinstance(each, Spoiled)]
    assert causes and set(causes) == {Cause.SNR}
    assert len(causes) + sum(isinstance(each, HeardFrame) for each in heard) == len(said)


def test_a_range_of_times_is_that_of_the_way() -> None:
    """150 m are 100 ms; 8 bytes 80 ms; the receiver's modem takes 20 ms."""
    (began,) = [each for each in of_lockstep([(3, 1, b"8 bytes!", None)], ())[1] if isinstance(each, Began)]
    frames = [each for each in of_lockstep([(3, 1, b"8 bytes!", None)], ())[2] if isinstance(each, HeardFrame)]
    assert began == Began(0, 30_000_000, 80_000_000)
    assert [(each.sent_ns, each.begin_ns, each.end_ns) for each in frames] == [(30_000_000, 130_000_000, 230_000_000)]
    assert frames[0].payload == b"8 bytes!" and frames[0].head == b"head" and frames[0].away == (-150.0, 0.0, 0.0)


@given(
    st.integers(0, 2**32 - 1), st.integers(0, 255), st.binary(max_size=300), st.binary(max_size=300),
    st.none() | st.integers(0, 2**62),
)  # fmt: skip
def test_a_frame_is_read_as_it_was_written(name: int, to: int, payload: bytes, head: bytes, at: int | None) -> None:
    frame = ModemFrame(name, 3, to, 64, payload, head, at)
    assert read_frame(frame.packed()) == frame and size_on_air(frame.packed()) == len(payload)


@given(st.binary(max_size=60) | st.binary(max_size=60).map(lambda data: MARK + data))
def test_whatever_comes_is_no_frame_or_one_and_weighs_something(data: bytes) -> None:
    read_frame(data)
    assert 0 <= size_on_air(data) <= len(data)


@pytest.mark.parametrize("listening", [(1,), (1, 2, 3)])
def test_who_listens_changes_nothing_for_the_packets(listening: tuple[int, ...]) -> None:
    """Fates are a matter of the water alone."""

    def fates(listening: tuple[int, ...]) -> list[Fate]:
        netem, found = Netem(config()), []
        for tick in range(200):
            sent = {i: (SWITCH_ON,) if tick == 0 and i in listening else () for i in PLACES}
            if tick % 9 == 1:
                sent[1 + tick % 3] = (ModemFrame(tick, 1, 0, 7, bytes(12)).packed(),)
            found += netem.exchange(tick, sent, PLACES).fates
        return found

    assert len(fates(())) > 20 and fates(listening) == fates(())


def test_another_network_goes_on_with_the_modems_of_the_first() -> None:
    """As after a fork: what was switched on stays so, and frames on their way keep their names."""

    def inboxes(change_at: int) -> list[Any]:
        netem, found = Netem(config()), []
        for tick in range(120):
            if tick == change_at:
                before, netem = netem, Netem(config())
                netem.take_over(before)
            sent: dict[int, tuple[bytes, ...]] = dict.fromkeys(PLACES, (SWITCH_ON,) if tick == 0 else ())
            if tick in (3, 28):
                sent[1] += (ModemFrame(tick, 1, 0, 7, bytes(12)).packed(),)
            found.append(netem.exchange(tick, sent, PLACES).inboxes)
        return found

    assert inboxes(30) == inboxes(-1) and any(inbox for each in inboxes(-1)[40:] for inbox in each.values())
