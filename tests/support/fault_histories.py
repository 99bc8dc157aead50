"""Canned histories of the lockstep with faults, and the faults that a log tells."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from fleet.scenario.loading import load_scenario
from world.config import WorldConfig
from world.lockstep import Lockstep, NavTo
from world.lockstep import Out as WorldOut


def drive(lockstep: Lockstep, until: int, answer: set[int]) -> list[WorldOut]:
    """Grant, and answer the navs of the living until nothing more happens."""
    from netem.wire.messages import Command

    seen: list[WorldOut] = []
    todo = lockstep.grant(until)
    while todo:
        out = todo.pop(0)
        seen.append(out)
        if isinstance(out, NavTo) and out.id in answer:
            todo += lockstep.command(out.id, Command(out.nav.incarnation, out.nav.tick, (1.0, 0.0, 0.0), ()))
    return seen


def world(**changes: Any) -> WorldConfig:
    from dataclasses import replace

    config = load_scenario("paper", ["duration=500 ms", "checks={}"]).world_config
    config = replace(config, vehicles=tuple(replace(v, telemetry_size=None) for v in config.vehicles))
    return replace(config, **changes)


def told(directory: Path) -> list[tuple[float, str, str]]:
    """(time [s], fault, begins or ends) of every fault in a run's log."""
    with (directory / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [(m.log_time / 1e9, d.fault, d.action) for _, _, m, d in reader.iter_decoded_messages(["faults"])]


EVERYTHING = (
    "faults=[{at: 310 ms, for: 200 ms, kill: 3}, {at: 600 ms, for: 250 ms, pause: '1, 4'}, {at: 900 ms, kill: '2-3', "
    "for: 400 ms}, {at: 1 s, for: 300 ms, kill: 3}, {at: 1.2 s, for: 400 ms, slow: {vehicles: 1, by: 7 ticks}}, "
    "{at: 1.3 s, gust: {velocity: 0.3 0 0 m/s, over: 500 ms}}, {at: 1.5 s, pause: 2}, {at: 1.6 s, up: '*'}, "
    "{at: 1.4 s, for: 400 ms, clock: {vehicles: 2, step: 30 ms, drift: -900 ppm}}, "
    "{at: 1 s, current: {sigma: 5 5 0 cm/s, time_constant: 2 s}}, {at: 0 s, dropout: {probability: 30 %}}]"
)
