"""The time of a vehicle's own clock, for an agent that ticks with simulated time.

A nav has the number of its sample, `tick`, which counts simulated time, and what the vehicle's clock shows. The
agent that ships takes its samples by the first and reads the time from the second. A whole agent of a user's gets a nav
whose `tick` is that of its clock, so that all it computes from it, leases, ages and stamps, follows the clock.
"""

from __future__ import annotations

from msgspec.structs import replace

from netem.wire.fields import Uint
from netem.wire.messages import Delivery, Nav


class OwnNav(Nav, frozen=True):
    """A nav by the vehicle's own clock: `tick` may repeat, leave out ticks, and go back when the clock is set."""

    sample: Uint = 0  # the tick of the nav that the world sent


def to_own_clock(nav: Nav, tick_ns: int) -> Nav:
    """The same nav with the ticks of the vehicle's clock; as it is while all clocks are right."""
    if nav.clock_ns is None:
        return nav
    tick = nav.clock_ns // tick_ns
    return OwnNav(nav.incarnation, tick, nav.eta, nav.nu, nav.roll, nav.clock_ns, nav.belief, nav.tick)


def to_simulated_time(nav: Nav) -> Nav:
    """The inverse."""
    if isinstance(nav, OwnNav):
        return Nav(nav.incarnation, nav.sample, nav.eta, nav.nu, nav.roll, nav.clock_ns, nav.belief)
    return nav


def deliveries_to_own_clock(deliveries: list[Delivery], nav: Nav) -> list[Delivery]:
    """The same deliveries, due by the clock that `nav` has been made with; they were stamped by their senders'."""
    if not isinstance(nav, OwnNav):
        return deliveries
    ahead = nav.tick - nav.sample
    return [_delivery_to_own_clock(delivery, ahead) for delivery in deliveries]


def _delivery_to_own_clock(delivery: Delivery, ahead: int) -> Delivery:
    due = max(0, delivery.due_tick + ahead)
    if delivery.range_tick is None:
        return replace(delivery, due_tick=due)
    return replace(delivery, due_tick=due, range_tick=max(0, delivery.range_tick + ahead))
