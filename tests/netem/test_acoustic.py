"""The acoustic channel: canned histories for every cause, and laws over random ones."""

from __future__ import annotations

from dataclasses import replace
from math import exp, log10, sqrt
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import astuple

from netem.acoustic import AcousticChannel
from netem.cause import LOSSES, Cause
from netem.condition import Condition, Link
from netem.config import NetemConfig
from netem.curve import Curve
from netem.faults import NetFault
from netem.ledger import Ledger
from netem.links import Links
from netem.modem import AcousticConfig, Modem
from netem.network import Netem, fate_order
from netem.rounds import Rounds
from netem.transit import Transit
from netem.wire.messages import Delivery, Fate, Round, Transmission

TICK_NS = 10_000_000
ROUND = 100  # ticks: one second
# A byte is 10 ms: payloads of n bytes are on the air for n ticks. Sound travels 15 m in a tick.
MODEM = Modem(800.0, 0.0, 25e3, 4e3, 190.0, 0.0, 3000.0, 6000.0, 64, 6.0, 10.0, 10.0)
# Back-offs of at most 0 ticks: everyone talks at the round tick.
AT_ONCE = AcousticConfig(MODEM)
TDMA = AcousticConfig(MODEM, "tdma", slot_ticks=25, guard_ns=50_000_000)
ALL: tuple[Link, ...] = tuple((j, i) for j in (1, 2, 3) for i in (1, 2, 3) if i != j)
CLOSE = {1: (0.0, 0.0, 0.0), 2: (15.0, 0.0, 0.0), 3: (0.0, 30.0, 0.0)}

Traffic = dict[int, tuple[bytes, ...]]
Places = dict[int, tuple[float, ...]]


def channel(
    acoustic: AcousticConfig = AT_ONCE,
    links: tuple[Link, ...] = ALL,
    conditions: dict[Link, Condition] | None = None,
    faults: tuple[NetFault, ...] = (),
    vehicles: tuple[int, ...] = (1, 2, 3),
    seed: int = 1,
) -> Netem:
    return Netem(NetemConfig(seed, TICK_NS, ROUND, vehicles, links, conditions or {}, faults, acoustic=acoustic))


def play(netem: Netem, traffic: list[Traffic], places: Places | list[Places] = CLOSE, first: int = 0) -> list[Fate]:
    """All fates of some rounds, without the closing ones."""
    fates: list[Fate] = []
    for number, sent in enumerate(traffic, start=first):
        where = places[number] if isinstance(places, list) else places
        fates += netem.exchange(ROUND * number, {i: sent.get(i, ()) for i in where}, where).fates
    return fates


def run(netem: Netem, traffic: list[Traffic], places: Places | list[Places] = CLOSE) -> list[Fate]:
    """All fates of a run that ends with the last round."""
    return [*play(netem, traffic, places), *netem.close(ROUND * len(traffic))]


def causes(fates: list[Fate]) -> dict[Link, list[str]]:
    found: dict[Link, list[str]] = {}
    for fate in sorted(fates, key=lambda f: (f.seq, f.copy)):
        found.setdefault((fate.src, fate.dst), []).append(fate.cause)
    return found


# --- canned histories ------------------------------------------------------


def test_one_payload_is_one_broadcast() -> None:
    """10 bytes last 10 ticks; 2 is a tick of sound away, 3 two ticks: each hears it in its time."""
    netem = channel()
    outcome = netem.exchange(0, {1: (b"0123456789",), 2: (), 3: ()}, CLOSE)
    assert outcome.inboxes == {
        1: (),
        2: (Delivery(11, 0, 1, 0, 0, b"0123456789"),),
        3: (Delivery(12, 0, 1, 0, 0, b"0123456789"),),
    }
    fates = netem.exchange(ROUND, {1: (), 2: (), 3: ()}, CLOSE).fates
    assert [(f.final_tick, f.dst, f.delay_ns, f.cause) for f in fates] == [
        (11, 2, 110_000_000, "delivered"),
        (12, 3, 120_000_000, "delivered"),
    ]
    assert netem.entered[1, 2] == netem.entered[1, 3] == (1, 0)


def test_preamble_and_bit_rate_make_the_airtime() -> None:
    slow = replace(MODEM, bit_rate=80.0, preamble=1.0)
    assert slow.airtime_ns(15) == 2_500_000_000
    assert slow.airtime_ns(0) == 1_000_000_000
    assert replace(MODEM, bit_rate=3.0).airtime_ns(1) == 2_666_666_667


