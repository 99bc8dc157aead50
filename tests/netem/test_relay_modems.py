"""What the relay tells a modem that programs open: when it transmits, what reaches it, and what becomes of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import pytest

from netem.cause import Cause
from netem.condition import Condition, Link
from netem.config import NetemConfig
from netem.endpoint import HeardFrame, Level, ModemChannel, ModemRequest, SentFrame, Sound
from netem.faults import NetFault
from netem.modem import AcousticConfig, Modem
from netem.relay import Relay
from netem.robot_message import MODEM, RobotMessage

TICK_NS, BEGIN_NS = 10_000_000, 5_000_000_000
PERFECT = Condition()
LINKS: tuple[Link, ...] = ((1, 2), (2, 1), (2, 3), (3, 2), (1, 3), (3, 1))
# A byte is 10 ms, and 150 m are 0.1 s.
QUICK = Modem(800.0, 0.1, 25e3, 4e3, 190.0, 0.0, 3000.0, 6000.0, 60, 6.0, 10.0, 10.0)
PLACES = {1: (0.0, 0.0, 10.0), 2: (150.0, 0.0, 10.0), 3: (300.0, 0.0, 10.0)}


@dataclass
class Listener:
    """A modem that keeps what it is told; times in ms after the begin."""

    number: int
    address: int = 0
    told: list[tuple[Any, ...]] = field(default_factory=list)
    remark: str = ""

    def listen(self) -> str:
        raise AssertionError

    def begin(self, channel: ModemChannel) -> None:
        raise AssertionError

    def close(self) -> None:
        raise AssertionError

    def on_sent(self, frame: SentFrame) -> None:
        self.told.append(("sent", frame.tag, ms(frame.at_ns), frame.airtime_ns // 10**6))

    def on_dropped(self, tag: Any, cause: Cause) -> None:
        self.told.append(("dropped", tag, cause))

    def on_heard(self, frame: HeardFrame) -> None:
        self.told.append(("heard", frame.src, frame.to, frame.payload, ms(frame.sent_ns), ms(frame.begin_ns)))

    def on_reached(self, sound: Sound) -> None:
        self.told.append(("reached", ms(sound.begin_ns), ms(sound.end_ns)))

    def on_spoiled(self, cause: Cause, at_ns: int, level: Level) -> None:
        self.told.append(("spoiled", cause))


def ms(at_ns: int) -> float:
    return (at_ns - BEGIN_NS) / 1e6


def told(
    *sent: tuple[int, int, bytes, float],
    faults: tuple[NetFault, ...] = (),
    links: tuple[Link, ...] = LINKS,
    condition: Condition = PERFECT,
    starts: Mapping[bytes, float] = MappingProxyType({}),
    **more: Any,
) -> dict[int, list[Any]]:
    """What three modems learn if these payloads are given to them: (modem, receiver, payload, time [ms]).

    `starts`: when payloads have to begin [ms].
    """
    acoustic = AcousticConfig(**{"modem": QUICK, "buffer": 2, "refuses": True, "sound_speed": 1500.0} | more)
    config = NetemConfig(
        seed=1, tick_ns=TICK_NS, round_ticks=1, vehicles=(1, 2, 3), links=links,
        conditions=dict.fromkeys(links, condition), faults=faults, acoustic=acoustic,
    )  # fmt: skip
    modems = {i: Listener(i) for i in config.vehicles}
    relay = Relay(config, BEGIN_NS, modems=modems)
    relay.places.update(PLACES)
    waiting = sorted(sent, key=lambda one: one[3])
    for tick in range(800):
        at_ns = BEGIN_NS + tick * TICK_NS
        while waiting and waiting[0][3] <= ms(at_ns):
            src, to, payload, _ = waiting.pop(0)
            start = starts.get(payload)
            start_ns = None if start is None else BEGIN_NS + round(start * 1e6)
            request = ModemRequest(src, 100 + src, to, 0, payload, "t", b"head", start_ns)
            relay.take(RobotMessage(src, MODEM, "modem/0", payload, at_ns, request))
        for due in list(relay.due_messages(at_ns)):
            if (frame := relay.frame_of(due)) is not None:
                modems[due.dst].on_heard(frame)
            relay.settle(due, at_ns, delivered=True)
    return {i: modem.told for i, modem in modems.items()}


def test_a_payload_is_sent_reaches_all_and_is_heard_whoever_it_is_for() -> None:
    """5 bytes and the preamble are 150 ms on the air."""
    found = told((1, 2, b"hello", 50.0))
    assert found[1] == [("sent", "t", 50.0, 150)]
    assert found[2] == [("reached", 150.0, 300.0), ("heard", 101, 2, b"hello", 50.0, 150.0)]
    assert found[3] == [("reached", 250.0, 400.0), ("heard", 101, 2, b"hello", 50.0, 250.0)]


def test_a_collision_is_told_where_it_is_one() -> None:
    found = told((1, 2, b"hello", 0.0), (3, 2, b"world", 0.0))
    assert [one[0] for one in found[2]] == ["reached", "reached", "spoiled", "spoiled"]
    assert found[2][2:] == [("spoiled", Cause.COLLISION)] * 2


def test_what_a_modem_cannot_send_is_told_to_it_alone() -> None:
    mute = NetFault("m", 0, 100, "mute", vehicles=(1,))
    found = told((1, 2, b"hello", 0.0), faults=(mute,))
    assert found[1] == [("dropped", "t", Cause.MUTE)] and not found[2] and not found[3]


def test_a_loss_in_the_modem_is_told_once_however_many_hear_it() -> None:
    """Else a node without receivers would wait for ever, and one with two would count two losses."""
    mute = NetFault("m", 0, 100, "mute", vehicles=(1,))
    for links in ((), ((1, 2),), LINKS):
        found = told((1, 2, b"hello", 0.0), faults=(mute,), links=links)
        assert found[1] == [("dropped", "t", Cause.MUTE)]


def test_a_payload_that_is_replaced_is_told() -> None:
    """As in a channel with a buffer of one, where the node's other programs talk, too."""
    found = told((1, 2, b"a" * 30, 0.0), (1, 2, b"b" * 30, 10.0), (1, 2, b"c" * 30, 20.0), refuses=False, buffer=1)
    assert [one[0] for one in found[1]].count("sent") == 2 and ("dropped", "t", Cause.REPLACED) in found[1]


