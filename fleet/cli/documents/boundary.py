"""The output of `fleet boundary --json`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct

from fleet.cli.documents.study import SometimesReached, sometimes

if TYPE_CHECKING:  # they need the extra `study`, and `fleet schema` does not
    from fleet.study.borders import Border, Borders
    from fleet.study.statistics import Estimate


class PassRate(Struct):
    """A share of runs that passed, with its Wilson interval of 95 %."""

    value: Annotated[float | None, Meta(description="The share; null: no run was made there.")]
    low: Annotated[float | None, Meta(description="Of its interval.")]
    high: Annotated[float | None, Meta(description="Likewise.")]
    runs: Annotated[int, Meta(description="Runs with a verdict.")]


class BorderFound(Struct):
    """Where the pass rate falls through the level, at one combination of the other keys."""

    values: Annotated[dict[str, float | str], Meta(description="Of the other keys, in their units.")]
    where: Annotated[str, Meta(description="`within` the range, `below` it, `above` it, or `open`: not known.")]
    value: Annotated[float | None, Meta(description="The border; null: it is outside.")]
    low: Annotated[float | None, Meta(description="Of its interval of 95 %; null: beyond the range.")]
    high: Annotated[float | None, Meta(description="Likewise.")]
    runs: Annotated[int, Meta(description="Runs with a verdict.")]
    failed: Annotated[int, Meta(description="Runs without a result.")]
    first: Annotated[PassRate, Meta(description="At the low end of the range.")]
    last: Annotated[PassRate, Meta(description="At the high end.")]
    rising: Annotated[
        tuple[float, float] | None, Meta(description="Values between which the pass rate rises, beyond chance.")
    ]


class BoundaryFound(Struct):
    """`fleet boundary --json`: the borders of a scenario."""

    directory: Annotated[str, Meta(description="Of the study, which has all runs.")]
    scenario: Annotated[str, Meta(description="Its name.")]
    along: Annotated[str, Meta(description="The key along which the border is looked for.")]
    unit: Annotated[str, Meta(description="Its unit.")]
    units: Annotated[dict[str, str | None], Meta(description="Of the other keys; null: their values are words.")]
    level: Annotated[float, Meta(description="The pass rate at the border.")]
    picture: Annotated[str | None, Meta(description="File of the picture; null: there is too much for one.")]
    borders: Annotated[list[BorderFound], Meta(description="One per combination of the other keys.")]
    sometimes: Annotated[list[SometimesReached], Meta(description="What some run must reach, by check.")]


def boundary_document(borders: Borders, found: Sequence[Border], picture: str | None) -> BoundaryFound:
    """The document of a study of a border."""
    store = borders.store
    return BoundaryFound(
        str(store.directory), store.record.scenario, borders.along.key, borders.along.unit or "",
        {axis.key: axis.unit for axis in store.record.axes[:-1]}, borders.record.level, picture,
        [
            BorderFound(row.values, row.where, row.value, row.low, row.high, row.runs, row.failed,
                        _rate(row.first), _rate(row.last), row.rising)
            for row in found
        ],
        sometimes(store),
    )  # fmt: skip


def _rate(rate: Estimate) -> PassRate:
    return PassRate(rate.value, rate.low, rate.high, rate.runs)
