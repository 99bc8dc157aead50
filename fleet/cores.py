"""Whether the cores of world, agents and netem are compiled; the bytes of a run are the same either way."""

from __future__ import annotations

from importlib.util import find_spec

_CORE = "world.dynamics"  # one of them: all are compiled, or none


def cores() -> str:
    """`compiled`, or `plain Python`."""
    spec = find_spec(_CORE)
    return "plain Python" if spec is None or (spec.origin or "").endswith(".py") else "compiled"
