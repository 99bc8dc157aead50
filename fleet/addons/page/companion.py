"""The page beside a run: `fleet run --view`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import click

from fleet.cli.companion import Companion, RunCompanion
from fleet.cli.documents.output import json_is_asked
from fleet.option import Option

if TYPE_CHECKING:
    from fleet.addons.page.page_process import PageProcess
    from fleet.execution.options import Options
    from fleet.scenario.scenario import Scenario


@dataclass(frozen=True, slots=True)
class PageOptions:
    """The options of `fleet run` for the page."""

    view: Annotated[bool, Option(
        "Open a page in the browser that shows the run; there you can also disturb it.")] = False  # fmt: skip


class PageCompanion(Companion):
    """The page in the browser, served by a process beside the run."""

    options_type = PageOptions
    commands: ClassVar[tuple[str, ...]] = ("run", "netem")

    def prepare(self, scenario: Scenario, how: Options, one_process: str) -> Options:
        """The run is published, since the page reads its journal. Raises UsageError: it runs in one process."""
        if one_process:
            raise click.UsageError(
                f"--view needs a run with processes, so not with {one_process}; fleet view shows its log afterwards"
            )
        return replace(how, publish=True)

    @contextmanager
    def start(self, how: Options) -> Iterator[RunCompanion]:
        """The page. On a terminal it stays until Ctrl-C when the run is over."""
        from fleet.addons.page.page_process import PageProcess
        from fleet.addons.page.server import Browser, open_listener

        listener = open_listener()
        click.echo(f"the run in the browser: {listener.address}", err=True)
        with closing(PageProcess(listener)) as page, closing(Browser(listener.address)) as browser:
            browser.open()
            yield _RunPage(page)
            stays = not (how.quiet or json_is_asked())
            if stays and sys.stdin.isatty() and sys.stderr.isatty():
                click.echo("the page stays as it is; Ctrl-C ends it", err=True)
                with suppress(KeyboardInterrupt):
                    page.wait()


class _RunPage(RunCompanion):
    def __init__(self, page: PageProcess) -> None:
        self._page = page

    def on_run_published(self, directory: Path) -> None:
        self._page.on_run_published(directory)

    def on_run_ended(self, directory: Path) -> None:
        self._page.on_run_ended(directory)
