"""Clocks of vehicles: what they show, and when modems with such clocks start."""

from __future__ import annotations

from hypothesis import example, given
from hypothesis import strategies as st

from netem.config import NetemConfig
from netem.faults import NetFault
from netem.medium_access import Access
from netem.modem import AcousticConfig, Modem
from netem.network import Netem
from netem.station import Station
from netem.vehicle_clock import Clocks, VehicleClock

TICK_NS = 10_000_000
ROUND = 100
MODEM = Modem(800.0, 0.0, 25e3, 4e3, 190.0, 0.0, 3000.0, 6000.0, 64, 6.0, 10.0, 10.0)  # a byte lasts a tick
TDMA = AcousticConfig(MODEM, "tdma", slot_ticks=25, guard_ns=50_000_000)
PLACES = {1: (0.0, 0.0, 0.0), 2: (0.0, 0.0, 0.0), 3: (0.0, 0.0, 0.0)}

drifts = st.floats(-0.1, 0.1, allow_subnormal=False)
clocks = st.builds(VehicleClock, st.integers(-(10**10), 10**10), drifts)


def clock_fault(begin: int, end: int | None, step_s: float, drift: float, *vehicles: int) -> NetFault:
    return NetFault(f"f{begin}", begin, end, "clock", vehicles=vehicles, values=(step_s, drift))


clock_faults = st.builds(
    lambda begin, lasts, step, drift: clock_fault(begin, None if lasts is None else begin + lasts, step, drift, 1),
    st.integers(0, 500), st.none() | st.integers(1, 500), st.integers(-1000, 1000).map(lambda ms: ms / 1e3), drifts,
)  # fmt: skip


def of(clock: VehicleClock, *faults: NetFault) -> Clocks:
    return Clocks({1: clock}, faults, TICK_NS)


@given(clocks, st.lists(clock_faults, max_size=3), st.integers(0, 2000))
def test_a_clock_is_ahead_by_what_it_gains_tick_by_tick(clock: VehicleClock, faults: list[NetFault], tick: int) -> None:
    """The closed formula is the sum of the drift that holds in each tick, the offset and the steps that last."""
    gained = sum(clock.drift + sum(f.values[1] for f in faults if f.active(k)) for k in range(tick)) * TICK_NS
    steps = sum(f.values[0] for f in faults if f.active(tick)) * 1e9
    found = of(clock, *faults)
    assert abs(found.ahead_ns(1, tick) - clock.offset_ns - gained - steps) < 10
    assert found.reading_ns(1, tick) == max(0, tick * TICK_NS + found.ahead_ns(1, tick))
    assert found.ahead_ns(2, tick) == 0


def test_clocks_that_are_all_right_need_not_be_looked_at() -> None:
    mute = NetFault("f", 0, None, "mute", vehicles=(1,))
    assert Clocks.that_differ({}, (mute,), TICK_NS) is None
    assert Clocks.that_differ({}, (clock_fault(5, 9, 1.0, 0.0),), TICK_NS) is not None
    assert Clocks.that_differ({2: VehicleClock()}, (), TICK_NS) is not None


@given(clocks, st.lists(clock_faults, max_size=2), st.integers(0, 5), st.integers(0, 400), st.sampled_from([1, 2, 3]))
@example(VehicleClock(-(10**10), -0.1), [], 0, 0, 3)
def test_a_slot_starts_when_the_own_clock_says_so(
    clock: VehicleClock, faults: list[NetFault], number: int, later: int, src: int
) -> None:
    """The start is the first tick at which the clock, as it goes at the round tick, shows the next own slot or more.
    Who has a right clock starts where it always did."""
    access = Access(NetemConfig(1, TICK_NS, ROUND, (1, 2, 3), ()), TDMA)
    plain = access.next_start(Station(src), number * ROUND + later)
    found = Clocks(dict.fromkeys((1, 2, 3), clock), [clock_fault(f.begin, f.end, *f.values) for f in faults], TICK_NS)
    tick, earliest = number * ROUND, number * ROUND + later
    access.begin_round(tick, found)
    start = access.next_start(Station(src), earliest)
    ahead, drift = found.ahead_ns(src, tick), found.drift(src, tick)

    def shows(at: int) -> float:
        return at * TICK_NS + ahead + drift * (at - tick) * TICK_NS

    first, turn = (src - 1) * 25 * TICK_NS, 75 * TICK_NS
    slots = max(0.0, (shows(earliest) - first) // turn + ((shows(earliest) - first) % turn > 0))
    slot = first + slots * turn
    assert start >= earliest
    assert shows(start) >= slot - 2
    assert start == earliest or shows(start - 1) < slot + 2
    access.begin_round(tick, Clocks({}, [clock_fault(10**6, None, 1.0, 0.0)], TICK_NS))
    assert access.next_start(Station(src), earliest) == plain


@given(st.integers(-60, 60), st.integers(-60, 60), st.booleans())
def test_slots_collide_only_if_clocks_differ_by_more_than_the_guard(one: int, other: int, stepped: bool) -> None:
    """Slots of 250 ms, 200 ms of them on the air: who is ahead of the slot before by more than 50 ms comes into it."""
    ahead = {1: one, 2: other, 3: 0}
    own = {i: VehicleClock(0 if stepped else ms * 1_000_000) for i, ms in ahead.items()}
    faults = tuple(clock_fault(0, None, ms / 1e3, 0.0, i) for i, ms in ahead.items() if stepped)
    links = tuple((j, i) for j in (1, 2, 3) for i in (1, 2, 3) if i != j)
    netem = Netem(NetemConfig(1, TICK_NS, ROUND, (1, 2, 3), links, faults=faults, acoustic=TDMA, clocks=own))
    fates = [
        fate
        for k in range(4)
        for fate in netem.exchange(ROUND * k, dict.fromkeys(PLACES, (bytes(20),) * (k < 3)), PLACES).fates
    ]
    # A start is late by less than a tick, so the difference counts in whole ones.
    ticks = {i: -(-(10**6 - ms) // 10) for i, ms in ahead.items()}
    differ = max(ticks[1] - ticks[2], ticks[2] - ticks[3], ticks[3] - ticks[1])
    assert (len({f.cause for f in fates} & {"collision", "half duplex"}) > 0) == (differ > 5)


def test_what_is_sent_is_stamped_by_the_clock_of_its_sender() -> None:
    """The network itself goes on in simulated time: so do fates."""
    links = ((1, 2), (2, 1))
    own = {1: VehicleClock(70_000_000), 2: VehicleClock(-(10**9))}
    set_for_a_round = clock_fault(ROUND, 2 * ROUND, 1.0, 0.0, 1)
    netem = Netem(NetemConfig(1, TICK_NS, ROUND, (1, 2), links, faults=(set_for_a_round,), clocks=own))
    stamps = []
    for k in range(4):
        out = netem.exchange(ROUND * k, {1: (b"a",), 2: (b"b",)})
        stamps.append((out.inboxes[2][0].sent_tick, out.inboxes[1][0].sent_tick))
        assert {fate.sent_tick for fate in out.fates} <= {ROUND * (k - 1)}
    assert stamps == [(7, 0), (207, 0), (207, 100), (307, 200)]
