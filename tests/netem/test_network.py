"""Laws of the network core: ledgers balance, draws do not depend on each other, latency is what the page says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import sqrt

import pytest
from any_condition import conditions as any_conditions
from any_condition import link_states, link_traces
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import astuple
from samples import samples

from netem.cause import Cause
from netem.condition import Condition, Link
from netem.config import NetemConfig
from netem.draws import normal, uniform
from netem.errors import OutOfPlace
from netem.faults import NetFault
from netem.ledger import Ledger
from netem.link_states import LinkStates
from netem.link_trace import LinkTrace
from netem.network import Netem
from netem.rounds import Rounds
from netem.wire.codec import decode, encode
from netem.wire.messages import Fate, LinkReport, Round, Transmission
from netem.wire.parts import split

TICK_NS = 10_000_000
ALL_LINKS: tuple[Link, ...] = tuple((j, i) for j in (1, 2, 3) for i in (1, 2, 3) if i != j)

plain = st.builds(
    Condition,
    delay_ns=st.integers(0, 300_000_000),
    jitter_ns=st.integers(0, 100_000_000),
    loss=st.sampled_from([0.0, 0.3, 1.0]),
    up=st.sampled_from([True, True, True, False]),
)
# And whatever else the grammar can say, with delays short enough for packets to arrive in a test.
conditions = plain | any_conditions().map(
    lambda c: replace(c, delay_ns=c.delay_ns % 300_000_000, jitter_ns=c.jitter_ns % 100_000_000)
)
per_plain_link = st.dictionaries(st.sampled_from(ALL_LINKS), plain)
# What a link may be: in one condition, or in several one after the other.
Given = Condition | LinkStates | LinkTrace
kinds = conditions | link_states(conditions) | link_traces(conditions)
per_link = st.dictionaries(st.sampled_from(ALL_LINKS), kinds)
rounds_of_traffic = st.lists(
    st.dictionaries(st.sampled_from([1, 2, 3]), st.lists(st.binary(max_size=8), max_size=3).map(tuple)), max_size=12
)


def config(
    per_link: Mapping[Link, Given],
    links: tuple[Link, ...] = ALL_LINKS,
    seed: int = 1,
    vehicles: tuple[int, ...] = (1, 2, 3),
) -> NetemConfig:
    given = {link: what for link, what in per_link.items() if link in links}
    still = {link: what for link, what in given.items() if isinstance(what, Condition)}
    changing = {link: what for link, what in given.items() if not isinstance(what, Condition)}
    return NetemConfig(seed, TICK_NS, 10, vehicles, links, still, changing=changing)


def play(netem: Netem, traffic: list[dict[int, tuple[bytes, ...]]], first: int = 0) -> list[Fate]:
    """All fates of some rounds, without the closing ones."""
    fates: list[Fate] = []
    for number, sent in enumerate(traffic, start=first):
        fates += netem.exchange(10 * number, {i: sent.get(i, ()) for i in (1, 2, 3)}).fates
    return fates


@given(per_link, rounds_of_traffic)
def test_ledger_balances_for_any_traffic(per_link: dict[Link, Given], traffic: list) -> None:
    """sent = delivered + lost + in flight on every link, whatever the conditions, and each fate is told once."""
    netem = Netem(config(per_link))
    fates = [*play(netem, traffic), *netem.close(10 * len(traffic))]
    ledger = Ledger(ALL_LINKS)
    ledger.settle(fates)
    for link, (sent, duplicated) in netem.entered.items():
        ledger.enter(link, sent=sent, duplicated=duplicated)
    assert not ledger.unbalanced_links()
    assert len({(f.src, f.dst, f.seq, f.copy) for f in fates}) == len(fates)


@given(per_plain_link, rounds_of_traffic)
def test_due_tick_is_the_delay_rounded_up_and_at_least_one_tick(per_link: dict[Link, Condition], traffic: list) -> None:
    netem = Netem(config(per_link))
    for fate in [*play(netem, traffic), *netem.close(10 * len(traffic))]:
        assert fate.due_tick == max(fate.sent_tick + 1, fate.sent_tick + -(-fate.delay_ns // TICK_NS))
        condition = per_link.get((fate.src, fate.dst), Condition())
        if fate.cause in ("delivered", "in flight"):
            low = max(0, condition.delay_ns - condition.jitter_ns)
            assert low <= fate.delay_ns <= condition.delay_ns + condition.jitter_ns


@given(per_link, rounds_of_traffic)
def test_inboxes_hold_exactly_what_is_delivered_in_order(per_link: dict[Link, Given], traffic: list) -> None:
    netem = Netem(config(per_link))
    delivered, told = [], []
    for number, sent in enumerate(traffic):
        tick = 10 * number
        outcome = netem.exchange(tick, {i: sent.get(i, ()) for i in (1, 2, 3)})
        told += outcome.fates
        for i, inbox in outcome.inboxes.items():
            assert list(inbox) == sorted(inbox, key=lambda d: astuple(d)[:5])
            assert all(tick < d.due_tick <= tick + 10 for d in inbox)
            delivered += [(d.src, i, d.seq, d.due_tick, d.payload) for d in inbox]
    end = 10 * len(traffic)
    told += netem.close(end)
    reached = [(f.src, f.dst, f.seq, f.due_tick, f.payload) for f in told if f.cause == "delivered"]
    assert sorted(reached) == sorted(d for d in delivered if d[3] < end)


@given(per_link, kinds, rounds_of_traffic)
def test_a_link_never_shifts_the_draws_of_another(per_link: dict[Link, Given], changed: Given, traffic: list) -> None:
    """Changing link 1->2, or taking it away, leaves every fate on every other link as it was."""

    def others(per_link: dict[Link, Given], links: tuple[Link, ...]) -> list[Fate]:
        netem = Netem(config(per_link, links))
        fates = [*play(netem, traffic), *netem.close(10 * len(traffic))]
        return [f for f in fates if (f.src, f.dst) != (1, 2)]

    before = others(per_link, ALL_LINKS)
    assert others({**per_link, (1, 2): changed}, ALL_LINKS) == before
    assert others(per_link, tuple(link for link in ALL_LINKS if link != (1, 2))) == before


radios = st.builds(
    Condition,
    rate_bit_s=st.sampled_from([100, 8_000, 10**6]),
    rate_overhead=st.integers(0, 8),
    limit=st.sampled_from([1, 5, 1000]),
)
per_radio = st.dictionaries(st.sampled_from([1, 2, 3]), radios)


@given(per_radio, rounds_of_traffic)
def test_a_radio_sends_one_packet_after_the_other_on_all_its_links(per_radio: dict, traffic: list) -> None:
    """By the equation of a single server: a packet leaves its size over the rate after it came, or after the one
    before has left, to whichever neighbour. Beyond the limit it is lost."""
    netem = Netem(replace(config({}), radios=per_radio))
    found = {(f.src, f.dst, f.seq): (f.cause, f.delay_ns) for f in [*play(netem, traffic), *netem.close(10**6)]}
    expected: dict[tuple[int, int, int], tuple[object, int]] = {}
    for i in (1, 2, 3):
        leave, numbers = list[int](), dict.fromkeys((1, 2, 3), 0)
        for number, sent in enumerate(traffic):
            now = 10 * number * TICK_NS
            for payload in sent.get(i, ()):
                for dst in sorted({1, 2, 3} - {i}):
                    cause, delay_ns, radio = None, 0, per_radio.get(i)
                    if radio is not None and sum(at > now for at in leave) >= radio.limit:
                        cause = Cause.QUEUE
                    elif radio is not None:
                        takes = -(-(len(payload) + radio.rate_overhead) * 8 * 10**9 // radio.rate_bit_s)
                        leave.append(max([now, *leave]) + takes)
                        delay_ns = leave[-1] - now
                    expected[i, dst, numbers[dst]] = cause, delay_ns
                    numbers[dst] += 1
    arrived = (Cause.DELIVERED, Cause.IN_FLIGHT)
    assert {key: (None if cause in arrived else cause, delay) for key, (cause, delay) in found.items()} == expected


@given(per_link, per_radio.map(lambda given: {i: replace(radio, limit=10**6) for i, radio in given.items()}))
def test_a_radio_shifts_no_draw(per_link: dict[Link, Given], per_radio: dict) -> None:
    """Of links whose condition draws alone decides: a packet that a link loses is the same one with any radio."""
    still = {link: what for link, what in per_link.items() if isinstance(what, Condition)}
    still = {link: replace(c, rate_bit_s=0, limit=10**6, reorder=0.0) for link, c in still.items()}

    def lost(radios: dict) -> set:
        netem = Netem(replace(config(still), radios=radios))
        fates = [*play(netem, [{1: (b"abc", b"d"), 2: (b"ef",), 3: (b"g",)}] * 4), *netem.close(10**6)]
        return {(f.src, f.dst, f.seq, f.copy, f.corrupted) for f in fates if f.cause == Cause.LOSS or f.corrupted}

    assert lost(per_radio) == lost({})


def test_loss_and_jitter_have_the_distribution_they_promise() -> None:
    """Against closed forms, three standard errors: Bernoulli 30 %, uniform 150..250 ms with variance w^2/12."""
    netem = Netem(config({(1, 2): Condition(200_000_000, 50_000_000, 0.3, limit=10**6)}, ((1, 2),)))
    n = samples(20_000)
    fates = [*netem.exchange(0, {1: (b"",) * n, 2: (), 3: ()}).fates, *netem.close(10)]
    lost = sum(f.cause == "loss" for f in fates)
    assert abs(lost / n - 0.3) < 3 * sqrt(0.3 * 0.7 / n)
    delays = [f.delay_ns for f in fates if f.cause != "loss"]
    mean = sum(delays) / len(delays)
    assert abs(mean - 200e6) < 3 * 100e6 / sqrt(12 * len(delays))
    deviation = sqrt(sum((d - mean) ** 2 for d in delays) / len(delays))
    assert abs(deviation / (100e6 / sqrt(12)) - 1) < 0.02


def test_draws_are_uniform_and_normal_and_pure() -> None:
    n = 20_000
    u = [uniform(7, "test", k) for k in range(n)]
    assert abs(sum(u) / n - 0.5) < 3 / sqrt(12 * n)
    assert all(0.0 <= x < 1.0 for x in u)
    z = [normal(7, "test", k) for k in range(n)]
    assert abs(sum(z) / n) < 3 / sqrt(n)
    assert abs(sum(x * x for x in z) / n - 1) < 3 * sqrt(2 / n)
    assert u[17] == uniform(7, "test", 17)
    assert (
        len({uniform(7, "test", 1, 2), uniform(7, "test", 2, 1), uniform(7, "other", 1, 2), uniform(8, "test", 1, 2)})
        == 4
    )


def test_a_cut_link_loses_everything_and_says_so() -> None:
    netem = Netem(config({(1, 2): Condition(up=False)}))
    fates = play(netem, [{1: (b"a",)}, {}])
    assert {(f.dst, f.cause) for f in fates} == {(2, "down"), (3, "delivered")}


def test_ideal_network_delivers_in_the_sending_tick() -> None:
    netem = Netem(NetemConfig(1, TICK_NS, 1, (1, 2), ((1, 2),), {}, ideal=True))
    outcome = netem.exchange(5, {1: (b"now",), 2: ()})
    assert [(d.due_tick, d.payload) for d in outcome.inboxes[2]] == [(5, b"now")]
    assert [(f.final_tick, f.cause) for f in outcome.fates] == [(5, "delivered")]


def send(rounds: Rounds, i: int, tick: int, incarnation: int = 0) -> None:
    rounds.transmission(i, Transmission(incarnation, tick, ()))


def test_a_round_waits_for_exactly_the_living() -> None:
    """Netem exchanges when the world has said who lives and those have sent; who is not alive is not waited for."""
    rounds = Rounds(config({}))
    send(rounds, 1, 0)
    send(rounds, 2, 0)
    assert rounds.exchange() is None
    rounds.round(Round(0, (1, 2, 3), ((0.0, 0.0, 0.0),) * 3, ()))
    assert rounds.exchange() is None
    assert rounds.missing == [3]
    send(rounds, 3, 0)
    outcome = rounds.exchange()
    assert outcome is not None
    assert [i for i, _ in outcome[0]] == [1, 2, 3]
    assert outcome[0][0][1].until == 10
    rounds.round(Round(10, (1, 3), ((0.0, 0.0, 0.0),) * 2, ()))
    send(rounds, 1, 10)
    send(rounds, 3, 10)
    later = rounds.exchange()
    assert later is not None
    assert [i for i, _ in later[0]] == [1, 3]


@pytest.mark.parametrize(
    ("i", "tick", "incarnation", "what"),
    [(1, 5, 0, "round tick"), (1, 20, 0, "round tick"), (1, 0, 1, "incarnation"), (2, 0, 0, "round tick")],
)
def test_transmissions_out_of_place_are_refused(i: int, tick: int, incarnation: int, what: str) -> None:
    rounds = Rounds(config({}))
    send(rounds, 2, 0)
    with pytest.raises(OutOfPlace, match=what):
        send(rounds, i, tick, incarnation)
    assert rounds.missing == [1, 3]


@given(st.lists(st.integers(1, 50), max_size=40), st.integers(1, 120))
def test_split_keeps_everything_and_no_part_is_too_long(sizes: list[int], limit: int) -> None:
    parts = list(split(sizes, lambda size: size, limit))
    assert [size for part, _ in parts for size in part] == sizes
    assert [more for _, more in parts] == [True] * (len(parts) - 1) + [False]
    assert all(sum(part) <= limit or len(part) == 1 for part, _ in parts)


@given(per_link, rounds_of_traffic)
def test_another_vehicle_shifts_no_draw(per_link: dict[Link, Given], traffic: list) -> None:
    """A fourth vehicle that talks to and hears everybody leaves every fate among the others as it was."""
    alone = Netem(config(per_link))
    before = [*play(alone, traffic), *alone.close(10 * len(traffic))]
    more = tuple((4, i) for i in (1, 2, 3)) + tuple((i, 4) for i in (1, 2, 3))
    lossy = dict.fromkeys(more, Condition(150_000_000, 100_000_000, 0.5))
    joined = Netem(config({**per_link, **lossy}, ALL_LINKS + more, vehicles=(1, 2, 3, 4)))
    after: list[Fate] = []
    for number, sent in enumerate(traffic):
        after += joined.exchange(10 * number, {4: (b"me too",) * 2, **{i: sent.get(i, ()) for i in (1, 2, 3)}}).fates
    after += joined.close(10 * len(traffic))
    assert [f for f in after if 4 not in (f.src, f.dst)] == before


@given(st.permutations([*((i, tick) for i in (1, 2, 3) for tick in (0, 10)), ("round", 0), ("round", 10)]))
def test_the_order_of_arrival_changes_no_round(arrivals: list) -> None:
    """The transmissions of a round and the world's word on it in any order: the same inboxes, the same reports."""

    def outcomes(arrivals: list) -> list:
        rounds = Rounds(config({(1, 2): Condition(50_000_000, 40_000_000, 0.3)}))
        found = []
        for who, tick in arrivals:
            if who == "round":
                rounds.round(Round(tick, (1, 2, 3), ((0.0, 0.0, 0.0),) * 3, ()))
            else:
                rounds.transmission(who, Transmission(0, tick, (b"%d at %d" % (who, tick),)))
            while (outcome := rounds.exchange()) is not None:
                found.append(outcome)
        return found

    # Nobody gets to round 10 without the inbox of round 0, so what belongs to it comes later.
    ordered = sorted(arrivals, key=lambda a: a[1])
    expected = outcomes([(1, 0), (2, 0), (3, 0), ("round", 0), (1, 10), (2, 10), (3, 10), ("round", 10)])
    assert outcomes(ordered) == expected
    assert len(expected) == 2