def test_least_latency_is_one_tick() -> None:
    fast = AcousticConfig(replace(MODEM, bit_rate=1e6))
    fates = run(channel(fast), [{1: (b"a",)}, {}], {1: (0.0,) * 3, 2: (0.1, 0.0, 0.0), 3: (0.0, 0.1, 0.0)})
    assert {f.due_tick for f in fates} == {1}


def test_a_message_may_take_several_rounds() -> None:
    """64 bytes at a fifth of the rate: 3.2 s. It is delivered in the round in which it ends."""
    slow = AcousticConfig(replace(MODEM, bit_rate=160.0))
    netem = channel(slow)
    inboxes = [netem.exchange(k * ROUND, {1: (bytes(64),) if k == 0 else ()}, CLOSE).inboxes[2] for k in range(5)]
    assert [len(inbox) for inbox in inboxes] == [0, 0, 0, 1, 0]
    assert astuple(inboxes[3][0])[:3] == (321, 0, 1)


def test_mtu() -> None:
    fates = run(channel(), [{1: (bytes(65), bytes(64))}, {}])
    assert causes(fates) == {(1, 2): ["mtu", "delivered"], (1, 3): ["mtu", "delivered"]}
    assert {f.final_tick for f in fates if f.cause == "mtu"} == {0}


def test_a_slot_with_its_guard_is_an_mtu_as_well() -> None:
    """25 ticks less 5 of guard hold 20 bytes."""
    assert TDMA.longest(TICK_NS) == 20
    assert AT_ONCE.longest(TICK_NS) == 64
    assert causes(run(channel(TDMA), [{1: (bytes(21),)}, {1: (bytes(20),)}, {}]))[1, 2] == ["mtu", "delivered"]


def test_the_newest_replaces_the_one_that_waits() -> None:
    """In a round's tick the modem sends one; of three at once the last."""
    fates = run(channel(), [{1: (b"a", b"b", b"c")}, {}])
    assert causes(fates)[1, 2] == ["replaced", "replaced", "delivered"]


def test_a_replacement_keeps_the_start() -> None:
    """Vehicle 3's slot begins at tick 200 of 300: what it said at 0 gives way to what it says at 100."""
    acoustic = replace(TDMA, slot_ticks=100)
    netem = channel(acoustic)
    fates = run(netem, [{3: (b"old",)}, {3: (b"new",)}, {}, {}])
    assert [(f.cause, f.due_tick, f.sent_tick) for f in fates if f.dst == 1] == [
        ("replaced", 100, 0),
        ("delivered", 205, 100),
    ]


def test_news_never_delays_talking() -> None:
    """With a back-off of several rounds and news in each, the first start is that of the first payload."""
    acoustic = replace(AT_ONCE, backoff_ticks=1000)
    for seed in range(5):
        alone = run(channel(acoustic, seed=seed), [{1: (b"a",)}, *[{}] * 15])
        often = run(channel(acoustic, seed=seed), [{1: (b"a",)}] * 16)
        first = min(f.due_tick for f in often if f.cause == "delivered")
        assert first == min(f.due_tick for f in alone if f.cause == "delivered")


def test_a_buffer_of_two_keeps_order_and_drops_the_oldest() -> None:
    fates = run(channel(replace(AT_ONCE, buffer=2)), [{1: (b"a", b"b", b"c")}, {}])
    found = sorted((f.seq, f.cause, f.due_tick) for f in fates if f.dst == 2)
    # "b" lasts from tick 0 to 1; "c" follows at once.
    assert found == [(0, "replaced", 0), (1, "delivered", 2), (2, "delivered", 3)]


def test_a_queue_keeps_what_waits_and_refuses_what_comes() -> None:
    """Datagrams: of four at once two wait, and the others are lost; none is replaced."""
    fates = run(channel(replace(AT_ONCE, buffer=2, refuses=True)), [{1: (b"a", b"b", b"c", b"d")}, {}])
    found = sorted((f.seq, f.cause, f.due_tick) for f in fates if f.dst == 2)
    assert found == [(0, "delivered", 2), (1, "delivered", 3), (2, "queue", 0), (3, "queue", 0)]


def test_a_modem_that_talks_does_not_begin_again() -> None:
    """64 bytes at half the rate last until tick 128: what comes at tick 100 starts then."""
    acoustic = AcousticConfig(replace(MODEM, bit_rate=400.0))
    fates = run(channel(acoustic), [{1: (bytes(64),)}, {1: (b"next",)}, {}])
    assert [(f.sent_tick, f.due_tick) for f in fates if f.dst == 2] == [(0, 129), (100, 137)]


