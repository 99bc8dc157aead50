"""Laws of the relay: a packet has the fate that it has in lockstep, once; messages leave whole, when they are due."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest
from any_condition import conditions as any_conditions
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

import netem.relay
from netem.cause import Cause
from netem.condition import Condition, Link
from netem.config import NetemConfig
from netem.faults import NetFault
from netem.limits import LINK_UNDER_WAY
from netem.modem import AcousticConfig, Modem
from netem.network import Netem
from netem.relay import DueMessage, MessageFate, Relay
from netem.robot_message import PUT, REPLY, RobotMessage

TICK_NS = 1_000_000
BEGIN_NS = 5_000_000_000
PERFECT = Condition()
LINKS: tuple[Link, ...] = ((1, 2), (2, 1), (2, 3), (3, 2))
# A byte is 10 ms. Sound travels 15 m in a tick of 10 ms. Back-offs of at most 0 ticks.
MODEM = Modem(800.0, 0.1, 25e3, 4e3, 190.0, 0.0, 3000.0, 6000.0, 60, 6.0, 10.0, 10.0)
PLACES = {1: (0.0, 0.0, 10.0), 2: (150.0, 0.0, 10.0), 3: (300.0, 0.0, 10.0)}


def config(condition: Condition = PERFECT, seed: int = 1, *faults: NetFault, water: bool = False) -> NetemConfig:
    return NetemConfig(
        seed=seed,
        tick_ns=10 * TICK_NS if water else TICK_NS,
        round_ticks=100,
        vehicles=(1, 2, 3),
        links=LINKS,
        conditions=dict.fromkeys(LINKS, condition),
        faults=faults,
        acoustic=AcousticConfig(MODEM, buffer=20) if water else None,
    )


def message(src: int, payload: bytes, at_ms: float = 0.0, to: int | None = None) -> RobotMessage:
    return RobotMessage(src, PUT if to is None else REPLY, "a/b", payload, BEGIN_NS + round(at_ms * 1e6), None, to)


def handed(relay: Relay, at_ms: float) -> list[DueMessage]:
    """What is due, and has been handed over at once."""
    at_ns = BEGIN_NS + round(at_ms * 1e6)
    found = list(relay.due_messages(at_ns))
    for due in found:
        relay.settle(due, at_ns, delivered=True)
    return found


def key(fate: MessageFate) -> tuple[object, ...]:
    return fate.src, fate.dst, fate.seq, fate.copy, fate.cause == Cause.DELIVERED, fate.corrupted


short = any_conditions().map(
    lambda c: replace(c, delay_ns=c.delay_ns % 300_000_000, jitter_ns=c.jitter_ns % 100_000_000)
)


@given(short, st.integers(0, 2**40), st.lists(st.tuples(st.integers(1, 3), st.binary(max_size=9)), max_size=20))
def test_the_nth_packet_of_a_link_has_the_fate_of_lockstep(
    condition: Condition, seed: int, sent: list[tuple[int, bytes]]
) -> None:
    """Of (seed, link, n): a message per tick here, and per round tick there."""
    relay = Relay(config(condition, seed), BEGIN_NS)
    lockstep = Netem(replace(config(condition, seed), round_ticks=1))
    there = []
    for tick, (src, payload) in enumerate(sent):
        relay.take(message(src, payload, tick))
        there += lockstep.exchange(tick, {src: (payload,)}, PLACES).fates
    handed(relay, 10**9)
    here = relay.report(10**12)
    end = 10**9
    for tick in range(len(sent), len(sent) + 1):
        there += lockstep.exchange(tick, {}, PLACES).fates
    there += lockstep.close(end)
    # What is still under way there has been delivered here: nobody waits for it in this test.
    expected = Counter((f.src, f.dst, f.seq, f.copy, f.cause in ("delivered", "in flight"), f.corrupted) for f in there)
    assert Counter(map(key, here)) == expected
    delays = {(f.src, f.dst, f.seq, f.copy): f.delay_ns for f in there if f.cause in ("delivered", "in flight")}
    assert {(f.src, f.dst, f.seq, f.copy): f.delay_ns for f in here if f.cause == Cause.DELIVERED} == delays


@given(short, st.lists(st.tuples(st.integers(1, 3), st.floats(0.0, 500.0)), max_size=20), st.integers(0, 600))
def test_every_packet_is_accounted_for_once(condition: Condition, sent: list[tuple[int, float]], end_ms: int) -> None:
    relay = Relay(config(condition), BEGIN_NS)
    fates: list[MessageFate] = []
    for src, at_ms in sorted(sent, key=lambda one: one[1]):
        relay.take(message(src, b"abc", at_ms))
        handed(relay, at_ms)
        fates += relay.report(int(at_ms))
    fates += relay.close(10**6 + end_ms)
    entered = relay.entered
    left = Counter((fate.src, fate.dst) for fate in fates)
    assert all(left[link] == packets + copies for link, (packets, copies) in entered.items())
    assert [fate.final_tick for fate in fates] == sorted(fate.final_tick for fate in fates)


def test_a_message_leaves_when_its_delay_is_over_to_the_nanosecond() -> None:
    relay = Relay(config(Condition(delay_ns=100_300_000)), BEGIN_NS)
    relay.take(message(1, b"hello", 0.5))
    assert relay.due_ns() == BEGIN_NS + 100_800_000
    assert not handed(relay, 100.799)
    (one,) = handed(relay, 100.8)
    assert (one.dst, one.payload, one.due_ns) == (2, b"hello", BEGIN_NS + 100_800_000)


def test_without_a_delay_it_leaves_at_once_and_only_to_neighbours() -> None:
    relay = Relay(config(), BEGIN_NS)
    relay.take(message(2, b"x", 3.2))
    assert [one.dst for one in handed(relay, 3.2)] == [1, 3]
    relay.take(message(1, b"y", 4.0))
    assert [one.dst for one in handed(relay, 4.0)] == [2]


def test_two_hearers_share_the_radio_of_a_sender() -> None:
    """1000 bytes at 80 kbit/s take 100 ms to each, and the second waits for the first."""
    radio = Condition(rate_bit_s=80_000)
    relay = Relay(replace(config(Condition(delay_ns=5_000_000)), radios={2: radio}), BEGIN_NS)
    relay.take(message(2, bytes(1000)))
    relay.take(message(1, bytes(1000)))
    due = [((one.due_ns - BEGIN_NS) / 1e6, one.message.src, one.dst) for one in handed(relay, 1e4)]
    assert due == [(5.0, 1, 2), (105.0, 2, 1), (205.0, 2, 3)]


def test_a_reply_goes_to_who_asked_and_nowhere_without_a_link() -> None:
    relay = Relay(config(), BEGIN_NS)
    relay.take(message(2, b"x", 1.0, to=3))
    assert [one.dst for one in handed(relay, 1.0)] == [3]
    relay.take(message(1, b"x", 2.0, to=3))
    assert not handed(relay, 2.0)
    assert relay.entered[2, 1] == (0, 0)


def test_the_header_counts_for_the_rate_and_is_not_handed_over() -> None:
    slow = Condition(rate_bit_s=8000)  # a byte per millisecond
    relay = Relay(config(slow), BEGIN_NS, header=20)
    relay.take(message(1, b"0123456789"))
    (one,) = handed(relay, 30.0)
    assert (one.due_ns - BEGIN_NS, one.payload) == (30_000_000, b"0123456789")
    (fate,) = relay.report(1000)
    assert (fate.size, fate.key, fate.kind) == (30, "a/b", PUT)


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        (NetFault("f", 0, 100, "mute", vehicles=(1,)), Cause.MUTE),
        (NetFault("f", 0, 100, "deaf", vehicles=(2,)), Cause.DEAF),
        (NetFault("f", 0, 100, "partition", links=((1, 2),)), Cause.PARTITION),
        (NetFault("f", 0, 100, "link", links=((1, 2),), condition=Condition(up=False)), Cause.DOWN),
    ],
)
def test_faults_act_while_they_last(fault: NetFault, cause: Cause) -> None:
    relay = Relay(config(Condition(), 1, fault), BEGIN_NS)
    assert not relay.passes((1, 2), BEGIN_NS + 99 * TICK_NS)
    assert relay.passes((1, 2), BEGIN_NS + 100 * TICK_NS)
    relay.take(message(1, b"x", 99.0))
    assert not handed(relay, 99.0)
    relay.take(message(1, b"y", 100.0))
    assert [one.payload for one in handed(relay, 100.0)] == [b"y"]
    assert [fate.cause for fate in relay.report(200)] == [cause, Cause.DELIVERED]


def test_what_is_late_is_reported_late_and_in_order() -> None:
    """A host that was busy for 50 ms: the record says when it left, and the delay that the link has."""
    relay = Relay(config(Condition(delay_ns=10_000_000)), BEGIN_NS)
    relay.take(message(1, b"x", 1.0))
    assert not relay.report(40)
    handed(relay, 60.0)
    (fate,) = relay.report(100)
    assert (fate.sent_tick, fate.due_tick, fate.final_tick, fate.delay_ns) == (1, 60, 60, 10_000_000)


# --- in water


def water(fragments: bool = False) -> Relay:
    relay = Relay(config(water=True), BEGIN_NS, header=10, fragments=fragments)
    relay.places.update(PLACES)
    return relay


def test_sound_takes_its_time_and_reaches_neighbours() -> None:
    relay = water()
    relay.take(message(2, b"0123456789", 5.0))
    found = handed(relay, 60_000.0)
    assert sorted(one.dst for one in found) == [1, 3]
    # 20 bytes at 800 bit/s behind 100 ms of preamble, and 150 m at 1500 m/s; the back-off comes before.
    assert all(one.due_ns - BEGIN_NS >= 400_000_000 for one in found)
    fates = relay.report(10_000)
    assert {fate.size for fate in fates} == {20}
    assert {fate.cause for fate in fates} == {Cause.DELIVERED}


def test_what_is_longer_than_a_packet_is_refused_or_cut() -> None:
    long = bytes(range(150))
    relay = water()
    relay.take(message(1, long))
    assert not handed(relay, 60_000.0)
    assert [fate.cause for fate in relay.report(10_000)] == [Cause.MTU]
    relay = water(fragments=True)
    relay.take(message(1, long))
    (one,) = handed(relay, 60_000.0)
    assert one.payload == long
    fates = relay.report(10_000)
    assert [fate.size for fate in fates] == [60, 60, 60]


def test_a_message_in_fragments_needs_all_of_them() -> None:
    relay = water(fragments=True)
    relay.take(message(1, bytes(150)))
    handed(relay, 60_000.0)
    _, second, _ = relay.report(10_000)
    relay = water(fragments=True)
    start = second.delay_ns // (10 * TICK_NS) - 80
    relay.faults = (NetFault("f", start, start + 2, "partition", links=((1, 2),)),)
    relay.take(message(1, bytes(150)))
    assert not handed(relay, 60_000.0)
    causes = Counter(fate.cause for fate in relay.report(10_000))
    assert causes == {Cause.DELIVERED: 2, Cause.PARTITION: 1}


def test_a_reply_in_water_is_heard_by_all_and_taken_by_who_asked() -> None:
    relay = water()
    relay.take(message(2, b"x", 0.0, to=3))
    assert [one.dst for one in handed(relay, 60_000.0)] == [3]
    assert {fate.dst for fate in relay.report(10_000)} == {1, 3}


def test_what_waits_in_a_modem_at_the_end_is_in_flight() -> None:
    relay = water()
    for _ in range(5):
        relay.take(message(1, b"x"))
    handed(relay, 300)
    fates = relay.close(31)
    assert {fate.cause for fate in fates} <= {Cause.DELIVERED, Cause.IN_FLIGHT}
    assert len(fates) == relay.entered[1, 2][0] == 5


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("healed", [30, None])
def test_what_is_held_comes_when_the_fault_is_over_or_healed(reverse: bool, healed: int | None) -> None:
    """In the order of sending or the last one first; the relay says when to come back for it."""
    values = (1.0,) if reverse else ()
    relay = Relay(config(PERFECT, 1, NetFault("f", 0, 50, "hold", ((1, 2),), values=values)), BEGIN_NS)
    for at_ms in (0, 0.2, 7):
        relay.take(message(1, b"%g" % at_ms, at_ms))
    assert relay.due_ns() == BEGIN_NS + 50 * TICK_NS
    assert handed(relay, 20) == []
    if healed is not None:
        relay.faults = (NetFault("f", 0, healed, "hold", ((1, 2),), values=values),)
    end = healed or 50
    assert relay.due_ns() == BEGIN_NS + end * TICK_NS
    came = handed(relay, end)
    sent = [b"0", b"0.2", b"7"]
    assert [one.payload for one in came] == (sent[::-1] if reverse else sent)
    assert {one.due_ns for one in came} == {BEGIN_NS + end * TICK_NS}
    assert relay.due_ns() is None


def test_what_is_still_held_at_the_end_is_in_flight() -> None:
    relay = Relay(config(PERFECT, 1, NetFault("f", 0, None, "hold", ((1, 2),))), BEGIN_NS)
    relay.take(message(1, b"x"))
    assert relay.due_ns() is None
    assert [fate.cause for fate in relay.close(100)] == [Cause.IN_FLIGHT]
    assert relay.close(200) == []


# --- what is lost because of a receiver, and what is kept


@given(
    st.lists(st.tuples(st.integers(1, 3), st.sampled_from(["takes", "refuses", "keeps"])), max_size=8),
    st.booleans(),
)
def test_delivered_is_what_was_handed_over(sent: list[tuple[int, str]], in_water: bool) -> None:
    """What a receiver does not take is lost at it, and what it keeps waiting up to the end is in flight."""
    relay = water() if in_water else Relay(config(), BEGIN_NS)
    expected: Counter[str] = Counter()
    for number, (src, _) in enumerate(sent):
        relay.take(message(src, bytes([number]), number * 3000.0))
    for due in relay.due_messages(BEGIN_NS + 10**11):
        does = sent[due.payload[0]][1]
        if does != "keeps":
            relay.settle(due, BEGIN_NS + 10**11, delivered=does == "takes")
        expected[{"takes": Cause.DELIVERED, "refuses": Cause.RECEIVER, "keeps": Cause.IN_FLIGHT}[does]] += 1
    fates = relay.report(10**9) + relay.close(10**10)
    assert Counter(fate.cause for fate in fates if fate.cause in expected) == expected
    assert Counter((fate.src, fate.dst) for fate in fates) == Counter(
        {link: packets + copies for link, (packets, copies) in relay.entered.items() if packets}
    )


@given(st.lists(st.tuples(st.integers(1, 3), st.booleans(), st.booleans()), max_size=12), st.booleans())
def test_what_found_no_room_before_the_relay_is_lost_there(sent: list[tuple[int, bool, bool]], in_water: bool) -> None:
    """In each link that it would have entered, with its size and a number of its own, beside those that came."""
    relay = water() if in_water else Relay(config(), BEGIN_NS, header=10)
    expected: Counter[Link] = Counter()
    for number, (src, fits, reply) in enumerate(sent):
        one = message(src, b"abc", number * 3000.0, to=2 if reply and src != 2 else None)
        if fits:
            relay.take(one)
            continue
        relay.refuse(structs.replace(one, payload=b""), 3)
        expected.update(link for link in LINKS if link[0] == src and (in_water or one.to in (None, link[1])))
    handed(relay, 40_000)
    fates = relay.report(10**9) + relay.close(10**10)
    lost = Cause.QUEUE, 13, "a/b"
    refused = Counter((fate.src, fate.dst) for fate in fates if (fate.cause, fate.size, fate.key) == lost)
    assert refused == expected
    left = Counter((fate.src, fate.dst) for fate in fates)
    assert left == Counter({link: packets for link, (packets, _) in relay.entered.items() if packets})
    assert len({(fate.src, fate.dst, fate.seq) for fate in fates}) == len(fates)


@pytest.mark.parametrize("held", [False, True])
def test_bytes_under_way_in_a_link_are_bounded(held: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(netem.relay, "LINK_UNDER_WAY", LINK_UNDER_WAY._replace(bytes=1000))
    faults = [NetFault("f", 0, 2000, "hold", LINKS)] if held else []
    relay = Relay(config(Condition(delay_ns=10**9), 1, *faults), BEGIN_NS)
    for size in (2000, 10, 10):  # the first is alone, and passes
        relay.take(message(1, bytes(size)))
    assert [len(one.payload) for one in handed(relay, 2000)] == [2000]
    for _ in range(12):
        relay.take(message(1, bytes(100), 2000))
    assert len(handed(relay, 4000)) == 10
    assert relay.full == {(1, 2)}
    causes = Counter(fate.cause for fate in relay.report(10**6))
    assert causes == {Cause.DELIVERED: 11, Cause.QUEUE: 4}


@pytest.mark.parametrize(("length", "parts"), [(700_000, 14_000), (2_000, 40)])
def test_a_long_message_in_water_replaces_its_own_beginning(length: int, parts: int) -> None:
    """It ended the relay: the beginning had been forgotten while it was in the modem."""
    relay = water(fragments=True)
    relay.take(message(1, bytes(length)))
    handed(relay, 100)
    fates = relay.report(10**6) + relay.close(10**7)
    assert len(fates) == parts
    assert Counter(fate.cause for fate in fates)[Cause.REPLACED] == parts - 20


@given(st.lists(st.tuples(st.integers(1, 3), st.sampled_from([1, 50, 51, 400])), max_size=30), st.booleans())
def test_messages_whose_fate_is_final_are_forgotten(sent: list[tuple[int, int]], fragments: bool) -> None:
    relay = water(fragments)
    for number, (src, size) in enumerate(sent):
        relay.take(message(src, bytes(size), number * 100.0))
        handed(relay, number * 100.0)
    handed(relay, 20_000)
    relay.take(message(1, b"x", 20_000))
    handed(relay, 20_010)
    assert len(relay._out.named) == 1
    assert not sum(relay._out.sizes.values())
