"""The recorder packs the messages of a tick at once: the log must be the one that is written message by message."""

from __future__ import annotations

import random
import sys
import tempfile
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from hypothesis import given
from hypothesis import strategies as st
from plain_messages import Copy, Entry, encoded
from small_scenario import small

from benchmarks.plain_log import PlainLog
from benchmarks.recorder import Calls
from fleet.logs.schemas import COMMAND, ERROR, FAULT, PACKET, ROLL, STATE, flat_schema, signal_columns, stamp_of
from fleet.mcap.reader import LogReader
from fleet.recorder import tick_messages
from fleet.recorder.log_file import LogFile, NoLog
from fleet.recorder.metrics import VehicleError
from fleet.recorder.transforms import quaternion
from fleet.recorder.writer import LogWriter
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.fault_entry import vehicle_entry
from fleet.scenario.sections.log_rates import LOG_GROUPS
from fleet.scenario.sections.signals import OF_THE_PLANT
from fleet.scenario.sections.timeline import Event
from netem.cause import Cause
from netem.wire.messages import Command, Fate, Frame, VehicleFrame
from world.signal import width_of

# Every vehicle another law, whose signals are not the others'.
PLANT = "per_vehicle={'2': {vehicle: {plant: 'own_plants:Rolling'}}}"  # and one of them a plant
LAWS = "per_vehicle={'1': {controller: boc}, '2': {controller: bsmc}, '3': {tracking: sliding-mode}}"
TICKS = 300  # of 10 ms
RATES = st.sampled_from([1, 1, 2, 3])
VALUES = (0.0, -0.0, 1.0, -1e-300, 3.141592653589793, 2.0**60, float("inf"), float("nan"))


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    rates = {group: f"{draw(RATES)} ticks" for group in LOG_GROUPS}
    rates |= {group: f"{draw(st.integers(0, 3))} ticks" for group in ("transforms", "scene")}
    return small("duration=3 s", f"log={rates}", *draw(st.sampled_from([(), (LAWS,), (PLANT,)])))


class Drawn:
    """What a journal may tell a log writer, from a seed."""

    def __init__(self, scenario: Scenario, seed: int, *, whole: bool | None = None) -> None:
        """`whole`: nobody misses anything; None: drawn, too."""
        self._scenario, self._draw = scenario, random.Random(seed)
        self._whole = self._draw.random() < 0.5 if whole is None else whole

    def calls(self) -> Calls:
        """Ticks about the border of a second, or of the run; some with packets and faults before them."""
        draw = self._draw
        begin = draw.choice([0, 20, 90, 190, 288])
        calls = Calls()
        for tick in range(begin, min(TICKS + 1, begin + draw.randint(1, 25))):
            for _ in range(draw.choice([0, 0, 1, 4])):
                calls.packet(self._fate(tick))
            if draw.random() < 0.1:
                calls.event(Event(tick, "f", draw.choice(["begins", "ends"]), "kill 2", vehicle_entry("kill", 2)))
            calls.frame(*self.frame(tick))
        return calls

    def _some(self) -> bool:
        return self._whole or self._draw.random() < 0.7

    def _reals(self, count: int) -> tuple[float, ...]:
        draw = self._draw
        return tuple(draw.choice(VALUES) if draw.random() < 0.2 else draw.gauss(0.0, 100.0) for _ in range(count))

    def _finite(self, count: int) -> tuple[float, ...]:
        return tuple(value if abs(value) < 1e9 else 0.0 for value in self._reals(count))

    def frame(self, tick: int) -> tuple[Any, ...]:
        rows, commands, errors = [], {}, {}
        for i in range(1, 4):
            asked = tick < TICKS and self._some()
            if asked and self._some():
                telemetry = self._reals(self._scenario.layout(i).size) if self._some() else ()
                commands[i] = Command(0, tick, self._reals(3), telemetry)
            signals = self._scenario.plant_signals(i)
            nav = self._reals(10 if signals is None else 12) if asked else ()
            plant = () if signals is None else self._finite(2 + width_of(signals))
            command, tau = (b"c", self._reals(3)) if i in commands else (b"", ())
            rows.append(VehicleFrame(i, self._finite(5), self._finite(5), nav, tau, command, plant, (), (), ()))
            e, formation = self._reals(3), self._reals(3)
            errors[i] = VehicleError(e, abs(e[0]), formation, abs(formation[1]))
        return Frame(tick, False, (), (), tuple(rows)), commands, errors

    def _fate(self, tick: int) -> Fate:
        draw = self._draw
        src, dst = draw.choice(self._scenario.graph.links)
        sent = draw.randint(max(0, tick - 40), tick)  # later ones overtake
        numbers = draw.choice([0, 1, 127, 128, 2**32 - 1]), draw.choice([0, 0, 1, 300])
        times = sent, draw.choice([sent, tick]), draw.choice([0, 1, 10**9])
        payload = draw.randbytes(draw.choice([0, 1, 127, 128, 700]))
        return Fate(tick, src, dst, *numbers, *times, draw.choice(list(Cause)), draw.random() < 0.3, payload)


