"""Studies for scripts: `fleet.sweep` and `fleet.boundary` make one, `fleet.open_study` reads one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, count
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from fleet.addons.studies.borders import Border, Borders, OnProgress, border_plan, find_borders, prepare_borders, theory
from fleet.addons.studies.engine import engine_of
from fleet.addons.studies.engine_interface import require_extra
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.measures import CHECK
from fleet.addons.studies.one_run import A_STUDY
from fleet.addons.studies.option_values import BoundaryKeywords, SweepKeywords, keywords, takes
from fleet.addons.studies.pictures.border import write_borders
from fleet.addons.studies.plan import plan_of
from fleet.addons.studies.row import FAILED
from fleet.addons.studies.signal_measures import find_columns
from fleet.addons.studies.spec import BoundarySpec, StudySpec
from fleet.addons.studies.stack_runs import run_stack
from fleet.addons.studies.statistics import Estimate, PairedComparison, compare
from fleet.addons.studies.store import Store
from fleet.addons.studies.study_file import NamedStudy, study_named
from fleet.addons.studies.summary import PointSummary, summarise
from fleet.addons.studies.sweep import Progress, prepare, run_study
from fleet.execution.execute import execute
from fleet.execution.external_agents import uses_wall_clock
from fleet.execution.options import Options
from fleet.notebook import Pictures, html_table
from fleet.result.result import Result
from fleet.scenario.loading import parse_scenario
from fleet.scenario.programs import admit_programs
from fleet.scenario.trust import Policy
from world.plugins.trust import trusting

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


STAMP = "%Y%m%d-%H%M%S"


class Study:
    """A study and its rows, one for each run. Every call reads the files anew: it may still be running."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def __repr__(self) -> str:
        return f"<Study {self.directory}: {self._store.record.scenario} over {', '.join(self.axes) or 'seeds alone'}>"

    def _repr_html_(self) -> str:
        rows = self.summary()
        measures = list(rows[0].medians) if rows else []
        cells = ([*row.values.values(), row.runs, *(row.passed, *row.medians.values())] for row in rows)
        headings = [*self.axes, "runs", "pass rate", *(f"median of {name}" for name in measures)]
        return html_table(repr(self)[1:-1], headings, [[_cell(value) for value in row] for row in cells])

    @property
    def directory(self) -> Path:
        """Where it is."""
        return self._store.directory

    @property
    def axes(self) -> dict[str, str | None]:
        """The keys that are varied, and the unit of each; None: its values are words."""
        return {axis.key: axis.unit for axis in self._store.record.axes}

    @property
    def seeds(self) -> list[int]:
        """The seeds that a point may have, in their order; all points have the same ones if no seed is added."""
        return self._store.seeds

    @property
    def missing(self) -> int:
        """The number of runs that are still to be made, as far as it is known.

        Raises:
            StudyError: the study is damaged.
        """
        return self._store.missing

    def to_pandas(self) -> pd.DataFrame:
        """One row per run, ordered by point and seed; `attrs["units"]` has the unit of each column that has one.

        Raises:
            StudyError: the study is damaged.
        """
        return self._store.frame()

    def to_xarray(self) -> xr.Dataset:
        """The numbers of every run as arrays with `units` as attributes.

        The dimensions are the keys that are varied and `seed`, if every value was run with every other; else `point`
        and `seed`, with the keys as coordinates. A run that was not made is NaN, or None.

        Raises:
            StudyError: the study is damaged.
        """
        frame = self._store.frame()
        units = frame.attrs["units"]
        keys = list(self.axes)
        combinations = frame[keys].drop_duplicates()
        whole = 1
        for key in keys:
            whole *= combinations[key].nunique()
        points = frame["point"].nunique()
        dims = keys if keys and whole == points == len(combinations) else ["point"]
        found: xr.Dataset = frame.drop(columns=["key"]).set_index([*dims, "seed"]).to_xarray()
        if dims == ["point"]:
            coordinates = {key: ("point", frame.groupby("point")[key].first().to_numpy()) for key in keys}
            found = found.drop_vars(keys).assign_coords(coordinates)
        for name in found.variables:
            if str(name) in units:
                found[name].attrs["units"] = units[str(name)]
        return found

    def summary(self, *measures: str) -> list[PointSummary]:
        """The pass rate and the medians of some measures at each point, with 95 % intervals.

        Args:
            measures: names of measures, or signals such as `p95 |error.e|`.

        Returns:
            A row per point, in the order of the points.

        Raises:
            StudyError: there is no such measure, or the study is damaged.
        """
        return summarise(self._store, find_columns(measures, self._store.record.every_column))

    def compare(self, key: str, first: float | str, second: float | str, measure: str) -> PairedComparison:
        """Compare two values of a key run by run: at the same values of all other keys, and with the same seed.

        Args:
            key: that is varied.
            first, second: two of its values, as `to_pandas` has them.
            measure: `passed`, or the name of a measure; with `passed` a smaller one is a run that failed.

        Returns:
            The difference, second minus first, in the unit of the measure, with its interval.

        Raises:
            StudyError: there is no such key, value or measure.
        """
        if key not in self.axes:
            raise StudyError(f"{key} is not varied; {', '.join(self.axes) or 'nothing'} is")
        frame, check = self._store.frame(), self._store.record.check
        values = frame[f"{CHECK}{check}" if check else "passed"]
        if measure != "passed":
            (column,) = find_columns([measure], self._store.record.every_column)
            values = frame[column.name].map(column.number).where(frame["status"] != FAILED)
        if missing := [value for value in (first, second) if value not in set(frame[key])]:
            raise StudyError(f"{key} has no value {missing[0]}; it has {', '.join(map(str, frame[key].unique()))}")
        others = [other for other in self.axes if other != key]
        pairs = frame[[*others, "seed", key]].assign(_values=values)
        table = pairs.pivot(index=[*others, "seed"], columns=key, values="_values").astype(float)
        if not table[[first, second]].notna().all(axis="columns").any():
            same = ", ".join(["seed", *others])
            raise StudyError(
                f"{measure} has no pair: no run at {key}={first} has a partner at {key}={second} with the same {same}"
            )
        return compare(table[first].tolist(), table[second].tolist())

    def plot(
        self,
        measure: str | Sequence[str] = (),
        *,
        out: str | Path | None = None,
        format: str | Sequence[str] = "png",
    ) -> Pictures:
        """Draw pictures of the pass rate and of some measures, as `fleet plot` does.

        Args:
            measure: as `--measure`: one, or a list. Empty: those of `fleet sweep`.
            out: the folder into which they are written as well; None: no file is written.
            format: of the files: `png`, `svg`, `pdf`, or several of them.

        Returns:
            The figures of matplotlib by name. A notebook shows them.

        Raises:
            StudyError: there is no such measure, or the study is damaged.
            FleetError: the folder cannot be written.
        """
        from fleet.addons.pictures.style import words_of  # here, since matplotlib takes a while to load
        from fleet.addons.studies.pictures.gallery import plot

        measures = [measure] if isinstance(measure, str) else measure
        stores = {self._store.record.scenario: self._store}
        return Pictures(plot(stores, measures, None if out is None else Path(out), words_of(format)))

    def rerun(self, point: int | Mapping[str, Any], seed: int, out: Path = Path("runs"), trust: bool = False) -> Result:
        """Make one of its runs again with its log; the digest is that of the row.

        Args:
            point: number of the point, or its values by key.
            seed: seed of the run.
            out: the run's directory is made in this folder.
            trust: run modules, too, that are not installed.

        Returns:
            The result, whose directory has the log.

        Raises:
            StudyError: there is no such point.
            ScenarioError: a law of the scenario may not run.
        """
        rows = self._store.points
        if isinstance(point, Mapping):
            matching = [row for row in rows if all(row.values.get(key) == value for key, value in point.items())]
            if len(matching) != 1:
                raise StudyError(f"{len(matching)} points have {dict(point)}; there are {len(rows)} in all")
            row = matching[0]
        elif 0 <= point < len(rows):
            row = rows[point]
        else:
            raise StudyError(f"there is no point {point}: they are 0 to {len(rows) - 1}")
        record = self._store.record
        changes = [f"seed={seed}"]
        with trusting(trust):
            scenario = parse_scenario(row.scenario, record.scenario, changes, self._store.folder, Policy(A_STUDY))
            if uses_wall_clock(scenario):
                admit_programs(scenario.spec, scenario.reading.policy)
                return run_stack(scenario, out)
        return execute(scenario, Options(out, in_process=True, quiet=True))


