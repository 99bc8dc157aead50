"""Networks with every mechanism in them carry packets as they did: all fates and ranges, against stored ones.

Laws of single modules stand in the other tests. This one notices a changed constant or comparison anywhere between
them. `WRITE_NETEM=1 pytest tests/netem/test_netem_golden.py` writes them anew, after a change that is meant.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from math import cos, sin
from typing import Any
from zlib import crc32

import pytest
from repository import ROOT

from fleet.scenario.loading import parse_scenario
from netem.network import Netem
from netem.wire.messages import Fate

GOLDEN = ROOT / "tests" / "expected" / "netem.json"
HEAD = """\
title: A network with everything in it
vehicles: 5
duration: 300 s
reference: {start: 0 0 20 m, velocity: 0.7 0.1 0.02 m/s}
formation: {shape: grid, spacing: 8 m}
graph: {shape: complete, reference: all}
initial: {scatter: 1 m, surge: 0.7 m/s, around: reference}
profile: hardened
network:
"""
LINKS = """\
  period: 200 ms
  links:
    "*": delay 300ms 200ms 30% distribution normal loss gemodel 2% 20% 70% 10% duplicate 10% 20% corrupt 10% 30%
    1->2: delay 1s 300ms distribution pareto reorder 30% 20% gap 3 loss state 10% 60% 20% 30% 5%
    2->1: delay 500ms 100ms distribution paretonormal rate 2kbit 5 limit 3 loss 20% 50%
    1<->3:
      trace: "time [s],delivered,delay [ms],rate [bit/s]\\n0,1,300,800\\n5,0,,\\n9,1,700,400\\n12,1,20,9000"
      loop: true
      offset: random
    3->4: {trace: "time [s],snr [dB],delay [ms]\\n0,9,300\\n5,3,40\\n9,7,70", lost_below: 4 dB, by: packet, loop: true}
    4<->5:
      states:
        good: {condition: delay 50ms loss 2%, mean: 3 s, next: {fair: 60 %, bad: 40 %}}
        fair: {condition: delay 200ms 50ms loss 20%, mean: 1 s}
        bad: {condition: loss 80% delay 400ms rate 2kbit, mean: 1.5 s}
      together: true
    2<->4: {states: {up: {mean: 2 s}, down: {condition: down, mean: 1 s}}}
"""
FAULTS = """\
faults:
  - {at: 10 s, for: 5 s, partition: "1,2 / 3-5"}
  - {at: 18 s, for: 4 s, link: {1<->4: loss 50% delay 2s}}
  - {at: 25 s, for: 3 s, mute: 2}
  - {at: 30 s, for: 6 s, kill: 3}
  - {at: 12 s, for: 30 s, clock: {vehicles: 1-2, step: 3 s, drift: 900 ppm}}
"""
WATER = "  period: 2 s\n"
CASES = {
    "links": LINKS + FAULTS,
    "aloha": WATER + """\
  acoustic: {modem: s2c, mac: aloha, backoff: 600 ms, buffer: 2, source_level: 150 dB, shipping: 1, wind: 15 m/s,
    fading: {shadowing: 3 dB, correlation: 10 s, packets: rician 3 dB},
    tries: 3, acknowledgement: 4 bytes, timeout: 3 s}
""" + FAULTS,
    "csma": WATER + """\
  acoustic: {modem: s2c, mac: csma, buffer: 1, source_level: 142 dB, spreading: 1.7, modems: {2-3: fsk-80},
    water: {temperature: 8 degC, depth: 60 m}, fading: {packets: rayleigh}, captured: "0 dB 10 %, 6 dB 90 %",
    delivery: "300 m 95 %, 600 m 40 %"}
""" + FAULTS,
    "one-way": WATER + """\
  links: {"*": loss 5%, 1->2: delay 200ms, 2->1: duplicate 50%}
  acoustic: {modem: s2c, mac: tdma, slot: 1.5 s, guard: 500 ms,
    ranging: {method: one-way, noise: 0.5 m, outliers: {probability: 20 %, excess: 20 m}}}
""" + FAULTS,
    "two-way": WATER + """\
  links: {"*": loss 5%, 1->2: delay 200ms, 2->1: duplicate 50%}
  acoustic: {modem: s2c, mac: tdma, slot: 4 s, buffer: 3, wind: 25 m/s, source_level: 155 dB,
    ranging: {method: two-way, noise: 0.5 m, request: 12 bytes, turn: 600 ms}}
""" + FAULTS,
}  # fmt: skip


def carried(text: str) -> dict[str, dict[str, Any]]:
    """What became of the packets of each link, between vehicles 100 to 700 m apart that each go in a circle."""
    config = parse_scenario(HEAD + text, "network.yaml").netem_config
    netem, fates, end = Netem(config), list[Fate](), 300 * config.round_ticks
    for tick in range(0, end, config.round_ticks):
        alive = [i for i in config.vehicles if i != 3 or not 3000 <= tick < 3600]
        places = {i: (150.0 * i + 90.0 * cos(0.001 * i * tick), 80.0 * sin(0.002 * tick + i), 10.0 * i) for i in alive}
        sent = {
            i: tuple(bytes([i, tick % 251] * (5 + 4 * n)) for n in range(1 + (tick // config.round_ticks) % 2))
            for i in alive
        }
        fates += netem.exchange(tick, sent, places).fates
    fates += netem.close(end)
    return {f"{src}->{dst}": of_link([f for f in fates if (f.src, f.dst) == (src, dst)]) for src, dst in config.links}


def of_link(fates: list[Fate]) -> dict[str, Any]:
    ranges = [f.measured for f in fates if f.measured is not None]
    order = b"".join(f"{f.final_tick} {f.seq} {f.copy} {f.sent_tick} {f.due_tick} {f.cause}".encode() for f in fates)
    return {
        "causes": dict(sorted(Counter(str(f.cause) for f in fates).items())),
        "copies": sum(f.copy for f in fates),
        "delay_ns": sum(f.delay_ns for f in fates),
        "ticks": [sum(f.due_tick for f in fates), sum(f.final_tick for f in fates)],
        "order": crc32(order),
        "payloads": crc32(b"".join(f.payload for f in fates)),
        "range_m": round(sum(r.range_m for r in ranges), 6),
        "distance_m": round(sum(r.distance_m for r in ranges), 6),
        "range_ticks": sum(r.tick for r in ranges),
    }


@pytest.mark.parametrize("name", CASES)
def test_it_carries_as_it_did(name: str) -> None:
    ours = carried(CASES[name])
    golden: dict[str, Any] = json.loads(GOLDEN.read_text("utf-8")) if GOLDEN.exists() else {}
    if os.environ.get("WRITE_NETEM"):
        golden[name] = ours
        GOLDEN.write_text(json.dumps(golden, separators=(",", ":")).replace("},", "},\n") + "\n", "utf-8")
    assert ours == golden[name]