def expected(scenario: Scenario, calls: Calls) -> list[Entry]:
    """The messages, but for what is drawn, each encoded by itself."""
    found: list[Entry] = []
    packet, fault = flat_schema("Packet", PACKET).message, flat_schema("Fault", FAULT).message
    for name, arguments in calls.all:
        if name == "frame":
            found += frame_entries(scenario, *arguments)
        elif name == "packet":
            (fate,) = arguments
            message = packet(
                seq=fate.seq,
                copy=fate.copy,
                sent=fate.sent_tick / 100,
                due=fate.due_tick / 100,
                delay=fate.delay_ns / 1e9,
                fate=fate.cause,
                payload=fate.payload,
                corrupted=fate.corrupted,
            )
            times = fate.final_tick * 10**7, fate.sent_tick * 10**7
            found.append((f"link/{fate.src}-{fate.dst}", *times, fate.seq, message.SerializeToString()))
        elif name == "event":
            (event,) = arguments
            message = fault(fault=event.fault, action=event.action, what=event.what)
            at = event.tick * 10**7
            found.append(("faults", at, at, event.tick, message.SerializeToString()))
    return found


def frame_entries(
    scenario: Scenario, frame: Frame, commands: dict[int, Command], errors: dict[int, VehicleError]
) -> list[Entry]:
    found: list[Entry] = []
    for group in (*LOG_GROUPS, OF_THE_PLANT) if scenario.plants else LOG_GROUPS:
        if frame.tick % scenario.log_every[group] and frame.tick != TICKS:
            continue
        for row in frame.vehicles:
            i, command, at = row.id, commands.get(row.id), frame.tick * 10**7
            data = b""
            if group == "pose":
                data = pose(at, row)
            elif group == "state":
                data = encoded(STATE + ROLL if row.plant else STATE, row.eta + row.nu + row.plant[:2])
            elif group == "nav" and row.nav:
                data = encoded(STATE + ROLL if row.plant else STATE, row.nav)
            elif group == "plant" and row.plant:
                data = encoded(signal_columns(scenario.plant_signals(i) or ()), row.plant[2:])
            elif group == "error":
                e = errors[i]
                data = encoded(ERROR, (*e.e, e.e_norm, *e.formation, e.formation_norm))
            elif group == "command" and command is not None:
                data = encoded(COMMAND, command.tau + row.tau)
            elif group in ("guidance", "control") and command is not None and command.telemetry:
                layout = scenario.layout(i)
                data = encoded(signal_columns(getattr(layout, group)), command.telemetry[layout.group(group)])
            if data:
                found.append((f"uuv/{i}/{group}", at, at, frame.tick, data))
    return found