ORIGIN = (0.0, 0.0, 0.0)
ROW = {1: ORIGIN, 2: (30.0, 0.0, 0.0), 3: (60.0, 0.0, 0.0)}
HALF = AcousticConfig(replace(MODEM, bit_rate=400.0))
TO_2: dict[str, Any] = {"links": ((1, 2),)}
BOTH_TO_2: dict[str, Any] = {"links": ((1, 2), (3, 2))}
TEN: Traffic = {1: (bytes(10),), 3: (bytes(10),)}
TWENTY: Traffic = {i: (bytes(20),) for i in (1, 3, 4)}
ONE: Traffic = {1: (b"a",)}


def fault(kind: Any, *links: Link, begin: int = 0, end: int | None = 100, **more: Any) -> dict[str, Any]:
    return {"faults": (NetFault("f", begin, end, kind, links, **more),)}


def at_2(x: float) -> Places:
    """1 is 10 m from 2, and 3 so far on its other side."""
    return {1: ORIGIN, 2: (10.0, 0.0, 0.0), 3: (10.0 + x, 0.0, 0.0)}


def around(*talkers: int) -> tuple[list[Traffic], Places]:
    """Of 3 and 4 each alone is 11 dB below 1, and the two together 8 dB."""
    places = {1: ORIGIN, 2: (10.0, 0.0, 0.0), 3: (64.0, 0.0, 0.0), 4: (10.0, 54.0, 0.0)}
    return [{i: TWENTY[i] for i in talkers}], places


FOUR: dict[str, Any] = {**TO_2, "vehicles": (1, 2, 3, 4)}
LOUD: dict[str, Any] = {**TO_2, "acoustic": AcousticConfig(replace(MODEM, capture=40.0))}
NEAR_ONLY: dict[str, Any] = {**TO_2, "acoustic": AcousticConfig(replace(MODEM, interference_range=29.0))}
WELL, BOTH_WELL = {(1, 2): "delivered"}, {(1, 2): "delivered", (1, 3): "delivered"}
HISTORIES: dict[str, tuple[dict[str, Any], list[Traffic], Places, dict[Link, str]]] = {
    "only graph neighbours decode": (TO_2, [ONE], CLOSE, WELL),
    "range": ({}, [ONE, {}, {}], CLOSE | {3: (3001.0, 0.0, 0.0)}, {(1, 2): "delivered", (1, 3): "range"}),
    "all three talk": ({}, [{i: (bytes(10),) for i in (1, 2, 3)}], CLOSE, dict.fromkeys(ALL, "half duplex")),
    # 3 hears 1 from tick 2 to 12; its own word of one tick ends at 1, or at 3.
    **{f"3 talks for {n} ticks": ({"links": ((1, 3),)}, [{1: (bytes(10),), 3: (bytes(n),)}], CLOSE, {(1, 3): told})
       for n, told in ((1, "delivered"), (2, "delivered"), (3, "half duplex"))},
    "equals": (BOTH_TO_2, [TEN], ROW, {(1, 2): "collision", (3, 2): "collision"}),
    # 15 log10(10) = 15 dB louder is enough, 15 log10(4) = 9 dB is not.
    "15 dB louder": (BOTH_TO_2, [TWENTY], at_2(100.0), {(1, 2): "delivered", (3, 2): "collision"}),
    "9 dB louder": (BOTH_TO_2, [TWENTY], at_2(40.0), {(1, 2): "collision", (3, 2): "collision"}),
    "one interferer": (FOUR, *around(1, 3), WELL),
    "another": (FOUR, *around(1, 4), WELL),
    "they add up": (FOUR, *around(1, 3, 4), {(1, 2): "collision"}),
    # 1 at 2 from tick 1 to 11; 3 is heard there from tick 3 to 4, or from 13 on.
    "a part": (LOUD, [{1: (bytes(10),), 3: (b"x",)}], CLOSE | {3: (60.0, 0.0, 0.0)}, {(1, 2): "collision"}),
    "too late": (LOUD, [{1: (bytes(10),), 3: (b"x",)}], CLOSE | {3: (195.0, 0.0, 0.0)}, WELL),
    # 3 talks from tick 0 to 128; 1 begins at tick 100, while 3's message still comes in.
    "of an earlier round": ({"acoustic": HALF}, [{3: (bytes(64),)}, {1: (bytes(60),)}, {}], ROW, {
        (1, 2): "collision", (3, 2): "collision", (3, 1): "half duplex", (1, 3): "half duplex"}),
    "beyond the interference range": (NEAR_ONLY, [TEN], ROW, WELL),
    "the muted make no noise": ({**TO_2, **fault("mute", vehicles=(3,))}, [TEN], ROW, WELL),
    # A partition closes ears to words, not to noise.
    "a cut link": ({**BOTH_TO_2, **fault("partition", (3, 2), (2, 3))}, [TEN], ROW,
                   {(1, 2): "collision", (3, 2): "partition"}),
    "mute": (fault("mute", vehicles=(1,)), [ONE], CLOSE, dict.fromkeys(BOTH_WELL, "mute")),
    "mute between rounds": (fault("mute", begin=1, end=90, vehicles=(1,)), [ONE], CLOSE, BOTH_WELL),
    "partition": (fault("partition", (1, 2)), [ONE], CLOSE, BOTH_WELL | {(1, 2): "partition"}),
    "down": (fault("down", (1, 3)), [ONE], CLOSE, BOTH_WELL | {(1, 3): "down"}),
    "deaf": (fault("deaf", vehicles=(2,)), [ONE], CLOSE, BOTH_WELL | {(1, 2): "deaf"}),
    "loss": (fault("link", (1, 2), condition=Condition(loss=1.0)), [ONE], CLOSE, BOTH_WELL | {(1, 2): "loss"}),
    "a link": (fault("link", (1, 2), condition=Condition(up=False)), [ONE], CLOSE, BOTH_WELL | {(1, 2): "down"}),
}  # fmt: skip


