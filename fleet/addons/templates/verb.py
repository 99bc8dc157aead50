"""The command `fleet new`: a law, protocol, program, check or vehicle with a scenario, or a scenario, that run."""

from __future__ import annotations

import importlib.util
import keyword
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal

import click

from fleet.cli.completion import scenarios
from fleet.cli.declare import command
from fleet.cli.group import ListingGroup
from fleet.cli.types import FOLDER
from fleet.errors import FleetError
from fleet.option import Option

Kinds = Literal["controller", "guidance", "tracking", "agent"]
_IMPORTED = {
    "Any", "AgentConfig", "Command", "Delivery", "Facts", "FormationAgent", "Failure", "Nav", "KIND", "PAYLOAD",
    "PayloadError", "PlantConfig", "Sample", "Sequence", "Signal", "Telemetry", "Tick", "Vec3", "Vec6", "Water",
}  # by the templates  # fmt: skip
InFolder = Annotated[Path, FOLDER, Option("Where to write.", flag="--dir")]


@click.group(cls=ListingGroup)
def new() -> None:
    """Begin something of your own from a template."""


@command(group=new)
def controller(
    name: str,
    *,
    kind: Annotated[Kinds, Option(
        "What it replaces: guidance and tracking, one of them, or the whole agent.")] = "controller",
    folder: InFolder = Path(),
) -> None:  # fmt: skip
    """Write NAME.py, a control law that runs as it is, and NAME.yaml, a scenario that uses it.

    \b
    Examples:
      fleet new controller pid
      fleet new controller swarm --kind guidance --dir laws
    """
    choice = f"{kind}: {name}:{_class_name(name, 'Law')}"
    other = {"guidance": "tracking: neurodynamic", "tracking": "guidance: optimal"}.get(kind)
    if other is not None:
        choice += f"\n{other}  # the other half is the paper's, with gentle gains\nprofile: hardened"
    _write_modules(name, folder, {".py": f"{kind}.py", ".yaml": "law.yaml"}, "Law", {"THE_CHOICE": choice})


@command(group=new)
def check(name: str, *, folder: InFolder = Path()) -> None:
    """Write NAME.py, a check of your own that runs as it is, and NAME.yaml, a scenario that uses it.

    \b
    Examples:
      fleet new check too_near
      fleet new check one_leader --dir checks
    """
    _write_modules(name, folder, {".py": "check.py", ".yaml": "check.yaml"}, "Check")


@command(group=new)
def protocol(name: str, *, folder: InFolder = Path()) -> None:
    """Write NAME.py, a protocol that runs as it is, NAME_check.py, a check of its promise, and NAME.yaml, a scenario.

    \b
    Examples:
      fleet new protocol gossip
      fleet new protocol gossip --dir protocols
    """
    templates = {".py": "protocol.py", "_check.py": "protocol_check.py", ".yaml": "protocol.yaml"}
    _write_modules(name, folder, templates, "Protocol")


@command(group=new)
def plant(name: str, *, folder: InFolder = Path()) -> None:
    """Write NAME.py, a vehicle in six degrees of freedom that runs as it is, and NAME.yaml, a scenario that uses it.

    \b
    Examples:
      fleet new plant glider
      fleet new plant glider --dir vehicles
    """
    _write_modules(name, folder, {".py": "plant.py", ".yaml": "plant.yaml"}, "Plant")


@command(group=new)
def program(name: str, *, folder: InFolder = Path()) -> None:
    """Write NAME.py, a zenoh program that knows nothing of us, and the files that run it in lockstep and on a network.

    \b
    Examples:
      fleet new program greatest
      fleet new program greatest --dir programs
    """
    templates = {".py": "program.py", "_stack.yaml": "program_stack.yaml", ".yaml": "program.yaml"}
    _write_modules(name, folder, templates, "Program")


@command(group=new)
def scenario(
    name: str,
    *,
    shipped: Annotated[str | None, scenarios, Option(
        "Begin with a scenario that ships with the package; see fleet list.", "SHIPPED", "--from")] = None,
    folder: InFolder = Path(),
) -> None:  # fmt: skip
    """Write NAME.yaml, a commented scenario that runs and passes as it is.

    \b
    Examples:
      fleet new scenario harbour
      fleet new scenario river --from rough-sea --dir scenarios
    """
    written = write_scenario(name, shipped, folder)
    file = shlex.quote(str(written))
    click.echo(f"wrote {written}; now: fleet check {file} && fleet run {file}")