# --- packets that a fault holds, or brings once more


@given(st.integers(0, 3), st.integers(1, 5), st.booleans())
def test_what_is_sent_while_it_lasts_is_held_until_its_end(begin: int, rounds: int, reverse: bool) -> None:
    """All of it comes at the end, in the order of sending or the last one first; what is sent then comes behind it."""
    m, end = 10, 10 * (begin + rounds)
    fault = NetFault("f", 10 * begin, end, "hold", ((1, 2),), values=(1.0,) if reverse else ())
    netem = Netem(replace(config({(1, 2): Condition(delay_ns=TICK_NS)}), round_ticks=m, faults=(fault,)))
    came = []
    for k in range(0, 300, m):
        sent = {i: (b"x",) if i == 1 and k <= end else () for i in (1, 2, 3)}
        came += [(d.due_tick, d.sent_tick) for d in netem.exchange(k, sent).inboxes[2]]
    held = list(range(10 * begin, end, m))
    free = [(k + 1, k) for k in range(0, 10 * begin, m)]
    assert came == [*free, *((end + 1, k) for k in (reversed(held) if reverse else held)), (end + 1, end)]


def test_a_fault_without_an_end_holds_for_good() -> None:
    fault = NetFault("f", 0, None, "hold", ((1, 2),))
    netem = Netem(replace(config({}), faults=(fault,)))
    netem.exchange(0, {1: (b"x",), 2: (), 3: ()})
    assert [(fate.dst, fate.cause) for fate in netem.close(1000)] == [(3, Cause.DELIVERED), (2, Cause.IN_FLIGHT)]