@pytest.mark.parametrize("history", HISTORIES)
def test_who_hears_whom(history: str) -> None:
    made, traffic, places, found = HISTORIES[history]
    assert causes(run(channel(**made), [*traffic, {}], places)) == {link: [cause] for link, cause in found.items()}


def test_up_lies_over_a_link_that_is_down() -> None:
    netem = channel(**TO_2, conditions={(1, 2): Condition(up=False)}, **fault("up", (1, 2), begin=100, end=None))
    assert causes(run(netem, [ONE, {1: (b"b",)}, {}]))[1, 2] == ["down", "delivered"]


def test_noise_loses_what_the_formula_says() -> None:
    """300 words at a range where half of them drown: within three standard errors."""
    quiet = AcousticConfig(replace(MODEM, source_level=133.3, max_range=1e5), wind=5.0)
    size, distance = 10, 1000.0
    lost = quiet.packet_error_rate(distance, size)
    assert 0.1 < lost < 0.9
    places = {1: (0.0, 0.0, 0.0), 2: (distance, 0.0, 0.0)}
    n = 300
    fates = run(channel(quiet, ((1, 2),), vehicles=(1, 2)), [{1: (bytes(size),)}] * n + [{}, {}], places)
    count = sum(f.cause == "snr" for f in fates)
    assert abs(count / n - lost) < 3 * (lost * (1 - lost) / n) ** 0.5


def test_slow_agents_hand_over_late() -> None:
    slow = NetFault("f", 0, None, "slow", vehicles=(1,), ticks=130)
    fates = run(channel(faults=(slow,)), [{1: (b"a",)}, {}, {}])
    assert [(f.due_tick, f.sent_tick) for f in fates if f.dst == 2] == [(132, 0)]


def test_link_conditions_act_on_top() -> None:
    """A delay of the link comes after sound and airtime; its loss is decided at the start."""
    conditions = {(1, 2): Condition(delay_ns=50_000_000, duplicate=1.0), (1, 3): Condition(loss=1.0)}
    netem = channel(conditions=conditions)
    fates = run(netem, [{1: (bytes(10),)}, {}])
    assert [(f.copy, f.due_tick, f.cause) for f in fates if f.dst == 2] == [(0, 16, "delivered"), (1, 16, "delivered")]
    assert [(f.final_tick, f.cause) for f in fates if f.dst == 3] == [(0, "loss")]
    assert netem.entered[1, 2] == (1, 1)


def test_a_dead_sender_takes_what_waits_with_it() -> None:
    """Slots of a second: 3 was to talk from tick 200 on, and is gone at 100."""
    acoustic = replace(TDMA, slot_ticks=100)
    alive = [CLOSE, {1: CLOSE[1], 2: CLOSE[2]}, CLOSE, CLOSE]
    fates = run(channel(acoustic), [{3: (b"a",)}, {}, {}, {}], alive)
    assert causes(fates) == {(3, 1): ["dead sender"], (3, 2): ["dead sender"]}
    assert {f.final_tick for f in fates} == {100}