def open_study(directory: str | Path) -> Study:
    """The study in a directory that `fleet sweep` made.

    Args:
        directory: the study's own one, which has `study.json`.

    Returns:
        The study, with the runs that were made.

    Raises:
        StudyError: there is none, it is damaged, or the extra `study` is not installed.
    """
    require_extra()
    return Study(Store.open(Path(directory)))


@takes(StudySpec)
def sweep(
    scenario: str | Path,
    vary: Mapping[str, str | Iterable[Any]] = {},
    *,
    out: str | Path | None = None,
    workers: int | None = None,
    scheduler: Any = None,
    trust: bool = False,
    progress: Callable[[Progress], None] = lambda _: None,
    **options: Unpack[SweepKeywords],
) -> Study:
    """Run a scenario at every combination of some values, each with several seeds.

    Args:
        scenario: a shipped name or a file; or a study, which the other arguments change as options do.
        vary: by key the values, as text of the grammar of `fleet sweep --vary` or as a list.
        out: the directory of the new study; None: one below `studies`.
        workers: processes of this machine; None: one per core.
        scheduler: of an existing Dask cluster: an address or a cluster object; None: workers of this machine.
        trust: run modules, too, that are neither installed nor the user's own.
        progress: called several times a second.
        options: these.

    Returns:
        The study, when its runs are made.

    Raises:
        ScenarioError: with the mistakes of all points, or of the file of the study.
        StudyError: the study cannot be made or run.
        RunBroken: its workers cannot be started.
        TypeError: there is no such argument.
    """
    require_extra()
    study = study_named(str(scenario)) or NamedStudy(StudySpec(str(scenario)))
    spec = study.spec.with_options(**keywords(StudySpec, {"vary": vary, **options}))
    directory = new_directory(str(scenario)) if out is None else Path(out)
    with trusting(trust):
        store, modules = prepare(plan_of(spec, study.origin), directory, spec)
    with engine_of(modules, workers, scheduler) as engine:
        run_study(store, engine, progress, modules=modules, timeout_s=spec.timeout_s, budget_s=spec.budget_s)
    return Study(store)


