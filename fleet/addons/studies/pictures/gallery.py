"""Every picture of a study: which there are, drawn and written."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain, count
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure

from fleet.addons.pictures.runs import NothingToDraw
from fleet.addons.pictures.style import (
    Drawn,
    Provenance,
    figures,
    save_all,
)
from fleet.addons.studies.borders import Borders, Theory, theory
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.pictures.border import draw_borders
from fleet.addons.studies.pictures.boxes import boxes
from fleet.addons.studies.pictures.curves import curves
from fleet.addons.studies.pictures.heat_maps import heat
from fleet.addons.studies.pictures.marks import (
    MOST_PANELS,
    layout_of,
    spans_much,
)
from fleet.addons.studies.pictures.points import (
    PASSED,
    Points,
    Quantity,
    factors,
    is_share,
    joined,
    load,
)
from fleet.addons.studies.store import Store
from fleet.errors import FleetError, printable
from fleet.mcap.reader import OnProgress

_MOST_PAGES = 8  # pictures of one quantity
_DRAW = {"heat": heat, "curve": curves, "boxes": boxes}


class Picture(NamedTuple):
    """A picture, or why there is none."""

    name: str  # of its file
    title: str
    figure: Figure | str


def draw(points: Points, log_scale: bool | None = None, share: OnProgress = lambda _: None) -> Iterator[Picture]:
    """The pictures of a study, the share that passed first, then the measures, then pairs of runs. `log_scale`: numbers
    have a logarithmic axis; None: numbers of a wide range have one. `share`: called before each picture with the share
    that is done."""
    measures = [name for name in points.numbers if not is_share(name)]
    todo: list[tuple[str, str, Callable[[], Quantity], bool | None]] = []
    if points.product:
        todo = [(name, points.words(name), partial(points.quantity, name), log_scale) for name in points.numbers]
    for place in factors(points):
        for name in measures:
            key = printable(points.dimensions[place].key)
            title = f"{points.words(name)}, values of {key} in pairs of runs with the same seed"
            todo.append((f"compare-{_slug(key)}-{_slug(name)}", title, partial(points.differences, place, name), None))
    taken: set[str] = set()
    if not points.product:
        reason = "its points are a sample and no grid; fleet.open_study(DIR).to_pandas() has every run"
        yield Picture("passed", points.words(PASSED), reason)
    for number, (name, title, quantity, logs) in enumerate(todo):
        share(number / len(todo))
        try:
            for figure in _draw_figures(quantity(), logs):
                yield Picture(_free(_slug(name), taken), title, figure)
        except NothingToDraw as reason:
            yield Picture(printable(name), title, str(reason))


def _draw_figures(quantity: Quantity, log_scale: bool | None) -> Iterator[Figure]:
    numbers = [value for cell in quantity.cells.values() for value in cell.values]
    if not numbers and not any(sum(cell.lack) for cell in quantity.cells.values()):
        raise NothingToDraw("there is no pair of runs")
    equal = not any(numbers) and not any(cell.lack.without for cell in quantity.cells.values())
    if quantity.kind == "difference" and numbers and equal:
        raise NothingToDraw("the runs of every pair are equal in it")
    layout = layout_of(quantity)
    if log_scale is None:
        log_scale = spans_much([cell.estimate.value for cell in quantity.cells.values()])
    for page in range(0, len(layout.panels), MOST_PANELS):
        if page >= _MOST_PAGES * MOST_PANELS:
            raise NothingToDraw(f"only {page} of {len(layout.panels)} combinations are shown")
        yield _DRAW[layout.kind](quantity, layout, layout.panels[page : page + MOST_PANELS], log_scale)


def write(
    stores: Mapping[str, Store],
    measures: Sequence[str],
    folder: Path,
    formats: Sequence[str] = ("png",),
    log_scale: bool | None = None,
    tell: Callable[[str], None] = lambda _: None,
    share: OnProgress = lambda _: None,
) -> list[Path]:
    """Draw studies into a folder, which is made if need be; returns the files. `stores`: by name. `measures`: in
    addition to the share of runs that passed; none: those of the table of `fleet sweep`. `tell`: called with a sentence
    about each picture that could not be drawn. Raises StudyError: there is no such measure, a study is damaged, or they
    vary other things; FleetError: the folder cannot be written."""
    return save_all(_with_origins(stores, measures, log_scale, share), folder, formats, tell)


def plot(
    stores: Mapping[str, Store],
    measures: Sequence[str],
    folder: Path | None,
    formats: Sequence[str],
    log_scale: bool | None = None,
) -> dict[str, Figure]:
    """The figures by name, written into a folder as well, if there is one. The rest is as for `write`."""
    return figures(_with_origins(stores, measures, log_scale, lambda _: None), folder, formats, lambda _: None)


def _with_origins(
    stores: Mapping[str, Store], measures: Sequence[str], log_scale: bool | None, share: OnProgress
) -> Iterator[Drawn]:
    each = [load(store, measures) for store in stores.values()]
    points = each[0] if len(each) == 1 else joined(each, [*stores])
    records = [store.record for store in stores.values()]
    axes = ", ".join(axis.key for axis in records[0].axes) or "none"
    facts = (
        ("scenario", " and ".join(dict.fromkeys(record.scenario for record in records))),
        ("axes", axes),
        ("seeds", " and ".join(str(len(record.seeds)) for record in records)),
    )
    borders = [store for store in stores.values() if len(stores) == 1 and store.record.border is not None]
    drawn = (
        (name, figure, partial(Provenance, title, facts)) for name, title, figure in draw(points, log_scale, share)
    )
    return chain(map(_border, borders), drawn)


def _border(store: Store) -> Drawn:
    """The borders that a study looked for, as `fleet boundary` draws them."""
    borders = Borders(store)
    theories = [Theory(None, None, None)] * borders.count
    with suppress(FleetError):  # a law may not be loaded here; then theory says nothing
        theories = theory(borders)
    try:
        figure: Figure | str = draw_borders(borders, theories)
    except StudyError as reason:
        figure = str(reason)
    return "border", figure, partial(Provenance, borders.title, (("scenario", store.record.scenario),))


def _slug(key: str) -> str:
    return re.sub(r"[^\w.]+", "-", key, flags=re.ASCII).strip("-.")[:120] or "key"


def _free(name: str, taken: set[str]) -> str:
    found = next(each for each in chain([name], (f"{name}-{k}" for k in count(2))) if each not in taken)
    taken.add(found)
    return found
