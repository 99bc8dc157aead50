"""Agents that are shown whatever comes to mind decide as they did: no vehicle answers them, so nothing is too far off.

`WRITE_AGENTS=1 pytest tests/agents/test_agents_loop.py` writes the numbers anew, after a change that is meant.
"""

from __future__ import annotations

import json
import os
from math import hypot, sin
from random import Random
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from repository import ROOT

from agents.config import AgentConfig
from agents.make_agent import make_agent
from fleet.scenario.loading import load_scenario
from netem.wire.messages import Delivery, Nav

GOLDEN = ROOT / "tests" / "expected" / "agent-loop.json"
TICKS = 300
TURN = """formation={offsets: [0 0 0 m, 0 -8 0 m, 8 -8 0 m, 8 0 2 m],
changes: [{at: 1 s, over: 2 s, offsets: [0 0 0 m, 0 -7.8 0 m, 8 -7.8 0 m, 8 0 1.8 m]}]}"""
CASES = {
    "paper": [],
    "partition-heal": ["controller=bc", "neighbours={drop_after: 300 ms, age_cap: 200 ms, extrapolate: neighbour}"],
    "lossy": [TURN, "neighbours={drop_after: 400 ms, age_cap: 150 ms, extrapolate: reference}"],
    "crossing": ["keep_apart={distance: 9 m, age_cap: 200 ms, acceleration: 1 m/s2}", "profile=consistent"],
    "rough-sea": ["controller=boc", "network.payload=compact"],
    "remus": [],
    "ideal": ["controller=bsmc"],
    "leader-lost-standby": ["graph.standby.after=300 ms"],
    "locate-naive": ["tick=100 ms", "agent.localization={method: naive, mirror: true, gate: 9}"],
    "locate-consistent": ["tick=100 ms", "agent.localization={method: consistent, mirror: true}"],
    "navigation-aid": ["tick=100 ms"],
}  # fmt: skip


def shown(configs: list[AgentConfig], draw: Random, off: bool) -> dict[str, list[float]]:
    """All telemetry, demands and messages of agents that are moved about, and hear each other late, twice or garbled.

    Args:
        configs: of the agents.
        draw: the noise, and what becomes of messages.
        off: whether clocks are.

    Returns:
        by vehicle and signal, the mean, one in the middle and the last; and the bytes that it sent.
    """
    agents = {c.id: make_agent(c) for c in configs}
    dt = configs[0].tick_ns / 1e9
    places = {i: [draw.uniform(-15.0, 15.0), draw.uniform(-15.0, 15.0), draw.uniform(5.0, 9.0)] for i in agents}
    on_the_way: dict[int, list[Delivery]] = {i: [] for i in agents}
    told: dict[int, list[list[float]]] = {i: [] for i in agents}
    sizes = dict.fromkeys(agents, 0)
    for tick in range(TICKS):
        if draw.random() < 0.02:
            continue  # samples that nobody gets
        navs = {}
        for i, place in places.items():
            u, psi = 0.7 + 0.4 * sin(0.03 * tick + i), 0.02 * tick * (1 if i % 2 else -1)
            place[0] += u * dt * sin(psi + 1.57) + draw.gauss(0.0, 0.01)
            place[1] += u * dt * sin(psi) + draw.gauss(0.0, 0.01)
            spread = 0.5 + 0.01 * tick if tick % 90 < 60 or i != 1 else 0.3
            belief = (spread, 0.1, 0.0, 0.0, 2.0 * spread, 0.0, 0.0, 0.01, 0.0, 0.02)
            nu = (u, draw.gauss(0.0, 0.1), draw.gauss(0.0, 0.1), draw.gauss(0.0, 0.1), draw.gauss(0.0, 0.1))
            eta = (place[0], place[1], place[2], draw.gauss(0.0, 0.1), psi)
            clock = tick * configs[0].tick_ns + 70_000_000 * (i - 2) if tick > 60 and off else None
            located = configs[0].localization is not None
            navs[i] = Nav(0, tick, eta, nu, (0.1, 0.02) if i == 3 else (), clock, belief if located else ())
        for i, agent in agents.items():
            due = [d for d in on_the_way[i] if d.due_tick <= tick]
            on_the_way[i] = [d for d in on_the_way[i] if d.due_tick > tick]
            step = agent.step(navs[i], due)
            told[i].append([*step.tau, *step.telemetry])
            for seq, payload in enumerate(step.payloads):
                sizes[i] += len(payload)
                for j in agents:
                    if any(n.id == i for n in configs[j - 1].neighbours):
                        away = hypot(*(a - b for a, b in zip(places[i], places[j], strict=True)))
                        on_the_way[j] += late(Delivery(0, tick, i, tick + seq, 0, payload), away, draw)
    found = {}
    for i, rows in told.items():
        table = np.nan_to_num(np.array(rows, float))
        found[str(i)] = [*table.mean(axis=0).tolist(), *table[len(table) // 2].tolist(), *table[-1].tolist(), sizes[i]]
    return found


def late(sent: Delivery, away: float, draw: Random) -> list[Delivery]:
    """The copies of a message that arrive, with the range that the receiver's modem measured."""
    if draw.random() < 0.2:
        return []
    came = replace(sent, due_tick=sent.sent_tick + draw.randint(1, 60))
    if draw.random() < 0.5:
        came = replace(came, range_m=away + draw.gauss(0.0, 1.0), range_sd_m=1.0, range_tick=sent.sent_tick)
    if draw.random() < 0.05:
        came = replace(came, payload=came.payload[:-1] + b"x")
    if draw.random() < 0.05:
        came = replace(came, src=sent.src + 1)
    return [came, replace(came, copy=1, due_tick=came.due_tick + draw.randint(0, 9))] if draw.random() < 0.1 else [came]


@pytest.mark.parametrize("name", CASES)
def test_it_decides_as_it_did(name: str) -> None:
    scenario = load_scenario(name, ["checks={}", *CASES[name]])
    configs = [scenario.agent_config(i) for i in range(1, scenario.vehicles + 1)][:4]
    ours = shown(configs, Random(1), off=name in ("rough-sea", "lossy"))
    golden: dict[str, Any] = json.loads(GOLDEN.read_text("utf-8")) if GOLDEN.exists() else {}
    if os.environ.get("WRITE_AGENTS"):
        golden[name] = {i: [float(f"{value:.7g}") for value in values] for i, values in ours.items()}
        GOLDEN.write_text(json.dumps(golden, separators=(",", ":")).replace('],"', '],\n"') + "\n", "utf-8")
    for i, values in ours.items():
        assert values == pytest.approx(golden[name][i], rel=1e-5, abs=1e-6), f"vehicle {i}"
