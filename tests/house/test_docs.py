"""The documentation: the README is short, and pages name what exists."""

from __future__ import annotations

import ast
import re
import tomllib

import click
import pytest
from repository import ROOT

from fleet.cli.main import cli
from fleet.cli.verbs import every_verb
from fleet.option import fields
from fleet.replay.player import PlaybackOptions
from netem.limits import table

TEXTS = ["README.md", "CONTRIBUTING.md"]


def test_the_readme_is_a_front_door() -> None:
    lines = (ROOT / "README.md").read_text("utf-8").splitlines()
    assert len(lines) <= 140  # three screens, one of them on where is what


def test_files_that_pages_name_are_there() -> None:
    pages = [*(ROOT / name for name in TEXTS), ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")]
    text = "".join(page.read_text("utf-8") for page in pages if "_build" not in page.parts)
    named = set(re.findall(r"\b(?:tests|benchmarks|docs/examples)/[\w/]+\.(?:py|yaml)\b", text))
    assert len(named) > 20
    assert sorted(name for name in named if not (ROOT / name).exists()) == []


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_to_files(name: str) -> None:
    text = (ROOT / name).read_text("utf-8")
    links = re.findall(r"\]\((?!https?:|#)([^)#\s]+)(?:#([^)\s]+))?\)", text)
    assert links
    assert [path for path, _ in links if not (ROOT / path).exists()] == []
    for path, anchor in links:
        if anchor:
            headings = re.findall(r"^#+ (.*)$", (ROOT / path).read_text("utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text("utf-8")
_PAGES = ("docs/architecture.md", "CONTRIBUTING.md", "docs/contributing/additions.md", "docs/contributing/tests.md")
PAGES = {page: (ROOT / page).read_text("utf-8") for page in _PAGES}


def test_the_architecture_page_lists_every_room_with_its_sentence() -> None:
    rooms = {
        str(path.parent.relative_to(ROOT)): ast.get_docstring(ast.parse(path.read_text("utf-8")))
        for package in ("fleet", "agents", "world", "netem")
        for path in (ROOT / package).rglob("__init__.py")
    }
    rows = re.findall(r"^\| `((?:fleet|agents|world|netem)[a-z0-9_/]*)` \| (.*) \|$", ARCHITECTURE, re.MULTILINE)
    assert dict(rows) == rooms


def test_the_page_of_limits_has_every_limit() -> None:
    assert table() in (ROOT / "docs/reference/limits.md").read_text("utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_modules_and_functions_that_a_page_names_exist(page: str) -> None:
    """`module.py` is a file, and in `module.py: Class.method, function` the module defines each name."""
    missing = []
    named = re.findall(r"`((?:fleet|agents|world|netem|tests|docs)/[\w/.-]*)(?:: ([\w., ]+))?`", PAGES[page])
    assert len(named) > 10
    for path, names in named:
        if not (ROOT / path).exists():
            missing.append(path)
        elif names:
            defined = set()
            for node in ast.parse((ROOT / path).read_text("utf-8")).body:
                if isinstance(node, ast.ClassDef | ast.FunctionDef):
                    defined.add(node.name)
                    inner = node.body if isinstance(node, ast.ClassDef) else []
                    defined |= {f"{node.name}.{each.name}" for each in inner if isinstance(each, ast.FunctionDef)}
                elif isinstance(node, ast.Assign | ast.AnnAssign):
                    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                    defined |= {target.id for target in targets if isinstance(target, ast.Name)}
            missing += [f"{path}: {name}" for name in names.split(", ") if name not in defined]
    assert missing == []


COMMAND = re.compile(r"(?:^|`|&& |\| |bin/)fleet ([a-z][^`#\n|&]*)", re.MULTILINE)
PAGES_OF_THE_SITE = [page for page in sorted(ROOT.glob("docs/*/**/*.md")) if "_build" not in page.parts]
WITH_COMMANDS = {
    path: COMMAND.findall((ROOT / path).read_text("utf-8"))
    for path in ["README.md", "CONTRIBUTING.md", *(str(p.relative_to(ROOT)) for p in PAGES_OF_THE_SITE)]
}


def test_commands_that_pages_give_exist() -> None:
    """Every `fleet VERB` is a command, and every option behind it is one of its options."""
    unknown = []
    assert sum(map(len, WITH_COMMANDS.values())) > 200
    for page, text in ((page, text) for page, texts in WITH_COMMANDS.items() for text in texts):
        command: click.Command = cli
        for word in text.split():
            if not isinstance(command, click.Group) or word.startswith("-"):
                break
            below = command.get_command(click.Context(command), word)
            if below is None:
                unknown += [] if command.invoke_without_command else [f"{page}: {text}"]
                break
            command = below
        options = {option for each in command.params for option in (*each.opts, *each.secondary_opts)} | {"--help"}
        unknown += [
            f"{page}: {text}: {name}" for name in re.findall(r"(?<!\S)--[a-z][a-z0-9-]*", text) if name not in options
        ]
    assert unknown == []


# Options of pip, Dask, pytest, ROS 2 and a script of the tests; and one that a page mistypes on purpose.
OF_OTHERS = {
    "--no-build-isolation", "--no-dashboard", "--nthreads", "--source", "--fleet-keep", "--start-offset",
    "--start-paused", "--exclude-topics", "--playback-until-sec", "--jsn", "--hypothesis-seed",
}  # fmt: skip


def options_of(command: click.Command) -> set[str]:
    """The options of a command and of those below it."""
    found = {option for each in command.params for option in (*each.opts, *each.secondary_opts)}
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            found |= options_of(below)
    return found


def test_options_that_pages_name_exist() -> None:
    """In tables and in sentences, also without a command in front."""
    known, unknown = options_of(cli) | {"--help"} | OF_OTHERS, set()
    for page in WITH_COMMANDS:
        text = re.sub(r"```.*?```", "", (ROOT / page).read_text("utf-8"), flags=re.DOTALL)
        unknown |= {f"{page}: {name}" for name in re.findall(r"`(--[a-z][a-z0-9-]*)", text) if name not in known}
    assert unknown == set()


def test_the_page_about_replay_has_every_option_of_what_is_played() -> None:
    rows = re.findall(r"^\| `(--[a-z-]+)[^|]*\|", (ROOT / "docs/guide/replay.md").read_text("utf-8"), re.MULTILINE)
    assert rows == [field.flag for field in fields(PlaybackOptions).values()]


def test_the_page_of_commands_shows_every_verb() -> None:
    shown = re.findall(r"\bfleet ([a-z0-9]+)", (ROOT / "docs/guide/commands.md").read_text("utf-8"))
    assert sorted(set(every_verb()) - set(shown)) == []


def test_the_extra_all_has_every_extra_of_a_user() -> None:
    """Those for tests and for the site are for people who change the code."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    (everything,) = extras["all"]
    names = re.fullmatch(r"uuv-fleet\[(.*)\]", everything)
    assert names and set(names[1].split(",")) == extras.keys() - {"all", "docs", "test", "test-all"}