def test_a_dead_receiver_is_one_when_the_message_ends() -> None:
    acoustic = AcousticConfig(replace(MODEM, bit_rate=400.0))
    alive = [CLOSE, {1: CLOSE[1], 3: CLOSE[3]}, CLOSE]
    fates = run(channel(acoustic), [{1: (bytes(64),)}, {}, {}], alive)
    assert causes(fates) == {(1, 2): ["dead receiver"], (1, 3): ["delivered"]}
    # And one of whom nobody ever knew where it was.
    never = {1: CLOSE[1], 3: CLOSE[3]}
    assert causes(run(channel(), [{1: (b"a",)}, {}], never)) == {(1, 2): ["dead receiver"], (1, 3): ["delivered"]}


def test_what_waits_or_sounds_at_the_end_is_in_flight() -> None:
    acoustic = AcousticConfig(replace(MODEM, bit_rate=400.0))
    fates = run(channel(acoustic), [{1: (bytes(64), b"next")}])
    assert causes(fates)[1, 2] == ["replaced", "delivered"]
    fates = run(channel(replace(acoustic, buffer=2)), [{1: (bytes(64), b"next")}])
    assert causes(fates)[1, 2] == ["in flight", "in flight"]
    assert {f.final_tick for f in fates} == {100}


def test_positions_of_the_round_of_the_start_count() -> None:
    """2 is beyond range at tick 0 and near at 100: what starts at 0 is lost although it ends later."""
    acoustic = AcousticConfig(replace(MODEM, bit_rate=400.0))
    far = CLOSE | {2: (4000.0, 0.0, 0.0)}
    fates = run(
        channel(acoustic, ((1, 2),)), [{1: (bytes(64),)}, {}, {1: (b"b",)}, {}, {}], [far, CLOSE, CLOSE, CLOSE, CLOSE]
    )
    assert causes(fates) == {(1, 2): ["range", "delivered"]}


def test_every_cause_of_the_channel_has_its_history() -> None:
    """A cause that is declared and never tested would be one that nobody knows to work."""
    text = Path(__file__).read_text("utf-8")
    assert [cause for cause in LOSSES if cause not in ("queue", "receiver") and f'"{cause}"' not in text] == []


def test_an_acoustic_channel_needs_positions_and_a_modem() -> None:
    with pytest.raises(ValueError, match="positions"):
        channel().exchange(0, {1: ()})
    with pytest.raises(ValueError, match="modem"):
        AcousticChannel(bare := NetemConfig(1, TICK_NS, ROUND, (1, 2), ((1, 2),)), Links(bare), Transit(bare))
    with pytest.raises(ValueError, match="not ideal"):
        Netem(NetemConfig(1, TICK_NS, ROUND, (1, 2), ((1, 2),), ideal=True, acoustic=AT_ONCE))


def test_rounds_choose_the_channel() -> None:
    rounds = Rounds(NetemConfig(1, TICK_NS, ROUND, (1, 2), ((1, 2),), acoustic=AT_ONCE))
    assert isinstance(rounds.netem._medium, AcousticChannel)
    for i in (1, 2):
        rounds.transmission(i, Transmission(0, 0, (b"a",) if i == 1 else ()))
    rounds.round(Round(0, (1, 2), ((0.0, 0.0, 0.0), (15.0, 0.0, 0.0)), ()))
    outcome = rounds.exchange()
    assert outcome is not None
    assert outcome[0][1][1].deliveries == (Delivery(2, 0, 1, 0, 0, b"a"),)


# --- laws ------------------------------------------------------------------

coordinate = st.floats(-4000.0, 4000.0)
places = st.lists(
    st.fixed_dictionaries(
        {}, optional={i: st.tuples(coordinate, coordinate, st.floats(0.0, 100.0)) for i in (1, 2, 3)}
    ),
    min_size=8,
    max_size=8,
)
traffic = st.lists(
    st.dictionaries(st.sampled_from([1, 2, 3]), st.lists(st.binary(max_size=70), max_size=2).map(tuple)), max_size=8
)
vehicles_of_a_fault = st.lists(st.sampled_from([1, 2, 3]), max_size=2).map(tuple)
links_of_a_fault = st.lists(st.sampled_from(ALL), max_size=3).map(tuple)
fault_times = st.integers(0, 700)
conditions = st.dictionaries(
    st.sampled_from(ALL),
    st.builds(
        Condition,
        delay_ns=st.integers(0, 3 * 10**9),
        loss=st.sampled_from([0.0, 0.3]),
        duplicate=st.sampled_from([0.0, 0.5]),
        corrupt=st.sampled_from([0.0, 0.5]),
        up=st.sampled_from([True, True, False]),
    ),
)


