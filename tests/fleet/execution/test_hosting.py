"""Who shares a process."""

from __future__ import annotations

from typing import Any

import pytest

from fleet.errors import FleetError
from fleet.execution import hosting as module
from fleet.execution.hosting import Hosting, hosting
from fleet.execution.rendezvous import Rendezvous
from fleet.scenario.loading import load_scenario
from netem.clock import Clock

OTHER_ROUTER = Rendezvous(router="tcp/127.0.0.1:1")
OWN_LAW = "per_vehicle={1-60: {agent: {law: 'fleet.protocols.average:NaiveAverage'}}}"


def members(*overrides: str, clock: Clock = Clock.LOCKSTEP, meeting: Rendezvous | None = None) -> list[list[int]]:
    scenario = load_scenario("paper", ["checks={}", *overrides])
    return [[group[0], group[-1]] for group in hosting(scenario, clock, meeting).members]


@pytest.mark.parametrize(
    ("overrides", "how", "expected"),
    [
        (["vehicles=50"], {}, []),
        (["vehicles=100"], {}, [[1, 25], [26, 50], [51, 75], [76, 100]]),
        (["vehicles=52"], {}, [[1, 13], [14, 26], [27, 39], [40, 52]]),  # one for each processor, twice
        (["vehicles=100"], {"clock": Clock.REAL}, []),
        (["vehicles=100"], {"meeting": OTHER_ROUTER}, []),
        (["vehicles=4", "agents.per_process=3"], {}, [[1, 2], [3, 4]]),
        (["vehicles=4", "agents.per_process=3", "per_vehicle={1: {external: true}}"], {}, [[2, 4]]),
        (["vehicles=4", "agents.per_process=1"], {}, []),
        (["vehicles=100", OWN_LAW], {}, [[61, 70], [71, 80], [81, 90], [91, 100]]),
        (["vehicles=100", "agents.per_process=100", OWN_LAW], {}, [[1, 100]]),
    ],
)
def test_who_shares_a_process(
    overrides: list[str], how: dict[str, Any], expected: list[list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Agents with laws of the user share a process only when it is asked for."""
    monkeypatch.setattr(module, "processors", lambda: 2)
    assert members(*overrides, **how) == expected


def test_a_router_that_is_there_has_no_logins_for_hosts() -> None:
    with pytest.raises(FleetError, match=r"agents\.per_process: 2: a router that is there already"):
        members("agents.per_process=2", meeting=OTHER_ROUTER)


def test_roles() -> None:
    shared = Hosting(((1, 2), (4,)))
    assert [shared.role(i) for i in (1, 2, 3, 4)] == ["host-1", "host-1", "agent-3", "host-2"]
    assert shared.role(1, 1) == "agent-1"
    assert [shared.agents(role) for role in ("host-1", "agent-2", "world")] == [(1, 2), (2,), ()]
