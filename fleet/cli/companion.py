"""What add-ons bring to a run: a process beside it, such as a page, or another way for its processes to meet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from fleet.cli.declare import Extension, FromAddOns

if TYPE_CHECKING:
    from fleet.execution.options import Options
    from fleet.execution.wiring import Wiring
    from fleet.scenario.scenario import Scenario


class RunCompanion:
    """A companion of one run, which is told of its moments. What it does not define does nothing."""

    def on_run_published(self, directory: Path) -> None:
        """The journal of the run can be read. A run that is not published has none: `prepare` may set `publish`.

        Args:
            directory: the directory of the run.
        """

    def on_run_ended(self, directory: Path) -> None:
        """The run is over, and its directory is whole.

        Args:
            directory: the directory of the run.
        """


class Companion(Extension):
    """What an add-on adds to a run: options of the command, a change of how it is run, and something beside it."""

    commands: ClassVar[tuple[str, ...]] = ("run",)

    def prepare(self, scenario: Scenario, how: Options, one_process: str) -> Options:
        """How to run the scenario, if one of the options was given.

        Args:
            scenario: what is to be run.
            how: what the user and the companions before asked for.
            one_process: which option or key asks for a run in one process; empty: it has several.

        Returns:
            The options with what this companion needs.

        Raises:
            click.UsageError: the options do not go with the run.
            FleetError: something that the options need is missing here.
        """
        return how

    def wire(self, scenario: Scenario, wiring: Wiring, one_process: str) -> Wiring:
        """How the run is connected, if one of the options was given.

        Args:
            scenario: what is to be run.
            wiring: as the companions before have it.
            one_process: as for `prepare`.

        Returns:
            The wiring with what this companion needs.

        Raises:
            FleetError: the options do not go together, or with the scenario.
        """
        return wiring

    @contextmanager
    def start(self, how: Options) -> Iterator[RunCompanion]:
        """What lasts as long as the run, and a little longer, if one of the options was given.

        Args:
            how: the options of the run.

        Yields:
            What is told when the journal can be read, and when the run is over.
        """
        yield RunCompanion()


Companions = Annotated[Sequence[Companion], FromAddOns("companions")]
