"""What an add-on may bring, and that one which is broken hurts nobody."""

from __future__ import annotations

import ast
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
from repository import ROOT
from tool import invoke

import fleet
from fleet import addon
from fleet.addon import AddOn, Verb
from fleet.addons import api
from fleet.cli import verbs
from fleet.cli.companion import Companion, Companions, RunCompanion
from fleet.cli.declare import command
from fleet.cli.exporter import Exporter
from fleet.cli.group import command_of
from fleet.cli.listing import Listing
from fleet.errors import ScenarioError
from fleet.execution.options import Options
from fleet.mcap.other import OtherData
from fleet.option import Option
from fleet.scenario.faults.kind import FleetFaultKind
from fleet.scenario.faults.kinds import KINDS, every_kind
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from world.plugins import loading

HEARD: list[str] = []


@command()
def shout() -> None:
    """Print a word."""
    click.echo("hey")


@command()
def stumble() -> None:
    """Fail in a way that nobody expects."""
    raise Silent


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
    def start(self, how: Options) -> Iterator[RunCompanion]:
        HEARD.append("on")
        yield _Shining()
        HEARD.append("off")


class _Shining(RunCompanion):
    def on_run_ended(self, directory: Path) -> None:
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


class SquallFault(FleetFaultKind):
    """A gust for everybody."""

    value, example = float, "squall 3"


class KillFault(SquallFault):
    """A kind whose name is taken."""


class Silent(Exception):
    """An error that cannot say what it is."""

    def __str__(self) -> str:
        raise ValueError


class Broken:
    """What an add-on may bring that cannot be used, each in another way, and the commands that it must not hurt."""

    class NameAlone:
        name = "gust"

    class Untyped(SquallFault):
        name = "untyped"
        value = "no type at all"

    class Loud(SquallFault):
        name = "loud \x1b[31m"

    class NoExample(FleetFaultKind):
        name, value = "bare", float

    class KeylessList(Listing):
        row, headings = Verb, ("a",)

        def rows(self) -> Any:
            return []

        def cells(self, row: Any) -> Any:
            return []

    class FailingList(KeylessList):
        key = "failing"

        def rows(self) -> Any:
            raise Silent

    class UnevenList(KeylessList):
        key = "uneven"

        def rows(self) -> Any:
            return [Verb("a", "b")]

    class SameList(KeylessList):
        key = "scenarios"

    @dataclass(frozen=True)
    class Unread:
        far: Annotated[complex, Option("A number that no command line reads.")] = 0j

    class Far(Companion):
        pass

    Far.options_type = Unread

    @dataclass(frozen=True)
    class Needs:
        needed: Annotated[str, Option("Without a default.")]

    class Needy(Companion):
        pass

    Needy.options_type = Needs

    class NoReader:
        def recognises(self, path: Path) -> bool:
            return True

    class Formless(Exporter):
        options_type = LampOptions


BROKEN = {
    "fault_kinds": ("NameAlone", "Untyped", "Loud", "NoExample"),
    "listings": ("KeylessList", "FailingList", "UnevenList", "SameList"),
    "companions": ("Far", "Needy"),
    "readers": ("NoReader",),
    "exporters": ("Formless",),
}
SQUALL, FALSE_KILL = SquallFault(), KillFault()
ADDON = AddOn(
    verbs={
        "Noise": {
            "shout": Verb(f"{__name__}:shout", "Print."),
            "run": Verb(f"{__name__}:other_run", "Not so."),
            "stumble": Verb(f"{__name__}:stumble", "Fail."),
        }
    },
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
CACHES: tuple[Any, ...] = (addon.installed_addons, addon.parts, verbs.headings, verbs.every_verb, fleet._every_name)


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
    left_out = addon.installed_addons().left_out
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


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in BROKEN.items() for name in names])
def test_a_part_that_is_wrong_is_left_out_with_a_reason(
    kind: str, name: str, monkeypatch: pytest.MonkeyPatch, made: Alone
) -> None:
    part = getattr(Broken, name)
    here = ModuleType("broken_addon")
    here.PART = part() if kind == "fault_kinds" else part  # type: ignore[attr-defined]
    here.ADDON = AddOn(**{kind: ("broken_addon:PART",)})  # type: ignore[attr-defined, arg-type]
    monkeypatch.setitem(sys.modules, "broken_addon", here)
    points = [EntryPoint("broken", "broken_addon:ADDON", addon.GROUP)]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points if group == addon.GROUP else [])
    _forget()
    try:
        log = log_of(made("paper", "duration=1 s", "checks={}"))
        for words in (["list"], ["list", "--json"], ["run", "--help"], ["export", log, "--help"], ["info", log]):
            assert invoke(*words).exit_code == 0, words
        assert set(every_kind()) == set(KINDS)
        about = invoke("about").stdout
        assert "left out" in about and "\x1b" not in about
    finally:
        _forget()


def test_errors_that_cannot_say_what_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise Silent

    point = EntryPoint("si\x1b[31mlent", "silent_addon:ADDON", addon.GROUP)
    monkeypatch.setattr(EntryPoint, "load", lambda self: fail())
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [point] if group == addon.GROUP else [])
    _forget()
    try:
        assert list(addon.installed_addons().left_out.values()) == [
            "silent_addon:ADDON: Silent, whose text cannot be made"
        ]
        assert "\x1b" not in invoke("about").stdout and "\x1b" not in invoke("shoutt").stderr
    finally:
        _forget()


@pytest.mark.usefixtures("installed")
def test_a_verb_that_fails_is_a_mistake_of_its_add_on_and_no_failed_check() -> None:
    """Python's exit status of an error is 1, which here means that a check failed."""
    said = invoke("stumble")
    assert said.exit_code == 3
    assert "Silent, whose text cannot be made: a mistake in fleet stumble, which the add-on" in said.stderr
    assert "raise Silent" in said.stderr


def test_the_api_of_add_ons_is_what_type_checkers_see_and_what_the_guide_lists() -> None:
    tree = ast.parse(Path(api.__file__).read_text("utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {node.names[0].name: node.module for node in block.body if isinstance(node, ast.ImportFrom)}
    assert seen == api._PLACES and api.__all__ == sorted(seen)
    assert all(getattr(api, name) is not None for name in api.__all__)
    guide = (ROOT / "docs/guide/add-ons.md").read_text("utf-8")
    assert {name for name in api.__all__ if f"`{name}`" not in guide} == set()
    with pytest.raises(AttributeError, match="it has Companion, "):
        api.Verb  # noqa: B018


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
    loading.entry_points_of.cache_clear()
    try:
        result = fleet.run("election", set={"checks": {"few-leaders": {"per": "fleet"}}, "duration": "2 s"})
        assert result.checks[-1].check == "few-leaders"
        with pytest.raises(ScenarioError, match="few-leaders2"):
            load_scenario("election", ["checks={few-leaders2: {}}"])
    finally:
        loading.entry_points_of.cache_clear()
