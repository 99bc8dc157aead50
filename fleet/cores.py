"""Whether the cores of world, agents and netem are compiled (the bytes of a run are the same), and on what they run."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

_CORE = "world.dynamics"  # one core stands for all: either all are compiled, or none
_NOTE = Path(__file__).with_name("not_compiled.txt")  # .packaging/build_backend.py writes it into a wheel


def cores() -> str:
    """`compiled`, or `plain Python`."""
    spec = find_spec(_CORE)
    return "plain Python" if spec is None or (spec.origin or "").endswith(".py") else "compiled"


def cores_and_reason() -> str:
    """`compiled`, or `plain Python` and why."""
    found = cores()
    if found == "compiled":
        return found
    try:
        reason = f"at the installation: {_NOTE.read_text('utf-8').strip()}"
    except OSError:
        reason = "these are sources, as an editable install uses them"
    return f"{found} ({reason})"


def hidden_cores() -> str:
    """Words on compiled cores that are installed and not used, because sources come before them; "": there are none.

    A script that lies in a checkout imports the checkout, and runs at about half the speed.
    """
    if cores() == "compiled":
        return ""
    from importlib.metadata import distributions  # here, because it takes longer than the rest of `fleet --help`

    for installed in distributions(name="uuv-fleet"):
        for file in installed.files or ():
            if str(file).startswith(_CORE.replace(".", "/") + ".") and file.suffix != ".py":
                spec = find_spec(_CORE)
                sources = Path(spec.origin).parents[1] if spec is not None and spec.origin else "the sources"
                compiled = Path(str(installed.locate_file(file))).parents[1]
                return (
                    f"these are the sources in {sources}, in plain Python; the compiled install in {compiled} is about "
                    "twice as fast: start from another folder, or move the script out of the checkout"
                )
    return ""


def processor() -> str:
    """Name of the processor; empty: the system does not say."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            lines = [line for line in file if line.startswith("model name")]
    except OSError:
        return ""
    return lines[0].partition(":")[2].strip() if lines else ""


def machine() -> str:
    """The kind of processor, its name, and the C library: another machine may round differently."""
    try:
        library = os.confstr("CS_GNU_LIBC_VERSION") or ""
    except ValueError:
        library = "not glibc"
    return ", ".join(filter(None, (os.uname().machine, processor(), library)))
