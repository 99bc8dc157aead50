"""The network on a wall clock: what is sent late enters late, and what it measures."""

from __future__ import annotations

from queue import Empty
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nowhere import Nowhere, serve
from realtime import PERIOD_NS, SHORT

from fleet.scenario.loading import load_scenario
from netem.errors import OutOfPlace
from netem.histogram import Histogram
from netem.realtime_process import RealtimeNetemProcess
from netem.realtime_rounds import RealtimeRounds
from netem.wire.codec import decode, encode
from netem.wire.control import request
from netem.wire.keys import Keys
from netem.wire.mailbox import Item
from netem.wire.messages import Arrival, Delivery, LinkReport, Pace, Receipt, Round, Transmission

KEYS = Keys("5ea")


@given(st.lists(st.integers(-5, 10**10), min_size=1, max_size=200), st.sampled_from([50, 95, 99]))
def test_percentiles_are_those_of_numpy_to_the_width_of_a_bucket(values: list[int], percent: int) -> None:
    spread = Histogram()
    for value in values:
        spread.add(value)
    exact = max(0.0, float(np.percentile(values, percent, method="inverted_cdf")))
    found = spread.percentile_ns(percent)
    assert exact <= max(found, 1000)
    assert found <= max(1000, exact * 1.13)
    shown = spread.to_values()
    assert sum(n for _, n in shown["histogram_ms"]) + shown["negative"] == shown["count"] == len(values)


def network() -> RealtimeRounds:
    rounds = RealtimeRounds(load_scenario("paper", ["checks={}", "network.links={'*': 'delay 25ms'}"]).netem_config)
    rounds.round(Round(0, (1, 2, 3, 4), ((0.0,) * 3,) * 4, ()))
    return rounds


def advance(rounds: RealtimeRounds, until: int) -> dict[int, list[tuple[int, Delivery]]]:
    """Exchange up to a tick; what each vehicle got, and when it was handed out."""
    got: dict[int, list[tuple[int, Delivery]]] = {}
    while rounds.tick < until:
        tick = rounds.tick
        if tick % 10 == 0:
            rounds.round(Round(tick, (1, 2, 3, 4), ((0.0,) * 3,) * 4, ()))
        inboxes, report = rounds.exchange(0)
        assert (report is not None) == (tick % 10 == 0)
        for i, inbox in inboxes:
            got.setdefault(i, []).extend((tick, d) for d in inbox.deliveries)
    return got


class Quiet(Nowhere):
    """A queue to which nothing comes any more."""

    def get(self, timeout: float | None = None) -> Any:
        if timeout is not None and not self.queue:
            raise Empty
        return super().get(timeout)


def test_a_network_that_is_late_exchanges_nothing_after_the_end() -> None:
    """The end may be among what a tick that is overdue still takes in, and in front of the last of it."""
    config, bus, items = SHORT.netem_config, Nowhere(), Quiet()
    network = RealtimeNetemProcess(bus, KEYS, config, RealtimeRounds(config))  # type: ignore[arg-type]
    network._mailbox.queue = items  # type: ignore[assignment]
    items.queue.append(Item(KEYS.round, encode(Pace(0, 0, 1000)), None))
    answers: list[bytes] = []
    items.queue.append(Item(KEYS.ctl("netem"), request("close", tick=10), answers.append))
    items.queue.append(Item(KEYS.round, encode(Round(0, (1, 2, 3, 4), ((0.0,) * 3,) * 4, ())), None))
    serve(network)
    assert msgpack.unpackb(answers[0])["counts"]["received"] == {"round": 1}
    reports = [report for key, data in bus.put if key == KEYS.links and isinstance(report := decode(data), LinkReport)]
    assert [(report.until, report.closing) for report in reports] == [(10, True)]


@pytest.mark.parametrize("late", [0, 4])
def test_what_is_sent_late_enters_late_and_takes_as_long(late: int) -> None:
    """Handed out a tick before it is due, and due by the link's delay after it came."""
    rounds = network()
    advance(rounds, late)
    rounds.transmission(1, Transmission(0, 0, (b"state",)))
    got = advance(rounds, 9)
    assert [(tick, d.sent_tick, d.due_tick) for tick, d in got[2]] == [(late + 2, late, late + 3)]
    assert rounds.late == {1: int(late > 0), 2: 0, 3: 0, 4: 0}


def test_the_network_measures_what_receipts_say() -> None:
    rounds = network()
    rounds.transmission(1, Transmission(0, 0, (b"state",)))
    advance(rounds, 9)
    rounds.receipt(2, Receipt(0, 4, (Arrival(1, 0, 0, 2_000_000),)), lambda tick: tick * PERIOD_NS)
    found = rounds.timing()
    assert found["overdue"] == 1  # due at 3, used at 4
    assert found["links"]["1->2"]["injected"]["max_ms"] == 30.0  # 25 ms, rounded up to ticks
    assert found["links"]["1->2"]["measured"]["max_ms"] == 40.0
    assert (found["hop"]["max_ms"], found["margin"]["max_ms"]) == (2.0, 28.0)
    with pytest.raises(OutOfPlace, match="1->2 number 0"):
        rounds.receipt(2, Receipt(0, 5, (Arrival(1, 0, 0, 0),)), lambda tick: 0)


@pytest.mark.parametrize("tick", [5, 1000, 0])
def test_the_network_refuses_what_is_no_next_transmission(tick: int) -> None:
    rounds = network()
    rounds.transmission(1, Transmission(0, 0, ()))
    with pytest.raises(OutOfPlace, match="round tick"):
        rounds.transmission(1, Transmission(0, tick, ()))


def test_the_network_waits_for_the_world_but_not_for_agents() -> None:
    rounds = network()
    advance(rounds, 10)
    assert not rounds.known  # where everyone is at tick 10 has not been said
