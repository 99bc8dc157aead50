"""Studies whose rows are made up: every point is a scenario that could run, and no run is made."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from small_scenario import SMALL

from fleet.addons.studies import row as rows_of
from fleet.addons.studies.plan import Plan
from fleet.addons.studies.store import Store
from fleet.addons.studies.sweep import prepare
from fleet.addons.studies.values import parse_axis
from fleet.scenario.text.overrides import SET, Override

Row = Mapping[str, Any]
LINKS = Override(SET, "network.links={'*': delay 50ms loss 10%}")
LOSS = "network.links.*.loss=0 %, 30 %, 60 %"
DELAY = "network.links.*.delay=50 ms, 200 ms"
CONTROLLER = "controller=nboc, boc"
EXTRAPOLATE = "neighbours.extrapolate=hold, neighbour"


def made_up(
    directory: Path, *axes: str, row: Callable[[Row, int], Row | None], seeds: int = 3, change: str = "name=small"
) -> Store:
    """A study of the small scenario.

    Args:
        axes: what varies, as for `--vary`.
        row: of a point's values and a seed what its row says; None: this run has not been made.
        change: of every run, as for `--set`.
    """
    file = directory.parent / "small.yaml"
    file.write_text(SMALL, "utf-8")
    changes = (LINKS, Override(SET, change))
    plan = Plan(str(file), changes, tuple(map(parse_axis, axes)), seeds=tuple(range(1, seeds + 1)))
    store, _ = prepare(plan, directory)
    rows = []
    for point in store.points:
        for seed in store.record.seeds:
            said = row(point.values, seed)
            if said is not None:
                own = {"key": f"{point.number}-{seed}", "point": point.number, "seed": seed, "wall_s": 0.5}
                rows.append(row_of(own | {"version": "0", "cores": "plain"} | dict(said)))
    store.add(rows)
    return store


def row_of(said: Row) -> rows_of.Row:
    """A row of plain values: its fields, `check.NAME`, and numbers."""
    fields = {key: value for key, value in said.items() if key in rows_of.Row.__struct_fields__}
    checks = {key[6:]: rows_of.CheckRow(value) for key, value in said.items() if key.startswith("check.")}
    numbers = {key: value for key, value in said.items() if key not in fields and not key.startswith("check.")}
    return rows_of.Row(**fields, checks=checks, numbers=numbers)


def damage(directory: Path, *statements: str, values: tuple[Any, ...] = ()) -> None:
    """Change the database of a study behind its back."""
    with closing(sqlite3.connect(directory / "study.sqlite")) as file, file:
        for statement in statements:
            file.execute(statement, values)


def usual(values: Row, seed: int) -> Row:
    """A run that gets worse with the loss and passes below 0.5 m."""
    loss = float(values.get("network.links.*.loss", 20.0))
    final = 0.2 + loss / 100.0 + 0.01 * seed + (0.1 if values.get("controller") == "boc" else 0.0)
    good = final < 0.5
    return {
        "status": "pass" if good else "check_failed", "reason": "", "passed": good, "formation_final_m": final,
        "age_p95_s": 0.1 + loss / 50.0, "loss_share": loss / 100.0, "e_rms_m": final / 2,
    }  # fmt: skip


def with_holes(values: Row, seed: int) -> Row | None:
    """As `usual`, but runs at a loss of 30 % have no result, and of seed 2 are not made; some have no number."""
    if seed == 2:
        return None
    if values.get("network.links.*.loss") == 30.0:
        return {"status": "failed", "reason": "took longer than 1 s"}
    found = dict(usual(values, seed))
    if seed == 3:
        found["formation_final_m"] = float("nan")
    return found