def test_a_damaged_frame_is_not_heard() -> None:
    """Its bytes would be taken for data, or for an acknowledgement."""
    found = told((1, 2, b"hello", 0.0), condition=Condition(corrupt=1.0))
    assert [one[0] for one in found[2]] == ["reached"]


@pytest.mark.parametrize("more", [{"modem": replace(QUICK, tries=3, timeout=1.0, acknowledgement=1)}, {"mac": "tdma"}])
def test_a_payload_leaves_with_any_modem_and_turn(more: dict[str, Any]) -> None:
    """A modem with tries sends it to each neighbour, and in slots each waits for its own."""
    turns = {"slot_ticks": 30, "guard_ns": 0} if "mac" in more else {"backoff_ticks": 30}
    found = told((1, 2, b"hi", 0.0), (2, 3, b"ho", 0.0), **more, **turns)
    for i, other, payload in ((1, 2, b"hi"), (2, 3, b"ho")):
        assert found[i] and any(one[0] == "sent" for one in found[i])
        assert any(one[0] == "heard" and one[3] == payload for one in found[other])


def test_sound_passes_where_a_link_is_cut() -> None:
    """A partition keeps frames, and no energy: the modem hears that somebody talks."""
    cut = NetFault("c", 0, 100, "down", ((1, 2),))
    found = told((1, 2, b"hello", 0.0), faults=(cut,))
    assert found[2] == [("reached", 100.0, 250.0)]


