"""What an add-on may bring, and that one which is broken hurts nobody."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import click
import pytest
from in_process_runs import Alone, log_of
from tool import invoke

import fleet
from fleet import addon
from fleet.addon import AddOn, Verb
from fleet.cli import verbs
from fleet.cli.companion import Beside, Companion, Companions
from fleet.cli.declare import command
from fleet.cli.group import command_of
from fleet.errors import ScenarioError
from fleet.execution.options import Options
from fleet.logs.other import OtherData
from fleet.option import Option
from fleet.scenario.faults.kinds import KINDS, every_kind
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from world.plugins import loading

HEARD: list[str] = []


@command()
def shout() -> None:
    """Print a word."""
    click.echo("hey")


@command("run")
def other_run() -> None:
    """Take the place of a verb that is there."""


@dataclass(frozen=True)
class LampOptions:
    lamp: Annotated[str, Option("The colour of a lamp that is on during the run.", "COLOUR")] = ""


class Lamp(Companion):
    options_type = LampOptions

    def prepare(self, scenario: Scenario, how: Options, one_process: str) -> Options:
        if self.options.lamp == "infrared":
            raise click.UsageError("nobody sees that")
        HEARD.append(f"{self.options.lamp} for {scenario.name}, {one_process}")
        return how

    @contextmanager
    def beside(self, how: Options) -> Iterator[Beside]:
        HEARD.append("on")
        yield _Shining()
        HEARD.append("off")


class _Shining(Beside):
    def over(self, directory: Path) -> None:
        HEARD.append(f"over, with a log: {(directory / 'run.mcap').exists()}")


@dataclass(frozen=True)
class TakenOptions:
    seed: Annotated[int, Option("An option that fleet run has.")] = 0


class Taken(Companion):
    options_type = TakenOptions


class Rude(OtherData):
    """A reader that looks at what is not there."""

    name = "rude"

    def recognises(self, path: Path) -> bool:
        raise ValueError("nothing is as it was")


class Tape(OtherData):
    """A log whose bytes stand in the opposite order."""

    name = "a tape"
    is_log = True

    def recognises(self, path: Path) -> bool:
        return path.suffix == ".tape"

    def write_mcap(self, path: Path, file: Path) -> None:
        file.write_bytes(path.read_bytes()[::-1])


class Named:
    """As much of a kind of faults as the list of kinds asks."""

    acts_on = "world"

    def __init__(self, name: str) -> None:
        self.name = name


SQUALL, FALSE_KILL = Named("squall"), Named("kill")
ADDON = AddOn(
    verbs={"Noise": {"shout": Verb(f"{__name__}:shout", "Print."), "run": Verb(f"{__name__}:other_run", "Not so.")}},
    names={"loudness": __name__},
    companions=(f"{__name__}:Lamp", f"{__name__}:Taken"),
    readers=(f"{__name__}:Tape",),
    fault_kinds=(f"{__name__}:SQUALL", f"{__name__}:FALSE_KILL"),
    hints={"yell": "fleet shout"},
)
HALF = AddOn(  # each part of it is wrong in its own way
    verbs={"Noise": {"shout": Verb("no_such_module:shout", "Taken."), "void": Verb("no_such_module:void", "Gone.")}},
    companions=("no_such_module:Lamp", f"{__name__}:loudness"),
    exporters=("no_such_module:Svg",),
    readers=("no_such_module:Tape", f"{__name__}:Rude"),
    listings=("no_such_module:List",),
    fault_kinds=("no_such_module:KIND",),
)
loudness = 11
CACHES: tuple[Any, ...] = (addon.installed, addon.parts, verbs.headings, verbs.every_verb, fleet._every_name)


def __getattr__(name: str) -> Any:
    if name == "quits":
        raise SystemExit("this add-on needs Python 3.99")
    raise AttributeError(name)


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The add-on of this file beside others that cannot be used."""
    places = {
        "noise": f"{__name__}:ADDON",
        "gone": "no_such_module:ADDON",
        "odd": f"{__name__}:loudness",
        "quits": f"{__name__}:quits",
        "uneven": f"{__name__}:HALF",
    }
    monkeypatch.setitem(sys.modules, __name__, sys.modules.get(__name__) or _module())
    points = [EntryPoint(name, place, addon.GROUP) for name, place in places.items()]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points if group == addon.GROUP else [])
    _forget()
    yield
    _forget()
    HEARD.clear()


def _forget() -> None:
    """Let the commands that add-ons extend be made again, when they are asked for."""
    for cache in CACHES:
        cache.cache_clear()
    for name in ("fleet.cli.run", "fleet.cli.export", "fleet.cli.listing", "fleet.cli.documents.page"):
        sys.modules.pop(name, None)


def _module() -> ModuleType:
    """This file as a module that can be imported by its name, which it has not while pytest runs it."""
    made = ModuleType(__name__)
    vars(made).update(globals())
    return made


