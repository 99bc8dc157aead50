"""Verbs are declared once: the parameters of a function are the arguments and options of its command."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import click
import pytest
from click.testing import CliRunner
from msgspec import Struct
from repository import ROOT

from fleet.addons.hosts.companion import HostsOptions
from fleet.addons.studies.spec import BoundarySpec, StudySpec
from fleet.addons.studies.verbs.study_options import MakingStudy, WorkerOptions
from fleet.cli.changes import Changes
from fleet.cli.declare import DeclaredCommand, ShownOption, command
from fleet.cli.main import cli
from fleet.cli.types import TIME, Effect, Fallback, Words
from fleet.execution.options import Options
from fleet.option import NEEDED, Kind, Limits, Option, fields
from fleet.replay.player import PlaybackOptions
from netem.clock import Clock


def verbs(group: click.Group = cli, path: tuple[str, ...] = ()) -> Iterator[tuple[str, click.Command]]:
    """Every command below a group by its words, and the groups within."""
    for name in group.list_commands(click.Context(group)):
        found = group.get_command(click.Context(group), name)
        assert found is not None
        yield " ".join((*path, name)), found
        if isinstance(found, click.Group):
            yield from verbs(found, (*path, name))


VERBS = dict(verbs())
LEAVES = {name: verb for name, verb in VERBS.items() if not isinstance(verb, click.Group)}


def test_every_verb_is_declared_by_its_parameters() -> None:
    """A decorator that says an option would say it a second time."""
    assert sorted(name for name, verb in LEAVES.items() if not isinstance(verb, DeclaredCommand)) == []
    calls = [
        f"{path.name}:{node.lineno}"
        for path in [*(ROOT / "fleet/cli").glob("*.py"), *(ROOT / "fleet/addons").rglob("*.py")]
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Attribute) and ast.unparse(node) in ("click.option", "click.argument", "click.command")
    ]
    assert [place for place in calls if not place.startswith("declare.py")] == []


@pytest.mark.parametrize("name", LEAVES)
def test_what_a_help_shows_as_a_default_is_read_as_the_default(name: str) -> None:
    for option in LEAVES[name].params:
        if isinstance(option, ShownOption) and option.shown:
            context = click.Context(LEAVES[name])
            words = option.shown.split(", ") if option.multiple else [option.shown]
            read = [option.type.convert(word, option, context) for word in words]
            default = option.field.default
            assert (read if option.multiple else read[0]) == (list(default) if option.multiple else default)


@pytest.mark.parametrize("name", LEAVES)
def test_a_help_ends_with_json_and_quiet_and_explains_every_option(name: str) -> None:
    options = [each for each in LEAVES[name].params if isinstance(each, click.Option)]
    names = [option.opts[-1] for option in options]
    last = [each for each in ("--json", "--quiet") if each in names]
    assert names[len(names) - len(last) :] == last
    assert [option.opts for option in options if not (option.help or "").endswith(".")] == []


def test_a_verb_has_json_exactly_if_it_has_a_document() -> None:
    for name, verb in LEAVES.items():
        assert isinstance(verb, DeclaredCommand)
        assert any("--json" in each.opts for each in verb.params) == bool(verb.documents), name
        assert all(words.startswith(name) for words in verb.documents)


def test_every_field_is_an_option() -> None:
    """A field whose type only the type checker can read is none, so a lost import would take an option away."""
    for kind in (Options, HostsOptions, PlaybackOptions, WorkerOptions, MakingStudy, Changes):
        assert set(kind.__dataclass_fields__) == set(fields(kind))
    for spec in (StudySpec, BoundarySpec):
        assert set(spec.__struct_fields__) == set(fields(spec))


@dataclass(frozen=True)
class Manner:
    out: Annotated[Path, Option("Where.", "DIR", "-o --out")] = Path("runs")
    clock: Annotated[Clock, Option("Which.")] = Clock.LOCKSTEP
    wait_s: Annotated[float, Kind.TIME, Option("How long.", flag="--wait")] = 300.0
    speed: Annotated[float | None, Kind.SPEED, Option("How fast.")] = None
    port: Annotated[int | None, Limits(1, 9), Option("A port.")] = None
    hidden: int = 5


class Wishes(Struct):
    name: Annotated[str, Option("Of whom.", flag=None)]
    tags: Annotated[list[str], Option("Some.")] = []


TOLD: list[str] = []
SEEN: dict[str, Any] = {}


@command()
def verb(
    name: str,
    place: Annotated[Path, Fallback(lambda: Path("found"))],
    *,
    size: Annotated[int, Option("How many.")],
    how: Manner,
    wishes: Wishes,
    begin: Annotated[int, TIME, Option("When.", flag="--from")] = 0,
    kinds: Annotated[tuple[str, ...], Words(("a", "b"), "all"), Option("Which.")] = ("a", "b"),
    times: Annotated[tuple[Annotated[int, TIME], ...], Option("Several.")] = (),
    ros: Annotated[Literal["humble", "jazzy"] | None, Option("One.", "[DISTRO]", alone="jazzy")] = None,
    on: Annotated[bool | None, Option("On or off.", flag="--on/--off")] = None,
    loud: Annotated[bool, Option("Say it."), Effect(lambda context: TOLD.append(str(context.info_name)))] = False,
) -> None:
    """Do it."""
    SEEN.update(
        {each: value for each, value in locals().items() if each not in ("how", "wishes")}, how=how, wishes=wishes
    )


def seen(*words: str) -> dict[str, Any]:
    SEEN.clear()
    TOLD.clear()
    result = CliRunner().invoke(verb, words, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return dict(SEEN)


def test_what_is_not_given_has_the_default_of_the_declaration() -> None:
    assert seen("me", "--size", "3") == {
        "name": "me", "place": Path("found"), "size": 3, "how": Manner(), "wishes": Wishes("me"), "begin": 0,
        "kinds": ("a", "b"), "times": (), "ros": None, "on": None, "loud": False,
    }  # fmt: skip
    assert TOLD == []


def test_what_is_given_is_read_by_its_type() -> None:
    found = seen(
        "me", "there", "--size", "3", "-o", "x", "--clock", "real", "--wait", "1 min", "--speed", "2x", "--port", "9",
        "--tags", "p", "--tags", "q", "--from", "2 ms", "--kinds", "b", "--times", "1 s", "--times", "2 s", "--ros",
        "--off", "--loud",
    )  # fmt: skip
    assert found["how"] == Manner(Path("x"), Clock.REAL, 60.0, 2.0, 9)
    assert found["wishes"] == Wishes("me", ["p", "q"])
    assert (found["place"], found["begin"], found["kinds"]) == (Path("there"), 2_000_000, ("b",))
    assert (found["times"], found["ros"], found["on"], found["loud"]) == ((10**9, 2 * 10**9), "jazzy", False, True)
    assert TOLD == ["verb"]


def test_what_has_no_default_has_to_be_given() -> None:
    for words in (["me"], ["--size", "3"], ["me", "--size", "3", "--port", "10"]):
        assert CliRunner().invoke(verb, words).exit_code == 2
    assert [each.name for each in verb.params if each.required] == ["name", "size"]
    assert next(each for each in verb.params if each.name == "size").field.default is NEEDED  # type: ignore[attr-defined]
