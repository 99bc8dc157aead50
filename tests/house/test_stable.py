"""What docs/reference/stability.md promises: nothing that is stable disappears, and logs of 0.1 open and verify.

`tests/expected/stable.json` lists the names as they were when they became stable. A new version may have more names,
but each of these must stay, with its type or unit. To add new ones: WRITE_STABLE=1 pytest tests/house/test_stable.py
"""

from __future__ import annotations

import json
import os
import platform
import re
import tomllib
from collections.abc import Callable, Iterator
from inspect import signature
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, get_args, get_origin

import msgspec
import pytest
from pydantic import AliasChoices, BaseModel
from repository import ROOT

import agents.api
import fleet
import fleet.checks.api
import world.api
from fleet.cli.documents.page import DOCUMENTS
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.repeat.verify import verify
from fleet.scenario.schema.spec import ScenarioSpec

EXPECTED = ROOT / "tests" / "expected"
# Version 0.1.0 made it, and it is never made again: fleet run paper --in-process --duration '2 s'
# --set controller=bc --set vehicles=2 --set 'checks={}' --net '* delay 20ms loss 20%' --fault 'at 1s for 500ms mute 2'
# --set 'log={scene: 0 ticks, transforms: 0 ticks, every: 5 ticks}'
LOG = EXPECTED / "log-0.1.mcap"
MODULES = (fleet, agents.api, world.api, fleet.checks.api)
FUNCTIONS = ("boundary", "open_log", "open_study", "parallel_env", "run", "Run", "sweep")


def python_names() -> dict[str, str]:
    """Names of the modules for users, and the arguments of their functions."""
    found: dict[str, str] = {}
    modules: tuple[ModuleType, ...] = MODULES
    for module in modules:
        found |= dict.fromkeys((f"{module.__name__}.{name}" for name in module.__all__), "name")
    for function in FUNCTIONS:
        for name, parameter in signature(getattr(fleet, function)).parameters.items():
            found[f"fleet.{function}({name})"] = parameter.kind.description
    return found


def _models(annotation: Any) -> Iterator[tuple[str, type[BaseModel]]]:
    """The sections within a type, each with the step in the file that leads to it."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield "", annotation
    elif get_origin(annotation) is Annotated:
        yield from _models(get_args(annotation)[0])
    else:
        step = ".*" if get_origin(annotation) is dict else ""
        for part in get_args(annotation):
            yield from ((step + inner, model) for inner, model in _models(part))


def scenario_keys(
    model: type[BaseModel] = ScenarioSpec, path: str = "", above: tuple[type, ...] = ()
) -> dict[str, str]:
    """The keys of a scenario with their path."""
    found: dict[str, str] = {}
    for name, field in model.model_fields.items():
        known = field.validation_alias  # a key that was renamed is read by its old name, too
        for spelt in known.choices if isinstance(known, AliasChoices) else [field.alias or name]:
            found[f"{path}{spelt}"] = "required" if field.is_required() else "optional"
        for step, inner in _models(field.annotation):
            if inner not in above:
                found |= scenario_keys(inner, f"{path}{field.alias or name}{step}.", (*above, model))
    return found


def json_fields() -> dict[str, str]:
    """The fields of what `--json` prints, with their types."""
    found: dict[str, str] = {}

    def walk(schema: dict[str, Any], definitions: dict[str, Any], path: str, above: tuple[str, ...]) -> None:
        if (ref := schema.get("$ref", "").rpartition("/")[2]) and ref not in above:
            walk(definitions[ref], definitions, path, (*above, ref))
        for part in schema.get("anyOf", []):
            walk(part, definitions, path, above)
        for name, inner in schema.get("properties", {}).items():
            types = sorted(
                {part.get("type", "string" if "enum" in part else "record") for part in inner.get("anyOf", [inner])}
            )
            found[f"{path}.{name}"] = " or ".join(types)
            walk(inner, definitions, f"{path}.{name}", above)
        for items in (schema.get("items"), schema.get("additionalProperties")):
            if isinstance(items, dict):
                walk(items, definitions, f"{path}[]", above)

    for command, document in DOCUMENTS.items():
        (schema,), definitions = msgspec.json.schema_components([document], schema_hook=lambda _: {"type": "string"})
        walk(schema, definitions, command, ())
    return found


def log_fields(path: Path = LOG) -> dict[str, str]:
    """The fields of each kind of topic in a log, with their units."""
    log = fleet.open_log(path)
    return {
        f"{re.sub(r'[0-9]+', '<i>', topic)} {field}": unit for topic in log for field, unit in log[topic].units.items()
    }


KINDS: dict[str, Callable[[], dict[str, str]]] = {
    "python": python_names, "scenario": scenario_keys, "json": json_fields, "log": log_fields,
}  # fmt: skip


@pytest.mark.parametrize("kind", [*KINDS])
def test_nothing_stable_disappears(kind: str, tmp_path: Path) -> None:
    found = KINDS[kind]()
    if kind == "log":  # by this version
        again = fleet.open_log(LOG).scenario
        result = execute(again, Options(tmp_path, in_process=True, quiet=True))
        found = log_fields(result.directory / "run.mcap")
    file = EXPECTED / "stable.json"
    if os.environ.get("WRITE_STABLE"):
        kept = json.loads(file.read_text()) if file.exists() else {}
        kept[kind] = dict(sorted((kept.get(kind, {}) | found).items()))
        file.write_text(json.dumps(kept, indent=0, sort_keys=True) + "\n")
    stable = json.loads(file.read_text())[kind]
    gone = {name: f"{was} -> {found.get(name, 'gone')}" for name, was in stable.items() if found.get(name) != was}
    assert gone == {}
    assert len(stable) > 20


def test_a_log_of_0_1_opens() -> None:
    log = fleet.open_log(LOG)
    assert log.missing == ""
    assert [fault.what for fault in log.faults] == ["mute 2"]
    assert {"uuv/1/state", "uuv/2/error", "link/1-2", "faults"} <= set(log)
    assert log["uuv/1/state"].units["z"] == "m"
    assert log.scenario.vehicles == 2


@pytest.mark.skipif(platform.machine() != "x86_64", reason="sin and cos of another processor may round otherwise")
def test_a_log_of_0_1_verifies() -> None:
    found = verify(LOG)
    assert found.difference is None
    assert found.reproduced


def test_one_version_everywhere() -> None:
    """That of the newest release; what is not released yet has a later one, which says so."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    citation = (ROOT / "CITATION.cff").read_text("utf-8")
    log = (ROOT / "CHANGELOG.md").read_text("utf-8")
    changes = re.findall(r"^## \[([\d.]+)\] - (\d{4}-\d\d-\d\d)$", log, re.MULTILINE)
    package = (ROOT / "fleet/addons/robots/ros2/uuv_fleet_msgs" / "package.xml").read_text("utf-8")
    assert "\n## [Unreleased]\n" in log
    released, on = changes[0]
    if later := re.fullmatch(r"(\d+\.\d+\.\d+)\.dev\d+", version):
        if later[1] == released:  # its section has been written, and its release comes next
            released, on = changes[1]
        assert tuple(map(int, later[1].split("."))) > tuple(map(int, released.split(".")))
    else:
        assert released == version
    assert f"\nversion: {released}\ndate-released: {on}\n" in citation
    assert f"<version>{released}</version>" in package


def test_the_page_names_tests_that_exist() -> None:
    text = (ROOT / "docs" / "reference" / "stability.md").read_text("utf-8")
    named = set(re.findall(r"`(tests/[\w/.-]+\.(?:py|json|mcap))`", text))
    assert len(named) > 6
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []
