"""The YAML files that ship in a package: scenarios, and studies."""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable


class ShippedFiles(NamedTuple):
    """The YAML files of one package; each is called by its name without `.yaml`."""

    package: str

    @property
    def names(self) -> list[str]:
        """All names, sorted."""
        return sorted(
            entry.name.removesuffix(".yaml") for entry in self._folder.iterdir() if entry.name.endswith(".yaml")
        )

    def text(self, name: str) -> str:
        """The text of a file, with its comments."""
        return (self._folder / f"{name}.yaml").read_text("utf-8")

    @property
    def _folder(self) -> Traversable:
        return resources.files(self.package)
