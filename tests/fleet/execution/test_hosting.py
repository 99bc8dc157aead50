"""Who shares a process."""

from __future__ import annotations

from pathlib import Path

import pytest

from fleet.errors import FleetError
from fleet.execution import hosting as module
from fleet.execution.hosting import Hosting, hosting
from fleet.execution.options import Options
from fleet.execution.rendezvous import Rendezvous
from fleet.scenario.loading import load_scenario
from netem.clock import Clock

OTHER_ROUTER = Options(Path(), rendezvous=Rendezvous(router="tcp/127.0.0.1:1"))
OWN_LAW = "per_vehicle={1-60: {agent: {law: 'fleet.protocols.average:NaiveAverage'}}}"


def members(*overrides: str, options: Options | None = None) -> list[list[int]]:
    scenario = load_scenario("paper", ["checks={}", *overrides])
    return [[group[0], group[-1]] for group in hosting(scenario, options or Options()).members]


@pytest.mark.parametrize(
    ("overrides", "options", "expected"),
    [
        (["vehicles=50"], Options(), []),
        (["vehicles=100"], Options(), [[1, 25], [26, 50], [51, 75], [76, 100]]),
        (["vehicles=52"], Options(), [[1, 13], [14, 26], [27, 39], [40, 52]]),  # one for each processor, twice
        (["vehicles=100"], Options(clock=Clock.REAL), []),
        (["vehicles=100"], OTHER_ROUTER, []),
        (["vehicles=4", "agents.per_process=3"], Options(), [[1, 2], [3, 4]]),
        (["vehicles=4", "agents.per_process=3", "per_vehicle={1: {external: true}}"], Options(), [[2, 4]]),
        (["vehicles=4", "agents.per_process=1"], Options(), []),
        (["vehicles=100", OWN_LAW], Options(), [[61, 70], [71, 80], [81, 90], [91, 100]]),
        (["vehicles=100", "agents.per_process=100", OWN_LAW], Options(), [[1, 100]]),
    ],
)
def test_who_shares_a_process(
    overrides: list[str], options: Options, expected: list[list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Agents with laws of the user share a process only when it is asked for."""
    monkeypatch.setattr(module, "processors", lambda: 2)
    assert members(*overrides, options=options) == expected


def test_a_router_that_is_there_has_no_logins_for_hosts() -> None:
    with pytest.raises(FleetError, match=r"agents\.per_process: 2: a router that is there already"):
        members("agents.per_process=2", options=OTHER_ROUTER)


def test_roles() -> None:
    shared = Hosting(((1, 2), (4,)))
    assert [shared.role(i) for i in (1, 2, 3, 4)] == ["host-1", "host-1", "agent-3", "host-2"]
    assert shared.role(1, 1) == "agent-1"
    assert [shared.agents(role) for role in ("host-1", "agent-2", "world")] == [(1, 2), (2,), ()]
