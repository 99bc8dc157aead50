"""Borders for scripts: `fleet.boundary` finds them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fleet.notebook import html_table
from fleet.study.border_theory import theory
from fleet.study.borders import Border, Borders, Tell, border_plan, find_borders, prepare_borders
from fleet.study.engine import need_extra
from fleet.study.given import keywords, takes
from fleet.study.local_engine import engine_of
from fleet.study.pictures.border import write_borders
from fleet.study.spec import BoundarySpec
from fleet.study.store import Store
from fleet.study.study import Study, new_directory
from world.plugins.trust import trusting


class Boundary:
    """A study of a border for scripts."""

    def __init__(self, store: Store) -> None:
        self.study = Study(store)  # its rows
        self._borders = Borders(store)

    def __repr__(self) -> str:
        count, scenario = self._borders.count, self._borders.store.record.scenario
        borders = f"{count} border{'' if count == 1 else 's'} of {scenario} along {self._borders.along.key}"
        return f"<Boundary {self.study.directory}: {borders}>"

    def _repr_html_(self) -> str:
        found = self.borders
        unit = f" [{self._borders.along.unit}]" if self._borders.along.unit else ""
        headings = [*(found[0].values if found else ()), f"border{unit}", "interval of 95 %", "", "runs"]
        rows = [
            [*row.values.values(), f"{row.value:.3g}", f"{row.low:.3g} to {row.high:.3g}", row.where, row.runs]
            for row in found
        ]
        return html_table(repr(self)[1:-1], headings, rows)

    @property
    def borders(self) -> list[Border]:
        """One per combination of the other axes. Raises StudyError."""
        return self._borders.found()

    def write_picture(self, trust: bool = False) -> Path:
        """Draw the borders, with what theory says of them, as `border.png` in the study's directory.

        Args:
            trust: load modules, too, that are not installed.

        Raises:
            ScenarioError: a law may not be loaded.
            StudyError: there is too much for one picture, or the file cannot be written.
        """
        with trusting(trust):
            return write_borders(self._borders, theory(self._borders))


@takes(BoundarySpec)
def boundary(
    scenario: str | Path,
    along: str,
    per: Mapping[str, str | Iterable[Any]] | None = None,
    *,
    out: str | Path | None = None,
    workers: int | None = None,
    scheduler: Any = None,
    trust: bool = False,
    progress: Tell = lambda *_, **__: None,
    **options: Any,
) -> Boundary:
    """Find where the pass rate of a scenario falls through a level.

    Args:
        scenario: a shipped name or a file.
        along: the key and range along which the border is sought, such as `network.links.*.loss=0 %..95 %`.
        per: values by key, as `fleet.sweep` has them; each combination has a border of its own.
        out: the directory of the new study; None: one below `studies`.
        workers: processes of this machine; None: one per core.
        scheduler: of an existing Dask cluster: an address or a cluster object; None: workers of this machine.
        trust: run modules, too, that are neither installed nor the user's own.
        progress: called several times a second.
        options: these.

    Raises:
        ScenarioError: with the mistakes of all points.
        StudyError: the study cannot be made or run.
        TypeError: there is no such argument.
    """
    need_extra()
    spec = BoundarySpec(**keywords(BoundarySpec, {"along": along, "per": per, **options}))
    directory = new_directory(str(scenario)) if out is None else Path(out)
    with trusting(trust):
        store, modules = prepare_borders(border_plan(str(scenario), spec), spec, directory)
    with engine_of(workers, scheduler) as engine:
        find_borders(Borders(store), engine, progress, modules=modules, timeout_s=spec.timeout_s)
    return Boundary(store)