@pytest.mark.parametrize("tick_ns", [10_000_000, 100_000_000, 10_000_000_000])
@pytest.mark.parametrize("values", [(), (1.0,)])
def test_a_hold_without_an_end_fits_into_a_message_whatever_a_tick_is(tick_ns: int, values: tuple[float, ...]) -> None:
    """A tick of 100 ms is the default of moored scenarios."""
    fault = NetFault("f", 0, None, "hold", ((1, 2),), values=values)
    netem = Netem(replace(config({}), tick_ns=tick_ns, faults=(fault,)))
    netem.exchange(0, {1: (b"x",), 2: (), 3: ()})
    (held,) = [fate for fate in netem.close(1000) if fate.cause == Cause.IN_FLIGHT]
    report = LinkReport(1000, True, False, (held,))
    assert decode(encode(report)) == report


@pytest.mark.parametrize("end", [None, 200])
def test_what_is_held_comes_when_the_fault_is_healed(end: int | None) -> None:
    fault = NetFault("f", 0, end, "hold", ((1, 2),))
    netem = Netem(replace(config({(1, 2): Condition(delay_ns=TICK_NS)}), round_ticks=10, faults=(fault,)))
    came = []
    for k in range(0, 100, 10):
        if k == 50:
            netem.faults = (NetFault("f", 0, 50, "hold", ((1, 2),)),)
        came += [d.sent_tick for d in netem.exchange(k, {1: (b"x",) if k < 50 else (), 2: (), 3: ()}).inboxes[2]]
    assert came == [0, 10, 20, 30, 40]


