"""A live run's journal as a log: what is no message of it, and what did not come, is told."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgpack
import pytest
from small_scenario import SMALL

import fleet
from fleet.addons.robots.run_log import RunLogWriter
from fleet.errors import FleetError
from fleet.logs.schemas import flat_schema, signal_columns
from fleet.replay.topics import Stamp, pack
from fleet.scenario.sections.signals import STATE
from netem.wire.keys import Keys
from netem.wire.open_bus import ZenohSample

KEYS = Keys("0a1b2c3d")


def bus() -> Any:
    schema = flat_schema("State", signal_columns(STATE))
    told = {
        KEYS.topics: msgpack.packb({"uuv/1/state": schema.name}),
        KEYS.schema("*"): schema.descriptor_set,
        KEYS.units: msgpack.packb({schema.name: schema.units}),
        KEYS.scenario: SMALL.encode(),
    }
    named = {KEYS.schema("*"): KEYS.schema(schema.name)}
    return SimpleNamespace(ask=lambda key: {named.get(key, key): told[key]} if key in told else {})


def sample(number: int, attachment: bytes | None = None, topic: str = "uuv/1/state") -> ZenohSample:
    data = flat_schema("State", signal_columns(STATE)).message(x=float(number)).SerializeToString()
    stamp = pack(Stamp(number * 10**7, number * 10**7, number, number)) if attachment is None else attachment
    return ZenohSample(KEYS.log(topic), data, False, "application/protobuf;uuv_fleet.State", stamp, None)


def test_each_message_is_there_once_with_its_time(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    writer = RunLogWriter(path, bus(), KEYS)
    for number in (2, 3, 5):
        writer.add(sample(number), 1)
    for strange in (sample(6, b"no stamp"), sample(7, topic="uuv/9/state"), sample(8, b"")):
        writer.add(strange, 1)
    writer.close()
    assert (writer.samples, writer.foreign) == (3, 3)
    assert writer.lacks == "messages of the run that are missing: 2 before the recorder came, 1 on the way"
    log = fleet.open_log(path)
    assert log["uuv/1/state"].t.tolist() == [0.02, 0.03, 0.05] and log["uuv/1/state"].x.tolist() == [2.0, 3.0, 5.0]
    assert log.scenario.vehicles == 3 and log.run["tick_ns"] == str(log.scenario.tick_ns)


def test_nothing_is_replaced_and_a_run_that_does_not_answer_is_told(tmp_path: Path) -> None:
    (tmp_path / "there").write_text("mine")
    with pytest.raises(FleetError, match="exists already"):
        RunLogWriter(tmp_path / "there", bus(), KEYS)
    with pytest.raises(FleetError, match="nobody says what is published"):
        RunLogWriter(tmp_path / "new", SimpleNamespace(ask=lambda _: {}), KEYS)  # type: ignore[arg-type]
    assert not (tmp_path / "new").exists()