@st.composite
def faults(draw: st.DrawFn, more: tuple[str, ...] = ()) -> tuple[NetFault, ...]:
    found = []
    for number in range(draw(st.integers(0, 3))):
        kind: Any = draw(st.sampled_from(["link", "down", "up", "partition", "mute", "deaf", "slow", *more]))
        begin = draw(fault_times)
        found.append(
            NetFault(
                f"f{number}",
                begin,
                begin + draw(st.integers(1, 400)),
                kind,
                draw(links_of_a_fault),
                draw(vehicles_of_a_fault),
                Condition(loss=0.5) if kind == "link" else None,
                draw(st.integers(1, 250)),
                (draw(st.floats(-2.0, 2.0)), draw(st.floats(-0.1, 0.1))) if kind == "clock" else (),
            )
        )
    return tuple(sorted(found, key=lambda f: f.begin))


channels = st.builds(
    AcousticConfig,
    st.builds(
        lambda rate, preamble, level: replace(MODEM, bit_rate=rate, preamble=preamble, source_level=level),
        st.sampled_from([80.0, 800.0, 13900.0]),
        st.sampled_from([0.0, 0.05, 1.0]),
        st.sampled_from([130.0, 150.0, 190.0]),
    ),
    st.sampled_from(["aloha", "tdma"]),
    backoff_ticks=st.sampled_from([0, 20, 500]),
    slot_ticks=st.sampled_from([25, 110, 800]),
    guard_ns=st.sampled_from([0, 50_000_000]),
    buffer=st.integers(1, 3),
)


def history(netem: Netem, sent: list[Traffic], where: list[Places], first: int = 0) -> list[Any]:
    """Whatever came out of some rounds; who is nowhere is dead and sends nothing."""
    out: list[Any] = []
    for number, payloads in enumerate(sent, start=first):
        alive = where[number]
        outcome = netem.exchange(ROUND * number, {i: payloads.get(i, ()) for i in alive}, alive)
        out.append((outcome.inboxes, outcome.fates))
    return out


@given(channels, conditions, faults(), traffic, places)
def test_ledger_balances_and_every_fate_is_told_once_in_its_round(
    acoustic: AcousticConfig,
    per_link: dict[Link, Condition],
    faults: tuple[NetFault, ...],
    sent: list[Traffic],
    where: list[Places],
) -> None:
    """sent + duplicated = delivered + lost + in flight; a fate is final in the round that tells it; inboxes agree."""
    netem = channel(acoustic, conditions=per_link, faults=faults)
    out = history(netem, sent, where)
    end = ROUND * len(sent)
    closing = netem.close(end)
    for number, (inboxes, fates) in enumerate(out):
        assert all(ROUND * (number - 1) < f.final_tick <= ROUND * number for f in fates)
        assert list(fates) == sorted(fates, key=fate_order)
        for inbox in inboxes.values():
            assert list(inbox) == sorted(inbox, key=lambda d: astuple(d)[:5])
            assert all(ROUND * number < d.due_tick <= ROUND * (number + 1) for d in inbox)
            assert all(d.sent_tick < d.due_tick for d in inbox)
    everything = [*(f for _, fates in out for f in fates), *closing]
    assert len({(f.src, f.dst, f.seq, f.copy) for f in everything}) == len(everything)
    ledger = Ledger(ALL)
    ledger.settle(everything)
    for link, (entered, duplicated) in netem.entered.items():
        ledger.enter(link, sent=entered, duplicated=duplicated)
    assert not ledger.unbalanced_links()
    reached = sorted((f.src, f.dst, f.seq, f.copy, f.due_tick) for f in everything if f.cause == "delivered")
    told = [(d.src, i, d.seq, d.copy, d.due_tick) for inboxes, _ in out for i, box in inboxes.items() for d in box]
    assert reached == sorted(d for d in told if d[4] < end)


@given(st.integers(1, 20), traffic, st.floats(0.0, 70.0), st.sampled_from([25, 60, 250]))
@settings(deadline=None)
def test_tdma_never_collides(seed: int, sent: list[Traffic], spread: float, slot: int) -> None:
    """As long as sound crosses the fleet within the guard: 75 m in 50 ms."""
    acoustic = replace(TDMA, slot_ticks=slot)
    where = {1: (0.0, 0.0, 5.0), 2: (spread, 0.0, 5.0), 3: (0.0, spread / 3.0, 0.0)}
    fates = run(channel(acoustic, seed=seed), sent, where)
    assert not {f.cause for f in fates} & {"collision", "half duplex"}


