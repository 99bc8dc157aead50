"""Tables of a log for xarray and pandas, with units and meanings as their users expect them.

The attributes of a Dataset follow the CF conventions: `units` that udunits accepts, `long_name`, and `standard_name`
where CF's table has one for exactly that. Simulated time has no date, so `t` is a number of seconds and none of CF's
time coordinates, which count from a date. It is the coordinate if it rises from row to row. If not, as for packets that
arrive at the same time, `sample` numbers the rows.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fleet.errors import FleetError
from fleet.logs.topic import Topic
from fleet.mcap.reader import LogReadError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
from fleet.logs.table import TableColumn, columns, fits, require

CONVENTIONS = "CF-1.11"
EXTRA = "tables"
# The units that we know udunits to have; a law of the user may state others, which stay in long_name.
_NAMES = "1|m|s|kg|rad|N|J|W|Pa|Hz|K|V|A"
_UNIT = re.compile(rf"({_NAMES})([ /]({_NAMES})([0-9])?)*")
# https://cfconventions.org/standard-names.html; theta is from the horizontal
_STANDARD = {
    (f"uuv_fleet.{state}", column): name
    for state in ("State", "StateWithRoll")
    for column, name in (
        ("z", "depth"),
        ("theta", "platform_pitch_fore_up"),
        ("psi", "platform_orientation"),
        ("phi", "platform_roll_starboard_down"),
    )
}


def dataset(topic: Topic, table: list[TableColumn], run: Mapping[str, str]) -> xr.Dataset:
    """The table of a topic as a Dataset, from columns of (samples,) each, the time first; bytes are left out. `run` is
    what determined the run (`Log.run`). Raises FleetError if xarray is not installed.
    """
    require("a Dataset", ("xarray",), EXTRA)
    import xarray as xr

    time, *fields = table
    rises = bool(np.all(np.diff(time.values) > 0))
    dim = "t" if rises else "sample"
    names = _names([column.name for column in fields])
    kept = {name: column for name, column in zip(names, fields, strict=True) if not column.holds(bytes)}
    found = xr.Dataset(
        {name: (dim, column.values, _attributes(column, topic.schema)) for name, column in kept.items()},
        {"t": (dim, time.values, {"units": "s", "long_name": time.meaning})},
        {"Conventions": CONVENTIONS, "title": topic.name, **_origin(run)},
    )
    found["t"].encoding["_FillValue"] = None  # CF: a coordinate has none
    return found


def tree(path: Path, topics: Iterable[Topic], run: Mapping[str, str], most: int) -> xr.DataTree:
    """The topics of a log that are tables, by their names; as `Log.to_xarray`."""
    require("a DataTree", ("xarray",), EXTRA)
    import xarray as xr

    chosen = [topic for topic in topics if fits(topic)]
    size = sum(topic.size for topic in chosen)
    if size > most:
        raise LogReadError(
            f"{path}: these topics hold {size / 1e6:.0f} MB, more than is held at once: choose some, as in "
            "open_log(path, ['uuv/*/state']), or a part with start, end or every"
        )
    try:
        return xr.DataTree.from_dict({topic.name: dataset(topic, columns(topic), run) for topic in chosen})
    except ValueError as error:  # a log of another program: a topic within another one, with other times
        raise FleetError(f"{path}: these topics do not fit in one tree; choose some by name: {error!s:.200}") from None


def table(topic: Topic, run: Mapping[str, str]) -> xr.Dataset:
    """The table of a topic as a Dataset; as `Log.to_xarray`."""
    return dataset(topic, _table(topic), run)


def _table(topic: Topic) -> list[TableColumn]:
    if not fits(topic):
        raise FleetError(f"{topic.name} is no table: it has no message, or each holds lists of messages")
    return columns(topic)


def frame(topic: Topic) -> pd.DataFrame:
    """The table of a topic as a DataFrame; as `Log.to_pandas`."""
    require("a DataFrame", ("pandas",), EXTRA)
    import pandas as pd

    table = _table(topic)
    found = pd.DataFrame({column.name: column.values for column in table})
    found.attrs.update(frame_attributes(table))
    return found


def frame_attributes(table: list[TableColumn]) -> dict[str, dict[str, str]]:
    return {
        "units": {column.name: column.unit for column in table if column.unit},
        "meanings": {column.name: column.meaning for column in table if column.meaning},
    }


def _origin(run: Mapping[str, str]) -> dict[str, str]:
    """Where a Dataset is from, in CF's words where it has some; of another program's log nothing is known."""
    if "uuv-fleet" not in run:
        return {}
    told = {key: run[key] for key in ("scenario", "seed") if key in run}
    return {"source": f"uuv-fleet {run['uuv-fleet']}, a simulation", **told}


def _attributes(column: TableColumn, schema: str) -> dict[str, Any]:
    known = _UNIT.fullmatch(column.unit) is not None
    unit = f" [{column.unit}]" if column.unit and not known else ""
    found = {"long_name": f"{column.meaning or column.name}{unit}"}
    if known:
        found["units"] = column.unit
    standard = _STANDARD.get((schema, column.name))
    return found | ({"standard_name": standard} if standard else {})


def _names(names: list[str]) -> list[str]:
    """The same as CF asks for: letters, digits and underscores, a letter first, none twice, and none that we use."""
    taken = {"t", "sample"}
    found = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
        plain = plain if plain[:1].isalpha() else f"f_{plain}"
        while plain in taken:
            plain += "_"
        taken.add(plain)
        found.append(plain)
    return found
