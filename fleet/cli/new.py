"""The command `fleet new`: a law of your own as a template that runs, with a scenario that uses it."""

from __future__ import annotations

import keyword
import re
from pathlib import Path

import click

from fleet.errors import FleetError

KINDS = ("controller", "guidance", "tracking", "agent")
_IMPORTED = {
    "Any",
    "AgentConfig",
    "Command",
    "Delivery",
    "Nav",
    "PAYLOAD",
    "Sample",
    "Signal",
}  # imported by the templates


class NewFileError(FleetError):
    """The files cannot be written."""


@click.group()
def new() -> None:
    """Begin something of your own from a template."""


@new.command()
@click.argument("name")
@click.option(
    "--kind",
    type=click.Choice(["controller", "guidance", "tracking", "agent"]),
    default="controller",
    show_default=True,
    help="What it replaces: guidance and tracking, one of them, or the whole agent.",
)
@click.option(
    "--dir",
    "folder",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    help="Where to write; by default here.",
)
def controller(name: str, kind: str, folder: Path) -> None:
    """Write NAME.py, a control law that runs as it is, and NAME.yaml, a scenario that uses it.

    \b
    Examples:
      fleet new controller pid
      fleet new controller swarm --kind guidance --dir laws
    """
    law, scenario = write_law(kind, name, folder)
    import shlex

    below = folder.resolve().is_relative_to(Path().resolve())  # a law outside of the current directory needs --trust
    there, file = ("", scenario) if below else (f"cd {shlex.quote(str(folder))} && ", scenario.name)
    click.echo(f"wrote {law} and {scenario}; now: {there}fleet run {shlex.quote(str(file))}")


def write_law(kind: str, name: str, folder: Path) -> tuple[Path, Path]:
    """Write `name`.py and `name`.yaml into `folder`.

    Raises:
        NewFileError: the name is none for a module, belongs to another one, or a file is in the way.
    """
    if not name.isascii() or not name.isidentifier() or keyword.iskeyword(name):
        raise NewFileError(f"{name!r} cannot name a Python module: letters, digits and _, not a digit first")
    written = (folder / f"{name}.py", folder / f"{name}.yaml")
    for path in written:
        if path.exists():
            raise NewFileError(f"{path} is there already; choose another name or --dir")
    if (place := _taken(name)) is not None:
        raise NewFileError(
            f"Python has a module {name!r} already ({place}) and would find that one; choose another name"
        )
    class_name = "".join(part[:1].upper() + part[1:] for part in name.split("_") if part) or "Law"
    class_name += "Law" * (keyword.iskeyword(class_name) or class_name in _IMPORTED)
    from importlib import resources

    templates = resources.files("fleet.templates")
    choice = f"{kind}: {name}:{class_name}"
    other = {"guidance": "tracking: neurodynamic", "tracking": "guidance: optimal"}.get(kind)
    if other is not None:
        choice += f"\n{other}  # the other half is the paper's, with gentle gains\nprofile: hardened"
    values = {"THE_CHOICE": choice, "the_law": name, "TheLaw": class_name}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, template in zip(written, (f"{kind}.py", "scenario.yaml"), strict=True):
            text = (templates / template).read_text("utf-8")
            text = re.sub("|".join(values), lambda match: values[match[0]], text)
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
    except OSError as error:
        raise NewFileError(f"cannot write into {folder}: {error.strerror or error}") from None
    return written


def _taken(name: str) -> str | None:
    """Where `import name` would find a module now; None if it would not."""
    import importlib.util

    try:
        found = importlib.util.find_spec(name)
    except ValueError:  # a module that is loaded, of unknown origin
        return "built in"
    return None if found is None else found.origin or "a folder"


COMMANDS = (new,)
