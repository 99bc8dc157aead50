"""What the page of a report says of a run, besides its pictures and tables."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import pytest
from html_page import words_of
from in_process_runs import Alone
from tool import invoke

from fleet.addons.pictures.report import page
from fleet.addons.pictures.runs import View, load
from fleet.addons.pictures.scenario_facts import network_facts
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.scenario.loading import load_scenario

pytestmark = pytest.mark.usefixtures("coarse")


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """One picture, since they take most of the time."""
    monkeypatch.setattr("fleet.addons.pictures.report.WHAT", {"formation": ()})


def test_report_names_the_run_that_latest_is_and_says_when_it_began(tmp_path: Path) -> None:
    """The log holds simulated time only: the date is that of the directory's name."""
    overrides = [
        "duration=200 ms", "checks={}", "per_vehicle={2-3: {controller: bc, profile: hardened}}",
        "network.links={'*': 'delay 20ms loss 5%', '1->2': 'delay 1s'}",
    ]  # fmt: skip
    scenario = load_scenario("paper", overrides)
    directory = execute(scenario, Options(tmp_path, in_process=True, quiet=True)).directory
    stamp = datetime.strptime(directory.name, "paper-1-%Y%m%d-%H%M%S").strftime("%Y-%m-%d %H:%M:%S UTC")
    text = page(load([tmp_path / "latest"]), View())
    assert f"<title>uuv-fleet: {directory.name}</title>" in text
    words = words_of(text)
    assert "latest" not in words and f"{directory}/run.mcap" in words
    for said in (
        f"begun | {stamp}",
        "controller | vehicles 1, 4: nboc (guidance optimal, tracking neurodynamic); "
        "vehicles 2-3: bc (guidance fixed, tracking backstepping)",
        "profile | vehicles 1, 4: paper; vehicles 2-3: hardened",
        "graph | path, ahead 1, behind 0.8; 6 directed links; the reference is followed by every vehicle",
        "round | every 100 ms",
        "links | condition | * | delay 20ms loss 5% | 1->2 | delay 1s",
        "There was no fault.",
    ):
        assert said in words
    moved = directory.rename(tmp_path / "moved")
    assert "unknown: the name of the run does not say when" in page(load([moved]), View())


def test_a_report_names_the_modem_and_what_was_changed_of_it() -> None:
    facts = dict(network_facts(load_scenario("acoustic-noise")))
    assert facts["network"] == "acoustic channel" and facts["modem"] == "mfsk-1066"
    assert (facts["mac"], facts["wind"], facts["round"]) == ("tdma", "20 m/s", "every 2 s")
    assert network_facts(load_scenario("ideal")) == [("network", "ideal: without latency")]


def test_a_report_is_not_overwritten_without_force(made: Alone, tmp_path: Path) -> None:
    log = made("ideal", "duration=200 ms", "checks={}", "seed=7").directory
    out = tmp_path / "r.html"
    out.write_text("mine")
    arguments = ["report", str(log), "-o", str(out)]
    refused = invoke(*arguments)
    assert refused.exit_code == 2 and out.read_text() == "mine"
    assert refused.stderr == (
        f"fleet: {out} already exists; choose another place with -o FILE, or replace it with --force\n"
    )
    assert invoke(*arguments, "--force").exit_code == 0
    assert "<!DOCTYPE html>" in out.read_text()
    out = tmp_path / "loop"
    out.symlink_to("loop")  # a traceback in Python 3.11 and 3.12
    assert invoke("report", log, "-o", out).exit_code == 0
    assert out.is_file() and not list(tmp_path.glob("*.part"))
