"""The shipped scenarios that stress the network keep their promises, and distributed gives the bytes of in-process.

All of it is slow. The quick tests have one row for each mechanism: tests/system/test_same_bytes.py.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from ranged import DYING, UNSURE
from repository import ROOT

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Status
from fleet.scenario.catalogue import list_scenarios
from fleet.scenario.loading import load_scenario

# name: how long the distributed run is [s]; what happens to a fleet there has happened by then
# (deaths, restarts, partitions and draws of other kinds: tests/system/test_same_bytes.py and test_acoustic_runs.py)
GALLERY = {
    "lossy": 5, "burst": 8, "partition-heal": 8, "kill": 7, "kill-restart": 10, "gauss-markov-current": 8,
    "nemesis": 14, "acoustic-80bps": 17, "acoustic-s2c": 10, "rough-sea": 5, "breakdown": 5, "follow-the-leader": 5,
    "leader-lost": 7, "leader-lost-standby": 7, "acoustic-noise": 17, "remus": 3, "mixed": 3, "average": 10,
    "average-naive": 5, "election": 18, "election-slow": 8,
    "event-triggered": 8, "event-triggered-loss": 3, "auction": 12, "auction-partition": 8,
    "navigation-aid": 5, "navigation-aid-clock": 5, "locate-naive": 5, "locate-naive-loop": 5,
    "locate-consistent": 7, "locate-compass": 5,
    "mirror-image": 5, "mirror-image-turn": 5, "formation-on-belief": 6, "formation-no-fixes": 6,
}  # fmt: skip
# Brought forward for it: what a fault does there does not depend on its second.
EARLY = {
    "partition-heal": ["faults.1.at=2 s", "faults.1.for=4 s"],
    "kill": ["faults.1.at=2 s"],
    "kill-restart": ["faults.1.at=2 s", "faults.1.for=5 s"],
    "gauss-markov-current": ["faults.1.at=3 s", "faults.1.gust.over=3 s"],
    "nemesis": ["nemesis.every=3 s", "nemesis.for=2 s"],
    "leader-lost": ["faults.1.at=2 s"],
    "leader-lost-standby": ["faults.1.at=2 s"],
    "average": ["faults.1.at=3 s", "faults.1.for=4 s"],
    "election": ["faults.1.at=3 s", "faults.1.for=4 s", "faults.2.at=10 s", "faults.2.for=5 s"],
    "auction": ["faults.1.at=6 s"],
    "locate-consistent": DYING,
    "locate-compass": ["faults.1.at=2 s", *UNSURE],
    "formation-no-fixes": ["faults.1.at=2 s"],
}
PAGE = ROOT / "docs" / "background" / "shipped-scenarios.md"


@pytest.mark.slow
@pytest.mark.parametrize("name", GALLERY)
def test_a_scenario_keeps_its_promise(name: str, tmp_path: Path) -> None:
    thin = load_scenario(name, ["log.every=50 ticks"])
    result = execute(thin, Options(tmp_path, in_process=True, quiet=True))
    assert result.status is Status.PASS, (result.reason, result.lines, result.checks)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seconds"), GALLERY.items())
def test_distributed_is_in_process(name: str, seconds: int, tmp_path: Path) -> None:
    scenario = load_scenario(
        name,
        [
            *(f"duration={seconds} s", "expect=pass", "log.every=5 ticks"),
            "checks={ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived}",
            *EARLY.get(name, []),
        ],
    )
    alone, fleet = (execute(scenario, Options(tmp_path, in_process=flag, quiet=True)) for flag in (True, False))
    for result in (alone, fleet):
        assert result.status is Status.PASS, (result.reason, result.lines, result.checks)
    assert (alone.directory / "run.mcap").read_bytes() == (fleet.directory / "run.mcap").read_bytes()
    assert fleet.values["deaths"] == {}


OF_PROTOCOLS = {"TrueMean", "AtMostOneLeader", "AgreeAfterHeal", "NoConflict"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes", "passes"),
    [
        ("breakdown", {"network.links": "{'*': delay 200ms loss 30%}"}, True),
        ("breakdown", {"network.links": "{'*': delay 300ms}"}, True),
        ("breakdown", {"network.links": "{'*': delay 400ms}"}, False),
        ("breakdown", {}, False),
        ("rough-sea", {"network.links": "{'*': delay 200ms 50ms loss 80%}"}, False),
        ("rough-sea", {"network.links": "{'*': delay 500ms 50ms loss 30%}"}, False),
        ("follow-the-leader", {"network.links": "{'*': delay 200ms 50ms loss 80%}"}, False),
        ("follow-the-leader", {"network.links": "{'*': delay 1s 200ms loss 30%}"}, False),
        # gains for actuators without lag; a speed at which fins have no force
        ("remus", {"profile": "hardened", "guidance": "{rho_lo: -2 -2 -0.4 m/s, rho_hi: 2 2 0.4 m/s}"}, False),
        ("remus", {"reference.velocity": "0.4 0.05 0 m/s"}, False),
        ("leader-lost", {"knows_reference": "true"}, True),  # as in the scenario survey
        ("leader-lost-standby", {"graph.standby": "null"}, False),
        ("average-naive", {"network.links": "{}"}, True),
        ("average", {"agent": "fleet.protocols.average:NaiveAverage"}, False),
        ("election-slow", {"network.links": "{'*': delay 300ms}"}, True),
        ("election-slow", {"agent.parameters.quorum": "fleet"}, False),
        ("election", {"agent.parameters.quorum": "side"}, False),
        ("event-triggered", {"network.links": "{'*': delay 100ms loss 30%}"}, False),
        ("event-triggered-loss", {"agent.parameters.threshold_m": "0"}, True),
        ("auction", {"faults": "[{at: 3 s, for: 12 s, partition: '1,2 / 3,4'}]"}, False),
        ("auction-partition", {"faults": "[]"}, True),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_in_these_the_network_matters(name: str, changes: dict[str, str], passes: bool, tmp_path: Path) -> None:
    """A worse network, or one vehicle fewer that knows the course, turns the verdict round."""
    overrides = [f"{key}={value}" for key, value in changes.items()]
    overrides += ["expect=pass", "log.every=50 ticks"]
    thin = load_scenario(name, overrides)
    check = thin.spec.checks.formation_error
    if check is not None and not passes:  # such a check fails soon after it begins
        thin = load_scenario(name, [*overrides, f"duration={check.after // 10**9 + 15} s"])
    result = execute(thin, Options(tmp_path, in_process=True, quiet=True))
    failed = {verdict.check for verdict in result.checks if not verdict.passed}
    assert (result.status is Status.PASS) is passes, result.checks
    assert failed <= {"formation_error", "tumbled", "qp_infeasible", *OF_PROTOCOLS}  # nothing of ours


def test_the_page_says_with_how_many_seeds_each_passes() -> None:
    shares = re.findall(r"^\* \d+ of \d+: (.+)$", PAGE.read_text("utf-8"), re.MULTILINE)
    found = re.findall(r"`(.+?)`", ", ".join(shares))
    assert sorted(found) == [row.name for row in list_scenarios()]
