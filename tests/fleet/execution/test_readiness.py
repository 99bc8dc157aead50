"""Who is ready, from canned answers of world and netem."""

from __future__ import annotations

from typing import Any

import pytest

from fleet.execution.console import readiness

VEHICLES = range(1, 4)
ALL = {"ready": [[1, 0], [2, 0], [3, 0]], "grant": True}
NETEM = {"round": True}


@pytest.mark.parametrize(
    ("world", "network", "awaited", "silent", "missing", "only_external"),
    [
        (ALL, NETEM, [], set(), "", False),
        ({}, {}, [], {"frame", "links"}, "agents 1, 2, 3", False),
        (ALL | {"ready": [[2, 0]]}, NETEM, [], set(), "agents 1, 3", False),
        (ALL, {}, [], set(), "netem", False),
        (ALL, NETEM, [], {"links", "frame"}, "frame, links", False),
        (ALL | {"grant": False}, NETEM, [], set(), "the clock's key", False),
        # An agent that the world heard, but whose token is not there, has not joined.
        (ALL, NETEM, [3], set(), "agents 3", True),
        (ALL | {"ready": [[1, 0]]}, NETEM, [3], set(), "agents 2, 3", False),
        (ALL, {}, [3], set(), "agents 3", False),
    ],
)
def test_who_is_missing(
    world: dict[str, Any], network: dict[str, Any], awaited: list[int], silent: set[str], missing: str,
    only_external: bool,
) -> None:  # fmt: skip
    state = readiness(world, network, VEHICLES, awaited, silent)
    assert (state.missing, state.only_external) == (missing, only_external)


def test_a_silent_key_is_not_waited_for_as_if_an_agent_were_to_join() -> None:
    """Or a run whose middleware loses every greeting would wait for the join timeout, and then name nobody."""
    assert not readiness(ALL, NETEM, VEHICLES, [], {"frame"}).only_external


def test_a_large_fleet_is_counted() -> None:
    assert readiness({"grant": True}, NETEM, range(1, 31), [], set()).missing == "30 agents"