@given(st.integers(0, 2**31), traffic, st.sampled_from([0, 50, 400]))
@settings(deadline=None)
def test_aloha_is_the_same_again_and_keeps_within_its_back_off(seed: int, sent: list[Traffic], most: int) -> None:
    acoustic = replace(AT_ONCE, backoff_ticks=most)
    fates = run(channel(acoustic, seed=seed), sent)
    assert run(channel(acoustic, seed=seed), sent) == fates
    for f in fates:
        if f.cause == "delivered" and len(sent) == 1:
            assert f.due_tick <= most + len(f.payload) + 3


def test_a_quiet_vehicle_more_shifts_no_draw() -> None:
    acoustic = AcousticConfig(replace(MODEM, source_level=133.3, max_range=1e5), backoff_ticks=30)
    sent: list[Traffic] = [{1: (bytes(8),)}] * 20 + [{}]
    places = {1: (0.0, 0.0, 0.0), 2: (1000.0, 0.0, 0.0)}
    few = run(channel(acoustic, ((1, 2),), vehicles=(1, 2)), sent, places)
    many = run(channel(acoustic, ((1, 2),)), sent, places | {3: (0.0, 500.0, 0.0)})
    assert few == many
    assert {f.cause for f in few} == {"delivered", "snr"}


# --- listen before talk ----------------------------------------------------


