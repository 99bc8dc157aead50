"""Measured ranges: what a packet says of the distance to its sender, and what that costs."""

from __future__ import annotations

from dataclasses import replace
from math import dist, sqrt

import msgpack
import pytest

from netem.config import NetemConfig
from netem.modem import AcousticConfig, Modem, RangingConfig
from netem.network import Netem
from netem.vehicle_clock import VehicleClock
from netem.wire.codec import decode, encode
from netem.wire.messages import Delivery, Inbox, LinkReport

TICK_NS = 10_000_000
ROUND = 100  # ticks: one second
# A byte is 10 ms: payloads of n bytes are on the air for n ticks. Sound travels 15 m in a tick. Everyone talks at once.
AT_ONCE = AcousticConfig(Modem(800.0, 0.0, 25e3, 4e3, 190.0, 0.0, 3000.0, 6000.0, 64, 6.0, 10.0, 10.0), buffer=2)
ALL = tuple((j, i) for j in (1, 2, 3) for i in (1, 2, 3) if i != j)
CLOSE = {1: (0.0, 0.0, 0.0), 2: (15.0, 0.0, 0.0), 3: (0.0, 30.0, 0.0)}
TWO = {1: CLOSE[1], 2: CLOSE[2]}
ONE_WAY = RangingConfig(noise=0.5)
TWO_WAY = RangingConfig("two-way", noise=0.5, request=1, turn_ns=100_000_000)


def network(
    ranging: RangingConfig | None, seed: int = 1, vehicles: int = 3, clocks: dict[int, VehicleClock] | None = None
) -> Netem:
    acoustic = replace(AT_ONCE, ranging=ranging)
    links = tuple(link for link in ALL if max(link) <= vehicles)
    numbers = tuple(range(1, vehicles + 1))
    return Netem(NetemConfig(seed, TICK_NS, ROUND, numbers, links, acoustic=acoustic, clocks=clocks or {}))


def received(netem: Netem, rounds: int, places: dict[int, tuple[float, ...]] = CLOSE) -> list[Delivery]:
    """What all vehicles get if vehicle 1 sends in every round."""
    found = []
    for k in range(rounds):
        sent = {i: (b"abcd",) if i == 1 else () for i in places}
        for inbox in netem.exchange(k * ROUND, sent, places).inboxes.values():
            found += inbox
    return found


def test_noise_has_the_standard_deviation_that_is_set_and_outliers_are_late() -> None:
    ranging = replace(ONE_WAY, outliers=0.2, excess=30.0)
    apart = dist(CLOSE[1], CLOSE[2])
    errors = [d.range_m - apart for d in received(network(ONE_WAY, vehicles=2), 1000, TWO)]  # type: ignore[operator]
    assert abs(sum(errors) / len(errors)) < 3 * 0.5 / sqrt(1000)
    assert sum(e * e for e in errors) / len(errors) == pytest.approx(0.25, rel=0.15)
    late = received(network(ranging, vehicles=2), 1000, TWO)
    excess = [d.range_m - apart - e for d, e in zip(late, errors, strict=True) if d.range_m != apart + e]  # type: ignore[operator]
    assert 160 < len(excess) < 240 and min(excess) > 0.0
    assert sum(excess) / len(excess) == pytest.approx(30.0, rel=0.25)


def test_draws_do_not_depend_on_the_order_or_on_other_vehicles() -> None:
    """The network goes through its plain values in the middle, and a fleet of two has the ranges of one of three."""
    whole = {(d.sent_tick, d.range_m) for d in received(network(ONE_WAY), 6) if d.seq < 6}
    alone = {(d.sent_tick, d.range_m) for d in received(network(ONE_WAY, vehicles=2), 6, TWO)}
    assert alone < whole


def test_one_way_ranges_have_the_error_of_the_clocks() -> None:
    """The receiver's clock is 2 ms ahead: 3 m too far. Both drift: what they drift apart in the time comes to it."""
    clocks = {2: VehicleClock(2_000_000), 1: VehicleClock(0, 100e-6)}
    quiet = RangingConfig(noise=1e-9)
    found = received(network(quiet, vehicles=2, clocks=clocks), 11, TWO)
    assert found[0].range_m == pytest.approx(15.0 + 3.0)
    assert found[10].range_m == pytest.approx(15.0 + 3.0 - 100e-6 * 10.0 * 1500.0)


def test_two_way_ranges_know_nothing_of_the_offset_and_cost_airtime() -> None:
    """Two requests and two replies of 10 ms each, so a packet comes later, and others find the channel taken."""
    clocks = {2: VehicleClock(2_000_000, 100e-6)}
    quiet = replace(TWO_WAY, noise=1e-9)
    two = received(network(quiet, clocks=clocks), 1)
    one = received(network(replace(quiet, method="one-way")), 1)
    for before, after in zip(sorted(one, key=lambda d: d.payload), sorted(two, key=lambda d: d.payload), strict=True):
        assert after.range_m == pytest.approx(before.range_m, abs=0.01)
    assert sorted(d.due_tick for d in one) == [5, 6]
    # Vehicle 2 asks at 5, is heard at 7, and answered at 9; vehicle 3 asks a turn of 10 ticks after it has the packet.
    assert sorted(d.due_tick for d in two) == [9, 22]


def test_a_packet_whose_request_is_not_heard_comes_without_a_range() -> None:
    """Vehicle 1 sends its second payload while it is asked about the first, and who asks does not hear that."""
    netem = network(TWO_WAY, vehicles=2)
    found = []
    for k in range(6):
        sent = {1: (b"abcd", bytes(40)) if k == 0 else (), 2: ()}
        found += netem.exchange(k * ROUND, sent, TWO).inboxes[2]
    assert [(len(d.payload), d.range_m) for d in found] == [(4, None)]


def test_the_wire_has_ranges_only_where_they_were_measured() -> None:
    plain = Delivery(5, 0, 1, 0, 0, b"x")
    ranged = with_range(plain)
    inbox = Inbox(0, 10, False, (plain, ranged))
    data = encode(inbox)
    assert decode(data) == inbox
    assert [len(d) for d in msgpack.unpackb(data)[4]] == [6, 9]
    netem = network(ONE_WAY)
    received(netem, 1)
    fates = netem.exchange(ROUND, dict.fromkeys(CLOSE, ()), CLOSE).fates
    report = LinkReport(ROUND, False, False, fates)
    assert decode(encode(report)) == report
    assert {len(fate) for fate in msgpack.unpackb(encode(report))[4]} == {12}
    assert all(f.measured is not None and abs(f.measured.range_m - f.measured.distance_m) < 3.0 for f in fates)


def with_range(delivery: Delivery) -> Delivery:
    return Delivery(*(getattr(delivery, name) for name in Delivery.__struct_fields__[:6]), 12.5, 0.5, 4)