@pytest.mark.usefixtures("installed")
def test_a_verb_and_a_hint() -> None:
    shown = invoke("--help").stdout
    assert "Noise:\n  shout" in shown and "Not so" not in shown and shown.rindex("This tool:") > shown.index("Noise:")
    assert invoke("shout").stdout == "hey\n"
    assert command_of("run").help.startswith("Run SCENARIO")  # type: ignore[union-attr]
    said = invoke("yell").stderr
    assert "; use fleet shout\n" in said
    assert "left out: gone, odd" in said
    assert "(no_such_module:ADDON: ModuleNotFoundError: No module named 'no_such_module')" in said


@pytest.mark.usefixtures("installed")
def test_a_part_that_cannot_be_used_hurts_no_other(made: Alone) -> None:
    log = log_of(made("paper", "duration=1 s", "checks={}"))
    for words in (["list"], ["check", "paper"], ["run", "--help"], ["info", log], ["export", log, "--help"]):
        assert invoke(*words).exit_code == 0, words
    assert invoke("void").stderr.startswith(
        "fleet: fleet void cannot be loaded: no_such_module:void: ModuleNotFoundError"
    )
    assert invoke("about", "--schemas", "run").exit_code == 0
    assert fleet.open_log(log).digest
    about = invoke("about").stdout  # it loads every part
    left_out = addon.installed().left_out
    assert {
        "uneven.companions",
        "uneven.exporters",
        "uneven.readers",
        "uneven.listings",
        "uneven.fault_kinds",
    } <= left_out.keys()
    assert left_out["noise: fleet run"] == left_out["uneven: fleet shout"] == "there is a command of this name already"
    assert "uneven.companions: " in about and "noise: fleet run" in about
    assert "left out" in invoke("run", "paper", "--no-such").stderr


@pytest.mark.parametrize("wrong", [{"companions": "a:B"}, {"verbs": {"a": Verb("a:b", "c")}}, {"readers": ("a",)}])
def test_a_wrong_shape_is_told_at_once(wrong: dict[str, Any]) -> None:
    with pytest.raises(TypeError, match="expected"):
        AddOn(**wrong)


@pytest.mark.usefixtures("installed")
def test_a_name_in_python() -> None:
    assert fleet.loudness == 11  # type: ignore[attr-defined]
    assert "loudness" in dir(fleet) and "loudness" in fleet.__all__
    with pytest.raises(AttributeError, match="has no attribute 'sweep'"):
        fleet.sweep  # noqa: B018


@pytest.mark.usefixtures("installed")
def test_a_companion_prepares_a_run_and_hears_when_it_is_over(tmp_path: Path) -> None:
    @command("run")
    def run(name: str, *, companions: Companions, seed: int = 1) -> None:
        from fleet.cli.run import execute_and_print
        from fleet.scenario.loading import load_scenario
        from fleet.terminal.status_line import stderr

        scenario = load_scenario(name, ["duration=1 s", "checks={}"])
        how = Options(tmp_path, in_process=True, quiet=True)
        beside = [each for each in companions if each.asked]
        for each in beside:
            how = each.prepare(scenario, how, "--in-process")
        execute_and_print(scenario, how, beside, stderr(), None)

    from click.testing import CliRunner

    assert [option.name for option in run.params] == ["name", "lamp", "seed"]  # the option that is taken stands once
    assert CliRunner().invoke(run, ["paper"]).exit_code == 0 and HEARD == []
    assert CliRunner().invoke(run, ["paper", "--lamp", "red"]).exit_code == 0
    assert HEARD == ["red for paper, --in-process", "on", "over, with a log: True", "off"]
    refused = CliRunner().invoke(run, ["paper", "--lamp", "infrared"])
    assert refused.exit_code == 2 and "nobody sees that" in refused.output


@pytest.mark.usefixtures("installed")
def test_a_reader_makes_a_log_of_what_is_none(made: Alone, tmp_path: Path) -> None:
    log = log_of(made("paper", "duration=1 s", "checks={}"))
    tape = tmp_path / "dive.tape"
    tape.write_bytes(log.read_bytes()[::-1])
    assert fleet.open_log(tape).digest == fleet.open_log(log).digest
    assert invoke("info", tape).exit_code == invoke("diff", tape, log).exit_code == 0
    shutil.copy(log, tmp_path / "dive.unknown")
    assert fleet.open_log(tmp_path / "dive.unknown").digest == fleet.open_log(log).digest


@pytest.mark.usefixtures("installed")
def test_a_kind_of_faults_is_one_more_and_takes_the_place_of_none() -> None:
    found = every_kind()
    assert found["squall"] is SQUALL and found["kill"] is KINDS["kill"] and len(found) == len(KINDS) + 1


def test_a_check_may_be_named_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("few-leaders", "fleet.protocols.checks:AtMostOneLeader", "uuv_fleet.checks")
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [point] if group == point.group else [])
    loading.installed.cache_clear()
    try:
        result = fleet.run("election", set={"checks": {"few-leaders": {"per": "fleet"}}, "duration": "2 s"})
        assert result.checks[-1].check == "few-leaders"
        with pytest.raises(ScenarioError, match="few-leaders2"):
            load_scenario("election", ["checks={few-leaders2: {}}"])
    finally:
        loading.installed.cache_clear()
