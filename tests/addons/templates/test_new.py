"""`fleet new scenario`; the templates of laws are tested with the plug-ins, in tests/agents/test_plugins.py."""

from __future__ import annotations

import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import Result
from tool import invoke

from fleet.addons.templates.verb import write_scenario
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Status
from fleet.scenario.catalogue import shipped_scenarios
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.sections.vehicle_files import load_vehicle
from world.api import PlantConfig, Water

SWITCHED_OFF = re.compile(r"^ *#(?=[^ #\n])", re.M)  # a key that may be switched on; prose has a space behind its #


def new(*arguments: str) -> Result:
    return invoke("new", "scenario", *arguments)


@pytest.mark.once
def test_it_is_checked_runs_and_passes_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    written = new("harbour", "--dir", "some where")
    assert written.exit_code == 0, written.output
    check, run = written.stdout.partition("now: ")[2].split(" && ")  # what it says to type
    checked = invoke(*shlex.split(check)[1:])
    assert (checked.exit_code, checked.stderr) == (0, "")
    assert checked.stdout.startswith("harbour: valid. 4 vehicles")
    assert shlex.split(run)[:2] == ["fleet", "run"]
    scenario = load_scenario(shlex.split(run)[2], ["log.every=100 ticks"])
    result = execute(scenario, Options(tmp_path, in_process=True, quiet=True))
    assert result.status is Status.PASS, result.checks


def test_every_key_that_it_leaves_switched_off_is_valid(tmp_path: Path) -> None:
    text = write_scenario("harbour", None, tmp_path).read_text("utf-8")
    plain = parse_scenario(text, "harbour.yaml")
    places = list(SWITCHED_OFF.finditer(text))
    assert len(places) >= 10
    for place in places:
        switched_on = text[: place.end() - 1] + text[place.end() :]
        assert parse_scenario(switched_on, "harbour.yaml").to_yaml() != plain.to_yaml(), place
    everything = SWITCHED_OFF.sub(lambda found: found[0][:-1], text)
    assert parse_scenario(everything, "harbour.yaml").spec.expect == "fail"


def test_all_common_sections_are_in_it(tmp_path: Path) -> None:
    text = write_scenario("harbour", None, tmp_path).read_text("utf-8")
    sections = {line.split(":")[0].lstrip("#") for line in text.splitlines() if re.match(r"#?[a-z]", line)}
    assert sections >= {
        "name", "title", "vehicles", "duration", "tick", "seed", "reference", "formation", "graph", "initial",
        "controller", "profile", "neighbours", "sea", "sensors", "network", "faults", "checks", "log", "expect",
    }  # fmt: skip
    assert all(len(line) <= 120 for line in text.splitlines())


def test_a_shipped_scenario_is_copied_with_its_comments(tmp_path: Path) -> None:
    for name in shipped_scenarios():
        path = write_scenario(f"my-{name}", name, tmp_path)
        copy, shipped = load_scenario(path), load_scenario(name)
        assert copy.name == f"my-{name}"
        assert copy.to_yaml() == shipped.to_yaml().replace(f"name: {name}\n", f"name: my-{name}\n", 1)
        assert path.read_text("utf-8").startswith("# ")


@pytest.mark.parametrize("name", ["007", "1e3", "null", "true", "paper", "a" * 64])
def test_a_name_that_yaml_has_another_use_for(name: str, tmp_path: Path) -> None:
    assert load_scenario(write_scenario(name, None, tmp_path)).name == name


def test_a_plant_is_checked_and_runs_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    written = invoke("new", "plant", "sea_glider")
    assert written.stdout == "wrote sea_glider.py and sea_glider.yaml; now: fleet run sea_glider.yaml\n"
    assert "class SeaGlider:" in Path("sea_glider.py").read_text("utf-8")
    checked = invoke("check", "sea_glider.yaml")
    assert (checked.exit_code, checked.stderr) == (0, "")


def test_a_current_carries_the_template_of_a_plant_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it does in the water does not depend on where the water goes."""
    monkeypatch.syspath_prepend(str(tmp_path))
    invoke("new", "plant", "drifting_glider", "--dir", tmp_path)
    config = PlantConfig(1, 0.01, 1, load_vehicle("paper").params)
    plant = import_module("drifting_glider").DriftingGlider(config)
    current, none = (0.3, -0.2, 0.1), (0.0, 0.0, 0.0)
    states = [plant.start((0.0,) * 6, (0.5 + c[0], c[1], c[2], 0.0, 0.0, 0.0)) for c in (current, none)]
    for _ in range(600):
        for k, c in enumerate((current, none)):
            states[k] = plant.step(states[k], (5.0, 0.3, -0.6), Water(c, (0.0,) * 6), 0.005)
    carried, still = map(plant.pose, states)
    assert abs(still[3]) > 0.01 and abs(still[5]) > 0.1
    assert carried[3:] == pytest.approx(still[3:], abs=1e-5)
    assert carried[:3] == pytest.approx([a + 3.0 * c for a, c in zip(still[:3], current, strict=True)], abs=1e-4)


@pytest.mark.slow
def test_the_fleet_of_the_template_of_a_plant_holds_its_formation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert invoke("new", "plant", "ocean_glider").exit_code == 0
    assert Path("ocean_glider.py").exists()
    result = execute(load_scenario("ocean_glider.yaml"), Options(tmp_path, in_process=True, quiet=True))
    assert result.status is Status.PASS, result.checks


@pytest.mark.parametrize("name", ["gossip", "class_", "formation_agent"])
def test_a_protocol_is_checked_runs_and_passes_as_it_is(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With its check in Python and those on signals; its agents can go on from a log, and break on a worse network."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    written = invoke("new", "protocol", name)
    assert written.stdout == f"wrote {name}.py, {name}_check.py and {name}.yaml; now: fleet run {name}.yaml\n"
    checked = invoke("check", f"{name}.yaml")
    assert (checked.exit_code, checked.stderr) == (0, ""), checked.output
    if name != "gossip":
        return
    quick = ["log.every=10 ticks"]
    result = execute(load_scenario(f"{name}.yaml", quick), Options(tmp_path, in_process=True, quiet=True))
    assert result.status is Status.PASS, result.checks
    assert {"GossipCheck", "one-answer", "all-are-back"} <= {verdict.check for verdict in result.checks}
    assert {row["agent"] for row in result.values["vehicles"].values()} == {"gossip:Gossip"}
    assert [row["signals"]["there"]["value"] for row in result.values["vehicles"].values()] == [4.0] * 4
    worse = load_scenario(f"{name}.yaml", [*quick, "duration=12 s", "network.links={'*': delay 1s loss 60%}"])
    result = execute(worse, Options(tmp_path, in_process=True, quiet=True))
    failed = {verdict.check for verdict in result.checks if not verdict.passed}
    assert result.status is Status.CHECK_FAILED and "GossipCheck" in failed


def test_a_protocol_needs_the_name_of_its_check_too(tmp_path: Path) -> None:
    (tmp_path / "gossip_check.py").write_text("mine")
    refused = invoke("new", "protocol", "gossip", "--dir", tmp_path)
    assert refused.exit_code == 2 and "gossip_check.py is there already" in refused.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["gossip_check.py"]
