"""`fleet new`: a law of your own as a template that runs, with a scenario that uses it."""

from __future__ import annotations

import keyword
from importlib import resources
from pathlib import Path

from fleet.errors import FleetError

KINDS = ("controller", "guidance", "tracking", "agent")


class NewFileError(FleetError):
    """The files cannot be written."""


def write_law(kind: str, name: str, folder: Path) -> tuple[Path, Path]:
    """Write `name`.py and `name`.yaml into `folder`.

    Raises:
        NewFileError: the name is none for a module, or a file is in the way.
    """
    if not name.isascii() or not name.isidentifier() or keyword.iskeyword(name):
        raise NewFileError(f"{name!r} cannot name a Python module: letters, digits and _, not a digit first")
    module = name.lower()
    class_name = "".join(part[:1].upper() + part[1:] for part in name.split("_") if part) or "Law"
    written = (folder / f"{module}.py", folder / f"{module}.yaml")
    for path in written:
        if path.exists():
            raise NewFileError(f"{path} is there already; choose another name or --dir")
    templates = resources.files("fleet.templates")
    choice = f"{kind}: {module}:{class_name}"
    other = {"guidance": "tracking: neurodynamic", "tracking": "guidance: optimal"}.get(kind)
    if other is not None:
        choice += f"\n{other}  # the other half is the paper's, with gentle gains\nprofile: hardened"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, template in zip(written, (f"{kind}.py", "scenario.yaml"), strict=True):
            text = (templates / template).read_text("utf-8")
            text = text.replace("THE_CHOICE", choice).replace("the_law", module).replace("TheLaw", class_name)
            path.write_text(text, "utf-8")
    except OSError as error:
        raise NewFileError(f"cannot write into {folder}: {error.strerror or error}") from None
    return written
