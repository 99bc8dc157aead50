"""Logs for xarray, pandas and what reads NetCDF: the same numbers, with units and meanings where each looks."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_process_runs import Alone, log_of
from mcap.writer import Writer

import fleet
from fleet.errors import FleetError
from fleet.logs.export import export
from fleet.logs.open_log import Log, Opening
from fleet.logs.schemas import UINT32, MessageField, flat_schema
from fleet.logs.table import columns
from fleet.mcap.reader import LogReadError

# What the files may say: udunits' own, with nothing of ours.
UNITS = {"1", "m", "s", "rad", "N", "N m", "m/s", "rad/s", "1/s"}


@pytest.fixture(scope="module", autouse=True)
def packages() -> None:
    """They take a second to import, so that is not done while the tests are collected."""
    for name in ("pandas", "xarray", "scipy.io"):
        pytest.importorskip(name)


@pytest.fixture(scope="module")
def log(alone: Alone) -> Log:
    """Two seconds with duplicates, so that packets arrive at the same time."""
    links = "network={links: {'*': delay 100ms duplicate 50%}}"
    return fleet.open_log(log_of(alone("paper", "duration=2 s", "checks={}", links)))


def test_a_tree_of_datasets_holds_the_log(log: Log) -> None:
    """Numbers, units and meanings of every topic that is a table; what is no unit of udunits stays in words."""
    tree = log.to_xarray()
    no_numbers = {"transforms", "scene", "faults", "snapshot"}
    assert {node.path.strip("/") for node in tree.subtree if node.data_vars} == set(log) - no_numbers
    state = tree["uuv/1/state"]
    assert np.array_equal(state.z, log["uuv/1/state"].z) and np.array_equal(state.t, log["uuv/1/state"].t)
    assert state.z.attrs == {"units": "m", "long_name": "down", "standard_name": "depth"}
    assert state.t.attrs["units"] == "s" and state.indexes["t"].is_unique
    assert state.attrs["scenario"] == "paper" and state.attrs["Conventions"].startswith("CF-")
    command = tree["uuv/1/command"]
    assert [command[f"tau_{k}"].attrs["units"] for k in range(3)] == ["N", "N m", "N m"]
    mixed = tree["uuv/1/control"].x_0.attrs
    assert "units" not in mixed and mixed["long_name"].endswith("[m/s, rad/s]")


def test_times_that_do_not_rise_are_no_index(log: Log) -> None:
    """Several packets arrive at once."""
    assert (np.diff(log["link/1-2"].t) == 0).any()
    link = log.to_xarray("link/1-2")
    assert link.identical(log.to_xarray()["link/1-2"].to_dataset())
    assert link.fate.dims == ("sample",) and link.t.dims == ("sample",) and not link.indexes
    assert set(link.fate.values.tolist()) == set(log["link/1-2"].fate)
    assert "payload" not in link


def test_a_table_for_pandas_says_its_units(log: Log, tmp_path: Path) -> None:
    """From the log, and from the Parquet that export writes."""
    import pandas as pd

    frame = log.to_pandas("uuv/1/command")
    assert frame.attrs["units"]["t"] == "s" and frame.attrs["units"]["tau_1"] == "N m"
    assert "surge force" in frame.attrs["meanings"]["tau_0"]
    assert np.array_equal(frame.tau_0, log["uuv/1/command"].tau[:, 0])
    export(log, tmp_path, "parquet")
    read = pd.read_parquet(tmp_path / "uuv-1-command.parquet")
    assert read.attrs == frame.attrs and read.equals(frame)
    with pytest.raises(FleetError, match="scene is no table"):
        log.to_pandas("scene")


def test_netcdf_is_what_others_read(log: Log, tmp_path: Path) -> None:
    """By scipy's own reader and by xarray: names, units and numbers, and nothing beside the files that are named."""
    import xarray as xr
    from scipy.io import netcdf_file

    paths = export(log, tmp_path, "netcdf")
    assert {path.name for path in paths} == {path.name for path in tmp_path.iterdir()}
    of_file = {path.name: next(t for t in log if t.replace("/", "-") == path.stem) for path in paths[:-1]}
    for name, topic in of_file.items():
        with netcdf_file(tmp_path / name, mmap=False) as file:
            assert file.Conventions == b"CF-1.11" and file.title == topic.encode() and file.seed == b"1"
            for variable, values in file.variables.items():
                assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", variable)
                unit = getattr(values, "units", b"").decode()
                assert not unit or unit in UNITS, (name, variable, unit)
                assert values.long_name
        with xr.open_dataset(tmp_path / name, engine="scipy") as read:
            for column in columns(log[topic]):
                variable = column.name.replace(".", "_")
                if column.values.dtype == object and any(isinstance(value, bytes) for value in column.values):
                    assert variable not in read
                else:
                    assert read[variable].values.tolist() == column.values.tolist(), (name, variable)


def test_netcdf_of_another_programs_log(tmp_path: Path) -> None:
    """Fields whose names we use ourselves, units that are none, numbers for which NetCDF-3 has no integers."""
    import xarray as xr

    fields = (
        MessageField("t", "V", "volts"),
        MessageField("sample", "furlong", "far"),
        MessageField("large", "1", "", type=UINT32),
    )
    schema = flat_schema("Odd", fields)
    with (tmp_path / "robot.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_schema(schema.name, "protobuf", schema.descriptor_set)
        channel = writer.register_channel("odom", "protobuf", number, {"units": schema.units})
        writer.add_message(channel, 5, schema.message(t=1.0, sample=2.0, large=2**32 - 1).SerializeToString(), 5)
        writer.finish()
    export(fleet.open_log(tmp_path / "robot.mcap"), tmp_path / "t", "netcdf")
    with xr.open_dataset(tmp_path / "t" / "odom.nc", engine="scipy") as read:
        assert set(read.variables) == {"t", "t_", "sample_", "large"}
        assert read["t_"].attrs == {"units": "V", "long_name": "volts"}
        assert read["sample_"].attrs == {"long_name": "far [furlong]"}
        assert read["large"].values.tolist() == [2**32 - 1] and "source" not in read.attrs


def test_what_is_too_large_is_refused(log: Log, tmp_path: Path) -> None:
    """With what to do; nothing is left behind."""
    log = Opening(log.path, most_held=1000).read()
    with pytest.raises(LogReadError, match=r"choose some, as in open_log\(path, \['uuv/\*/state'\]\)"):
        log.to_xarray()
    with pytest.raises(FleetError, match=r"too large for NetCDF .* use --parquet"):
        export(log, tmp_path, "netcdf")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("what", ["to_xarray", "to_pandas", "netcdf", "parquet"])
def test_without_the_packages_a_line_says_what_to_install(
    what: str, log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fleet.logs.table.find_spec", lambda name: None)
    calls: dict[str, Any] = {
        "to_xarray": log.to_xarray,
        "to_pandas": lambda: log.to_pandas("uuv/1/state"),
        "netcdf": lambda: export(log, tmp_path, "netcdf"),
        "parquet": lambda: export(log, tmp_path, "parquet"),
    }
    extra = "parquet" if what == "parquet" else "tables"
    with pytest.raises(FleetError, match=rf"not installed: pip install 'uuv-fleet\[{extra}\]'"):
        calls[what]()
