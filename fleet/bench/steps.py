"""Single steps: what one agent, one vehicle and one tick of the log cost."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

from fleet.bench.agent_step import agent_steps
from fleet.bench.localization_step import localization_steps
from fleet.bench.navigation_step import navigation_steps
from fleet.execution.clock import GrantPolicy
from fleet.execution.in_process import InProcess
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile
from fleet.recorder.writer import LogWriter
from fleet.scenario.loading import load_scenario
from netem.private_folder import PrivateFolder
from netem.wire.codec import decode, encode
from netem.wire.messages import Command, Nav
from world.sea import World

AHEAD = (1.0, 0.0, 0.0)  # N, N m


def steps(repeats: int) -> dict[str, float]:
    """Median microseconds by step."""
    nav = Nav(0, 1, (-1.0, -10.0, 1.0, 0.1, 0.1), (0.7, 0.05, 0.02, 0.01, 0.01))
    size = load_scenario("paper").layout(1).size
    # Undisturbed and straight ahead: an open-loop vehicle in rough sea ends up vertical.
    world = World(load_scenario("paper").world_config)
    command = Command(0, 0, (1.0, 2.0, 3.0), (0.5,) * size)
    return {
        **agent_steps(max(60, repeats)),
        "world advance, one vehicle": median(_cost(lambda: world.advance(1, (1.0, 0.0, 0.0))) for _ in range(repeats)),
        **navigation_steps(max(2, repeats // 20)),
        **localization_steps(max(10, repeats)),
        "nav encode and decode": median(_cost(lambda: decode(encode(nav))) for _ in range(repeats)),
        "command encode and decode": median(_cost(lambda: decode(encode(command))) for _ in range(repeats)),
        "journal and log, one tick of 4 vehicles": _log_tick(repeats),
    }


def _log_tick(ticks: int) -> float:
    """CPU time of recording alone: the same frames once more, into another log."""
    scenario = load_scenario("paper", [f"duration={max(100, ticks) * 10} ms"])

    class JournalWithMemory(Journal):
        """A journal that keeps what it was given."""

        def frame(self, frame):  # type: ignore[no-untyped-def]
            taken.append((Journal.frame, frame))
            super().frame(frame)

        def links(self, report):  # type: ignore[no-untyped-def]
            taken.append((Journal.links, report))
            super().links(report)

    taken: list[tuple[Callable[..., None], object]] = []
    with PrivateFolder("bench") as folder:
        files = [LogFile(folder / name) for name in ("a.mcap", "b.mcap")]
        logs = [LogWriter(file, scenario) for file in files]
        first = JournalWithMemory(scenario, logs[0])
        clock = GrantPolicy(scenario.ticks, scenario.tick_ns, scenario.round_ticks, 1)
        InProcess(scenario, first).serve(clock, lambda: None)
        second = Journal(scenario, logs[1])
        began = time.process_time()
        for take, message in taken:
            take(second, message)
        cost = (time.process_time() - began) / scenario.ticks * 1e6
        for file in files:
            file.close()
    return cost


def _cost(call: Callable[[], object]) -> float:
    began = time.perf_counter()
    call()
    return (time.perf_counter() - began) * 1e6
