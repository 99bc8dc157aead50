"""Whole runs over the acoustic channel, and what the compact payload costs."""

from __future__ import annotations

from pathlib import Path

import pytest
from in_process_runs import recorded

from fleet.result.result import Result
from fleet.scenario.loading import load_scenario


def run(out: Path, name: str, *overrides: str) -> Result:
    return recorded(out, name, "log.every=50 ticks", *overrides)


@pytest.mark.slow
def test_noise_loses_what_check_says(tmp_path: Path) -> None:
    """`acoustic-noise`: nothing but noise loses, as many as the ranges say, none at less wind and all at 1 dB less."""
    scenario = load_scenario("acoustic-noise")
    assert scenario.acoustic is not None
    expected = scenario.acoustic.packet_error_rate(340.0, 15)
    assert 0.3 < expected < 0.5
    for override, share, duration in (
        ("network.acoustic.source_level=145 dB", expected, "150 s"),
        ("network.acoustic.wind=10 m/s", 0.0, "30 s"),  # none is none, and all is all, without statistics
        ("network.acoustic.source_level=144 dB", 1.0, "30 s"),
    ):
        changes = (override, f"duration={duration}", "checks={ledger: balanced}")
        result = run(tmp_path, "acoustic-noise", *changes)
        links = result.values["ledger"].values()
        lost = [link["lost"] for link in links]
        assert {cause for causes in lost for cause in causes} <= {"snr", "replaced"}
        drowned = sum(causes.get("snr", 0) for causes in lost)
        heard = sum(link["delivered"] for link in links)
        error = (share * (1 - share) / (heard + drowned)) ** 0.5
        assert abs(drowned / (heard + drowned) - share) <= 3 * error


def final_error_m(result: Result) -> float:
    """The formation error at the end [m], of the vehicle that has most."""
    check = next(v for v in result.checks if v.check == "formation_error")
    return float(check.found.removeprefix("at most ").split()[0])


@pytest.mark.slow
def test_the_compact_payload_costs_less_than_its_step(tmp_path: Path) -> None:
    """The paper's fleet at the end of its minute: without error in full, within half a step of 5 cm in compact."""
    errors = {
        payload: final_error_m(
            run(tmp_path, "paper", f"network.payload={payload}", "checks.formation_error.after=59 s")
        )
        for payload in ("full", "compact")
    }
    assert errors["full"] < 1e-4
    assert 1e-4 < errors["compact"] < 0.025
