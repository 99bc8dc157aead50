"""The studies that ship with the package: their names and their texts."""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable


def shipped_studies() -> list[str]:
    """The names of the studies that come with the package."""
    return sorted(entry.name.removesuffix(".yaml") for entry in _folder().iterdir() if entry.name.endswith(".yaml"))


def study_text(name: str) -> str:
    """The text of a shipped study, with its comments."""
    return (_folder() / f"{name}.yaml").read_text("utf-8")


def _folder() -> Traversable:
    return resources.files("fleet.study.shipped")