def new_directory(scenario: str, out: Path = Path("studies")) -> Iterator[Path]:
    """Where a new study of a scenario may go, the best place first; the second one of the same second gets a number."""
    first = out / f"{Path(scenario).stem}-{time.strftime(STAMP, time.gmtime())}"
    return chain([first], (first.with_name(f"{first.name}-{number}") for number in count(2)))


def _cell(value: float | str | Estimate) -> str:
    if isinstance(value, Estimate):
        return f"{value.value:.3g}" + ("" if isnan(value.low) else f" ({value.low:.3g} to {value.high:.3g})")
    return value if isinstance(value, str) else f"{value:g}"


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
        """One border per combination of the other axes.

        Raises:
            StudyError: the study is damaged.
        """
        return self._borders.estimates()

    def write_picture(self, trust: bool = False, formats: Sequence[str] = ("png",)) -> Path:
        """Draw the borders, with what theory says of them, as `border.png` in the study's directory.

        Args:
            trust: load modules, too, that are not installed.
            formats: some of `png`, `svg` and `pdf`.

        Returns:
            The file of the first format.

        Raises:
            ScenarioError: a law may not be loaded.
            StudyError: there is too much for one picture, or the file cannot be written.
        """
        with trusting(trust):
            return write_borders(self._borders, theory(self._borders), formats)[0]


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
    progress: OnProgress = lambda *_, **__: None,
    **options: Unpack[BoundaryKeywords],
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

    Returns:
        The borders, when their runs are made.

    Raises:
        ScenarioError: with the mistakes of all points.
        StudyError: the study cannot be made or run.
        TypeError: there is no such argument.
    """
    require_extra()
    spec = BoundarySpec(**keywords(BoundarySpec, {"along": along, "per": per, **options}))
    directory = new_directory(str(scenario)) if out is None else Path(out)
    with trusting(trust):
        store, modules = prepare_borders(border_plan(str(scenario), spec), spec, directory)
    with engine_of(modules, workers, scheduler) as engine:
        find_borders(Borders(store), engine, progress, modules=modules, timeout_s=spec.timeout_s)
    return Boundary(store)
