"""Whether the packages `agents`, `world` and `netem` are those of this distribution: others use these names, too.

A distribution that brings a package of the same name overwrites files of ours, or is found before ours. Only the first
line of each package is read, so that nothing of somebody else's runs; who it is is looked up when something is wrong.
"""

from __future__ import annotations

from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from typing import Any

OURS = "uuv-fleet"
# How the __init__.py of each begins: their docstrings.
_BEGINS = {"agents": b'"""Agents: ', "world": b'"""The sea: ', "netem": b'"""The network: '}
_DO = f"install {OURS} into an environment of its own: uv tool install, or pipx install"


def foreign() -> str:
    """Look for a package that another distribution has replaced.

    Returns:
        One line that names the package, its distribution and the remedy; "" if all packages are ours.
    """
    for name, begin in _BEGINS.items():
        spec = find_spec(name)
        if spec is None or not _begins(spec, begin):
            return f"the package {name}{_place(spec)} is {_whose(name)}; {_DO}"
    return ""


def damaged(error: ImportError) -> str:
    """The same of an import that failed within one of the packages, compiled or not; "" if it was another import."""
    name = (error.name or "").partition(".")[0]
    if name.endswith("__mypyc"):
        return f"the compiled cores cannot be loaded: {error}; install {OURS} here, or with UUV_FLEET_COMPILE=no"
    if name not in _BEGINS:
        return ""
    return f"the package {name}{_place(find_spec(name))} is {_whose(name)}: {error}; {_DO}"


def _begins(spec: ModuleSpec, begin: bytes) -> bool:
    loader: Any = spec.loader  # of a file or of a zip file
    if spec.origin is None or not hasattr(loader, "get_data"):
        return False  # a folder without __init__.py, for instance
    if not spec.origin.endswith(".py"):
        return True  # only compiled, so there is no text to read
    return bool(loader.get_data(spec.origin).startswith(begin))


def _place(spec: ModuleSpec | None) -> str:
    places = list(spec.submodule_search_locations or []) if spec is not None else []
    return f" in {places[0]}" if places else ""


def _whose(name: str) -> str:
    """The installer of the package, in words."""
    from importlib.metadata import packages_distributions

    others = sorted(set(packages_distributions().get(name, [])) - {OURS})
    return f"that of {' and '.join(others)}, or mixed with it" if others else f"not that of {OURS}, or not whole"
