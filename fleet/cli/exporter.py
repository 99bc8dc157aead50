"""What add-ons let `fleet export` write besides tables."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, ClassVar, NamedTuple

from fleet.cli.declare import Extension, FromAddOns


class Selection(NamedTuple):
    """Which topics of a log the user wants."""

    topics: tuple[str, ...]  # patterns such as `uuv/*/state`; empty: all
    exclude: tuple[str, ...]  # patterns


class Exporter(Extension, ABC):
    """Another form of a log.

    Attributes:
        selects: the form has only the topics that the user wants.
        form: the option with its value, for the error if no form was chosen.
    """

    commands: ClassVar[tuple[str, ...]] = ("export",)
    selects: ClassVar[bool] = False
    form: ClassVar[str]

    @property
    @abstractmethod
    def folder(self) -> Path | None:
        """Where it is to be written; None: nowhere."""

    @abstractmethod
    def write(self, log: Path, selection: Selection, *, force: bool) -> Iterable[Path]:
        """Write a log.

        Args:
            log: an MCAP file, the directory of a run, or a bag.
            selection: the topics that are wanted.
            force: replace what is there.

        Returns:
            The files.

        Raises:
            FleetError: it cannot be written.
        """


Exporters = Annotated[Sequence[Exporter], FromAddOns("exporters")]