@given(st.integers(1, 99), st.booleans(), st.booleans())
def test_a_hold_that_is_healed_is_one_that_ends_then(end: int, reverse: bool, planned: bool) -> None:
    """Also within a round: the record of a run has the end, and who heals it tells nobody before."""
    values = (1.0,) if reverse else ()
    link = Condition(delay_ns=TICK_NS, duplicate=0.3)
    of = replace(config({(1, 2): link}), round_ticks=10)
    ends = NetFault("f", 3, end, "hold", ((1, 2),), values=values)
    later = NetFault("f", 3, 200 if planned else None, "hold", ((1, 2),), values=values)
    outcomes = []
    for before in (ends, later):
        netem = Netem(replace(of, faults=(before,)))
        found = []
        for k in range(0, 150, 10):
            if k >= end:
                netem.faults = (ends,)
            found.append(netem.exchange(k, {1: (b"x",), 2: (), 3: ()}))
        outcomes.append((found, netem.close(150)))
    assert outcomes[0] == outcomes[1]


@given(st.integers(1, 50), st.sampled_from([0.0, 1.0]))
def test_a_copy_comes_so_much_later_and_is_in_the_ledger(later: int, loss: float) -> None:
    """What is lost on its way has no copy."""
    fault = NetFault("f", 0, 5, "duplicate", ((1, 2),), ticks=later)
    condition = Condition(delay_ns=3 * TICK_NS, loss=loss)
    netem = Netem(replace(config({(1, 2): condition}, ((1, 2),)), faults=(fault,)))
    fates = play(netem, [{1: (b"x",)}, {1: (b"y",)}, *[{}] * 6])
    assert [(f.sent_tick, f.copy, f.due_tick) for f in fates if f.cause == Cause.DELIVERED] == (
        [] if loss else sorted([(0, 0, 3), (0, 1, 3 + later), (10, 0, 13)], key=lambda one: one[2])
    )
    assert netem.entered[1, 2] == (2, 0 if loss else 1)