MACS: list[dict[str, Any]] = [{"mac": "aloha", "backoff_ticks": 30}, {"mac": "csma", "backoff_ticks": 30},
                              {"mac": "tdma", "slot_ticks": 100, "guard_ns": 0}]  # fmt: skip


@pytest.mark.parametrize("mac", MACS)
def test_a_payload_begins_when_its_program_says_whoevers_turn_it_is(mac: dict[str, Any]) -> None:
    """A program with slots of its own would else collide with the others. The start is at the next whole tick."""
    found = told((2, 1, b"hello", 0.0), starts={b"hello": 1234.5}, **mac)
    assert found[2] == [("sent", "t", 1240.0, 150)]
    assert found[1] == [("reached", 1340.0, 1490.0), ("heard", 102, 1, b"hello", 1240.0, 1340.0)]


def test_programs_with_slots_of_their_own_do_not_collide() -> None:
    """Both have a payload at once; without their times they collide at the modem between them."""
    both = ((1, 2, b"hello", 0.0), (3, 2, b"world", 0.0))
    assert [one[0] for one in told(*both)[2]].count("spoiled") == 2
    found = told(*both, starts={b"hello": 500.0, b"world": 1000.0})
    assert [one[3] for one in found[2] if one[0] == "heard"] == [b"hello", b"world"]


def test_what_cannot_begin_at_its_time_is_lost_and_told() -> None:
    """The modem sends 60 bytes from 0 to 0.7 s. Later it would disturb the turn of somebody else."""
    found = told((1, 2, b"a" * 60, 0.0), (1, 2, b"hello", 0.0), starts={b"hello": 500.0})
    assert found[1] == [("sent", "t", 0.0, 700), ("dropped", "t", Cause.QUEUE)]
    mute = NetFault("m", 0, 100, "mute", vehicles=(1,))
    found = told((1, 2, b"hello", 0.0), starts={b"hello": 500.0}, faults=(mute,))
    assert found[1] == [("dropped", "t", Cause.MUTE)]


def test_a_payload_that_waits_for_its_time_lets_others_by_and_goes_first_then() -> None:
    """The other one is there at 0.4 s with a back-off of up to 0.3 s, and leaves before it or behind it."""
    found = told((1, 2, b"hello", 0.0), (1, 2, b"other", 0.0), starts={b"hello": 900.0}, backoff_ticks=30)
    assert [one[3] for one in found[2] if one[0] == "heard"] == [b"other", b"hello"]
    found = told((1, 2, b"hello", 0.0), (1, 2, b"other", 890.0), starts={b"hello": 900.0}, backoff_ticks=30)
    assert next(one[2] for one in found[1]) == 900.0 and [one[0] for one in found[1]] == ["sent", "sent"]


def test_a_frame_says_how_strong_it_is_where_it_is_heard_and_from_where_it_comes() -> None:
    """By the propagation that decides its fate: the nearer one hears it stronger."""
    acoustic = AcousticConfig(modem=QUICK, buffer=2, refuses=True, sound_speed=1500.0)
    config = NetemConfig(seed=1, tick_ns=TICK_NS, round_ticks=1, vehicles=(1, 2, 3), links=LINKS,
                         conditions=dict.fromkeys(LINKS, PERFECT), acoustic=acoustic)  # fmt: skip
    relay = Relay(config, BEGIN_NS, modems={i: Listener(i) for i in config.vehicles})
    relay.places.update(PLACES)
    request = ModemRequest(1, 1, 0, 0, b"hello", "t", b"head")
    relay.take(RobotMessage(1, MODEM, "modem/0", b"hello", BEGIN_NS, request))
    frames = {due.dst: relay.frame_of(due) for due in relay.due_messages(BEGIN_NS + 10**9)}
    for dst, range_m in ((2, 150.0), (3, 300.0)):
        frame = frames[dst]
        assert frame is not None and frame.head == b"head" and frame.away == (-range_m, 0.0, 0.0)
        assert frame.level.received == pytest.approx(acoustic.received_level(range_m))
        assert frame.level.snr == pytest.approx(acoustic.snr(range_m))
