"""The network core alone: packets per second of CPU time, and its share of a whole run."""

from __future__ import annotations

import time

from fleet.execution.clock import GrantPolicy
from fleet.execution.in_process import InProcess
from fleet.recorder.journal import Journal
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from netem.config import NetemConfig
from netem.network import Netem
from netem.wire.messages import Fate

AGENTS = 100
SHARE_AT = 20
SHARE_GOAL = 0.10
SHARE = f"share of a run, N = {SHARE_AT}"
# Everything the grammar has but a second loss model.
CONDITION = (
    "delay 80ms 30ms 25% distribution normal loss gemodel 1% 10% duplicate 1% 10% corrupt 1% 10% "
    "reorder 5% 25% gap 3 rate 100kbit 20 limit 100"
)
_PAYLOAD = b"x" * 63


def netem_figures(*, quick: bool) -> dict[str, float]:
    """Packets per second of CPU time through `Netem.exchange`, and the share of an in-process run that it takes."""
    rounds = 5 if quick else 100
    return {
        "vehicles": AGENTS,
        "perfect, packets/s": packets_per_second("", rounds),
        "full grammar, packets/s": packets_per_second(CONDITION, rounds),
        SHARE: share_of_a_run(0.5 if quick else 10.0),
    }


def scenario(vehicles: int, condition: str, seconds: float) -> Scenario:
    """The paper's fleet, each vehicle hearing four others."""
    links = "{}" if not condition else f'{{"*": {condition}}}'
    graph = "graph={shape: nearest, count: 4}"
    return load_scenario(
        "paper", [f"vehicles={vehicles}", graph, f"duration={seconds} s", f"network.links={links}", "checks={}"]
    )


def packets_per_second(condition: str, rounds: int) -> float:
    """How many packets one core takes, impairs and hands out in a second of CPU time."""
    config = scenario(AGENTS, condition, 10.0).netem_config
    return rounds * len(config.links) / _exchanges_s(config, rounds)


def _exchanges_s(config: NetemConfig, rounds: int) -> float:
    """CPU time [s] of this number of rounds in which every agent sends."""
    netem = Netem(config)
    payloads = dict.fromkeys(config.vehicles, (_PAYLOAD,))
    began = time.process_time()
    for k in range(rounds):
        netem.exchange(k * config.round_ticks, payloads)
    return time.process_time() - began


def share_of_a_run(seconds: float) -> float:
    """CPU time of a run's rounds in the network core alone, by that of the whole run in one process, without a log."""
    run = scenario(SHARE_AT, CONDITION, seconds)

    class Nowhere:
        """A log that keeps nothing."""

        def frame(self, *_: object) -> None: ...
        def packet(self, _: Fate) -> None: ...
        def event(self, _: object) -> None: ...
        def snapshot(self, _: object) -> None: ...

    began = time.process_time()
    InProcess(run, Journal(run, Nowhere())).serve(GrantPolicy.of(run), lambda: None)
    whole_s = time.process_time() - began
    return _exchanges_s(run.netem_config, run.ticks // run.round_ticks) / whole_s