def pose(at_ns: int, row: VehicleFrame) -> bytes:
    """By protobuf, but for its doubles, which are there even when they are zero."""
    xyz = encoded(STATE[:3], row.eta[:3])
    turn = encoded(STATE[:4], quaternion(*row.eta[3:], *row.plant[:1]))
    places = b"\x0a" + bytes([len(xyz)]) + xyz + b"\x12" + bytes([len(turn)]) + turn
    before = PoseInFrame(timestamp=stamp_of(at_ns), frame_id="ned").SerializeToString()
    return before + b"\x1a" + bytes([len(places)]) + places


@given(scenarios(), st.integers(0, 2**32), st.sampled_from([300, 5000, 1024 * 1024]))
def test_the_log_of_any_journal_is_the_one_written_message_by_message(
    scenario: Scenario, seed: int, chunk_bytes: int
) -> None:
    """Whatever is missing or late, wherever the run ends; in chunks of any length. Also the digest of no log at all."""
    calls = Drawn(scenario, seed).calls()
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr("fleet.mcap.writer.CHUNK_BYTES", chunk_bytes)
        ours, plain, none = LogFile(Path(folder) / "ours"), PlainLog(Path(folder) / "plain", chunk_bytes), NoLog()
        copies = [Copy(), Copy(), Copy()]
        for log, copy in zip((ours, plain, none), copies, strict=True):
            calls.repeat(LogWriter(log, scenario, tap=copy))
            log.close()
        assert (Path(folder) / "ours").read_bytes() == (Path(folder) / "plain").read_bytes()
        assert ours.digest == plain.digest == none.digest
        entries = copies[0].entries
        assert ours.messages == none.messages == plain.messages == len(entries)
    others = ("transforms", "scene")
    assert [entry for entry in entries if entry[0] not in others] == expected(scenario, calls)
    for topic, _, _, _, data in entries:
        if topic in others:
            message = {"transforms": FrameTransforms, "scene": SceneUpdate}[topic].FromString(data)
            assert message.SerializeToString() == data


def test_a_log_that_is_not_closed_holds_all_but_the_second_that_is_open(tmp_path: Path) -> None:
    scenario = small("duration=3 s")
    drawn = Drawn(scenario, 1)
    log = LogFile(tmp_path / "run.mcap")
    writer = LogWriter(log, scenario)
    for tick in range(260):
        writer.frame(*drawn.frame(tick))
    times = {record.log_ns for record in LogReader(tmp_path / "run.mcap")}
    log.abandon()
    assert sorted(times) == [tick * 10**7 for tick in range(201)]  # the first of the next second closes one


def test_what_is_kept_does_not_grow_with_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every tick another set of vehicles may be there: the layouts of the past are forgotten."""
    monkeypatch.setattr(tick_messages, "_MOST_PLACES", 50_000)
    scenario = small("duration=3 s")
    drawn = Drawn(scenario, 5, whole=False)
    log = NoLog()
    writer = LogWriter(log, scenario)
    for tick in range(200):
        writer.frame(*drawn.frame(tick))
        layouts = writer._ticks._layouts.values()
        assert sum(len(layout.records) + len(layout.digested) for layout in layouts) < 60_000


def test_a_profiler_may_keep_the_frames_of_the_recorder() -> None:
    """And with them arrays that look into its memory, as the sampling thread of a Dask worker does."""
    calls = Drawn(small("duration=3 s", LAWS), 1).calls()
    kept: list[FrameType] = []

    def keep(frame: FrameType, event: str, _: Any) -> None:
        if event == "return" and frame.f_code.co_filename == tick_messages.__file__:
            kept.append(frame)

    logs = [NoLog(), NoLog()]
    calls.repeat(LogWriter(logs[0], small("duration=3 s", LAWS)))
    sys.setprofile(keep)
    try:
        calls.repeat(LogWriter(logs[1], small("duration=3 s", LAWS)))
    finally:
        sys.setprofile(None)
    assert kept
    assert logs[0].digest == logs[1].digest
