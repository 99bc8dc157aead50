"""How fast policies can decide: steps per second of the paper's fleet as an environment of PettingZoo."""

from __future__ import annotations

import time
from importlib.util import find_spec

from fleet.rl.offered import parallel_env

VELOCITY, FORCE = "a velocity each round of 100 ms", "forces each tick of 10 ms"


def policy_steps(*, quick: bool) -> dict[str, float]:
    """Steps per second of CPU time, by what is decided; in a step all four decide. Empty: PettingZoo is not there."""
    if find_spec("pettingzoo") is None or find_spec("gymnasium") is None:
        return {}
    seconds = 1 if quick else 20
    return {VELOCITY: _steps_per_s("velocity", "100 ms", seconds), FORCE: _steps_per_s("force", "10 ms", seconds)}


def _steps_per_s(move: str, every: str, seconds: int) -> float:
    """With the simplest of policies, and a reward that costs nothing."""
    env = parallel_env(
        "paper",
        set={"duration": f"{seconds} s", "checks": {}},
        move="force" if move == "force" else "velocity",
        every=every,
        reward=lambda _: 0.0,
    )
    env.reset()
    actions = {
        who: {move: (0.7, 0.1, 0.0) if move == "velocity" else (10.0, 0.0, 0.0), "send": 1, "message": (0.0,) * 6}
        for who in env.agents
    }
    steps, began = 0, time.process_time()
    while env.agents:
        env.step(actions)
        steps += 1
    return steps / (time.process_time() - began)