def test_who_hears_somebody_waits_until_he_has_ended() -> None:
    """2 begins at tick 0, for 30 ticks. 1, a tick of sound away, gets its payload late, hears 2 and begins at 31."""
    csma = AcousticConfig(MODEM, "csma")
    late = NetFault("late", 0, None, "slow", vehicles=(1,), ticks=10)
    fates = run(channel(csma, faults=(late,)), [{1: (b"abc",), 2: (bytes(30),)}, {}])
    assert {(f.src, f.dst): (f.cause, f.delay_ns // TICK_NS) for f in fates} == {
        (2, 1): ("delivered", 31), (2, 3): ("delivered", 32),
        (1, 2): ("delivered", 31 + 3 + 1), (1, 3): ("delivered", 31 + 3 + 2),
    }  # fmt: skip
    rash = run(channel(AT_ONCE, faults=(late,)), [{1: (b"abc",), 2: (bytes(30),)}, {}])
    assert Cause.HALF_DUPLEX in {f.cause for f in rash}


@pytest.mark.parametrize("load", [0.3, 1.0, 3.0])
def test_csma_carries_what_the_formula_says(load: float) -> None:
    """Non-persistent CSMA: S = G exp(-a G) / (G (1 + 2 a) + exp(-a G)), Kleinrock and Tobagi 1975, for many vehicles.

    Airtimes of 20 ticks and no propagation to speak of, so that a is one tick at most: a start in the same tick is
    not heard. Thirty vehicles attempt G starts per airtime together.
    """
    n, airtime, rounds = 30, 20, 400
    backoff = round(2 * (n * airtime / load))  # attempts of one vehicle are so far apart on average
    csma = AcousticConfig(MODEM, "csma", backoff_ticks=backoff)
    links = tuple((i, i % n + 1) for i in range(1, n + 1))
    places = {i: (0.1 * i, 0.0, 0.0) for i in range(1, n + 1)}
    fates = run(
        channel(csma, links, vehicles=tuple(range(1, n + 1))), [{i: (bytes(airtime),) for i in places}] * rounds, places
    )
    carried = sum(f.cause == "delivered" for f in fates) * airtime / (ROUND * rounds)
    a = 1 / airtime
    formula = [load * exp(-x * load) / (load * (1 + 2 * x) + exp(-x * load)) for x in (a, 0.0)]
    assert 0.9 * formula[0] < carried < 1.1 * formula[1]


# --- acknowledgements ------------------------------------------------------

ARQ = AcousticConfig(replace(MODEM, tries=3, timeout=0.2, acknowledgement=2))


def test_each_neighbour_is_served_in_turn_until_it_answers() -> None:
    """10 ticks of payload, a tick of sound, 2 ticks of answer, a tick back: the next begins at tick 14."""
    fates = run(channel(ARQ), [{1: (bytes(10),)}, {}])
    assert {f.dst: (f.cause, f.delay_ns // TICK_NS) for f in fates} == {2: ("delivered", 11), 3: ("delivered", 26)}


def test_a_lost_try_is_made_again_and_a_lost_answer_delivers_nothing_twice() -> None:
    """The link from 1 to 2 is lossy; the way back from 3 is cut, so 3 gets it once and answers in vain."""
    lossy = {(1, 2): Condition(loss=0.5)}
    cut = NetFault("cut", 0, None, "down", links=((3, 1),))
    fates = run(
        channel(ARQ, conditions=lossy, faults=(cut,)), [{1: (bytes(5),)} if k % 2 == 0 else {} for k in range(80)]
    )
    found = causes(fates)
    assert found[1, 3] == ["delivered"] * 40
    assert 1 - 0.5**3 - 0.15 < found[1, 2].count("delivered") / 40 <= 1.0
    assert set(found[1, 2]) <= {"delivered", "loss", "in flight"}


def test_who_never_answers_is_given_up_with_the_cause_of_the_last_try() -> None:
    far = CLOSE | {2: (4000.0, 0.0, 0.0)}
    fates = run(channel(ARQ), [{1: (bytes(10),)}, *[{}] * 12], far)
    assert causes(fates) == {(1, 2): ["range"], (1, 3): ["delivered"]}


def test_a_run_that_ends_within_a_transfer_accounts_for_everything() -> None:
    netem = channel(replace(ARQ, buffer=3))
    fates = [*play(netem, [{1: (bytes(60), bytes(60))}, {}]), *netem.close(ROUND)]
    assert sorted((f.src, f.dst, f.seq) for f in fates) == [(1, dst, seq) for dst in (2, 3) for seq in (0, 1)]


# --- curves, fading, several modems ----------------------------------------


def test_a_curve_is_a_line_between_its_points() -> None:
    curve = Curve(((10.0, 1.0), (20.0, 0.5), (40.0, 0.0)))
    assert [curve.at(x) for x in (0.0, 10.0, 15.0, 20.0, 30.0, 50.0)] == [1.0, 1.0, 0.75, 0.5, 0.25, 0.0]


def test_delivery_follows_the_curve() -> None:
    """4,000 packets at 15 m, where the curve says 60 %: within four standard deviations."""
    measured = AcousticConfig(replace(MODEM, delivery=Curve(((10.0, 0.7), (20.0, 0.5)))))
    found = causes(run(channel(measured, links=((1, 2),)), [{1: (b"a",)}] * 4000))[1, 2]
    assert abs(found.count("delivered") / 4000 - 0.6) < 4 * sqrt(0.6 * 0.4 / 4000)
    assert set(found) == {"delivered", "snr"}


def test_capture_follows_the_curve() -> None:
    """3 is twice as far from 2 as 1 is: 4.52 dB less at a spreading of 1.5, where the curve says 25 %."""
    level = 10 * 1.5 * log10(2.0)
    capture = Curve(((0.0, 0.0), (4 * level, 1.0)))
    acoustic = AcousticConfig(replace(MODEM, captured=capture, carrier=400.0))
    places = {1: (-100.0, 0.0, 0.0), 2: (0.0, 0.0, 0.0), 3: (200.0, 0.0, 0.0)}
    found = causes(run(channel(acoustic, links=((1, 2), (3, 2))), [{1: (bytes(30),), 3: (bytes(30),)}] * 2000, places))
    assert abs(found[1, 2].count("delivered") / 2000 - 0.25) < 4 * sqrt(0.25 * 0.75 / 2000) + 0.001
    assert set(found[3, 2]) == {"collision"}


def test_each_vehicle_has_the_airtime_and_the_limits_of_its_modem() -> None:
    acoustic = AcousticConfig(
        MODEM, modems={2: replace(MODEM, bit_rate=80.0, mtu=5), 3: replace(MODEM, max_range=20.0)}
    )
    fates = run(channel(acoustic), [{1: (bytes(6),)}, {2: (bytes(6),)}, {2: (bytes(4),)}, {3: (bytes(4),)}, {}])
    assert {(f.src, f.dst, f.seq): f.cause for f in fates} == {
        (1, 2, 0): "delivered", (1, 3, 0): "delivered", (2, 1, 0): "mtu", (2, 3, 0): "mtu",
        (2, 1, 1): "delivered", (2, 3, 1): "delivered", (3, 1, 0): "range", (3, 2, 0): "range",
    }  # fmt: skip
    assert {f.delay_ns for f in fates if (f.src, f.seq) == (2, 1)} >= {410_000_000}