def write_scenario(name: str, shipped: str | None, folder: Path) -> Path:
    """Write `name`.yaml into `folder`.

    `shipped`: the name of the shipped scenario that is copied; None: the template. Raises FleetError: the name is none
    for a scenario, there is no such shipped one, or a file is in the way.
    """
    from importlib import resources

    from fleet.scenario.catalogue import shipped_scenarios, shipped_text
    from fleet.scenario.text.yaml_reader import resolve
    from netem.parsing import nearest

    if not re.fullmatch(r"[a-z0-9][a-z0-9_-]{0,63}", name):
        raise FleetError(
            f"{name!r} cannot name a scenario: lower-case letters, digits, - and _, a letter or a digit first"
        )
    if shipped is None:
        text = (resources.files("fleet.addons.templates") / "scenario.yaml").read_text("utf-8")
    elif shipped in (known := shipped_scenarios()):
        text = shipped_text(shipped)
    else:
        hint = nearest(shipped, known) or "fleet list shows them all"
        raise FleetError(f"--from {shipped}: there is no such shipped scenario; {hint}")
    as_text = name if resolve(name) == name else f'"{name}"'  # a scenario may be called 007
    path = folder / f"{name}.yaml"
    _write(folder, {path: re.sub(r"(?m)^name: \S+", f"name: {as_text}", text)})
    return path


def _class_name(name: str, kind: str) -> str:
    class_name = "".join(part[:1].upper() + part[1:] for part in name.split("_") if part) or kind
    return class_name + kind * (keyword.iskeyword(class_name) or class_name in _IMPORTED)


def _write_modules(
    name: str, folder: Path, templates: Mapping[str, str], kind: str, more: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Write modules and a scenario from templates, and say what to type now.

    In these, the_law and TheLaw stand for names; `more` gives further replacements.

    `templates`: by what follows `name` in the name of the file. Raises FleetError: the name is none for a module,
    belongs to another one, or a file is in the way.
    """
    if not name.isascii() or not name.isidentifier() or keyword.iskeyword(name):
        raise FleetError(f"{name!r} cannot name a Python module: letters, digits and _, not a digit first")
    written = [folder / f"{name}{suffix}" for suffix in templates]
    _refuse_existing(written)
    for module in (path.stem for path in written if path.suffix == ".py"):
        if (place := _importable_place(module)) is not None:
            raise FleetError(
                f"Python has a module {module!r} already ({place}) and would find that one; choose another name"
            )
    from importlib import resources

    values = {**more, "the_law": name, "TheLaw": _class_name(name, kind)}
    texts = {}
    for path, template in zip(written, templates.values(), strict=True):
        text = (resources.files("fleet.addons.templates") / template).read_text("utf-8")
        texts[path] = re.sub("|".join(values), lambda match: values[match[0]], text)
    _write(folder, texts)
    *modules, scenario = written
    below = folder.resolve().is_relative_to(Path().resolve())  # a module outside of the current directory needs --trust
    there, file = ("", scenario) if below else (f"cd {shlex.quote(str(folder))} && ", scenario.name)
    click.echo(f"wrote {', '.join(map(str, modules))} and {scenario}; now: {there}fleet run {shlex.quote(str(file))}")


def _refuse_existing(paths: Iterable[Path]) -> None:
    for path in paths:
        if path.exists():
            raise FleetError(f"{path} is there already; choose another name or --dir")


def _write(folder: Path, texts: Mapping[Path, str]) -> None:
    _refuse_existing(texts)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, text in texts.items():
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
    except OSError as error:
        raise FleetError(f"cannot write into {folder}: {error.strerror or error}") from None


def _importable_place(name: str) -> str | None:
    """Where `import name` would find a module now; None if it would not."""
    try:
        found = importlib.util.find_spec(name)
    except ValueError:  # a module that is loaded, of unknown origin
        return "built in"
    return None if found is None else found.origin or "a folder"
