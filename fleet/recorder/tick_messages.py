"""All messages of a tick that hold doubles only, encoded, framed and laid out for the digest at once.

A tick of four vehicles has 28 of them, of a hundred vehicles 700. They differ from those of the tick before by numbers
alone. So the numbers of all vehicles go into one pool of bytes. The pool already contains everything else: tags,
lengths, channels, topics. A layout says where in the pool each byte comes from, and numpy gathers them. The messages of
the tick, and the length of its timestamp, determine the layout.

With a hundred vehicles this gave 753,000 instead of 395,000 messages/s. To pack a whole second at once was rejected: it
would have to be cut at the borders of chunks.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import accumulate
from struct import Struct, pack
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.signals import SignalLayout
from fleet.checks.values import BELIEF_SIZE as BELIEF_SIZE
from fleet.checks.values import LOCATED_SIZE as LOCATED_SIZE
from fleet.checks.values import belief_values, located_values
from fleet.logs.schemas import (
    BELIEF,
    CLOCK_ERROR,
    COMMAND,
    ERROR,
    LOCATED,
    ROLL,
    STATE,
    Doubles,
    pose_parts,
    signal_columns,
)
from fleet.mcap.batch import HEAD, MESSAGE, STAMP_BYTES, Batch
from fleet.recorder.metrics import VehicleError
from fleet.recorder.scene.primitives import NED
from fleet.recorder.transforms import quaternion
from fleet.scenario.sections.signals import locates
from netem.wire.messages import Command, Frame
from world.signal import Signal, width_of

# The doubles of one vehicle: the number of each kind's first one. Telemetry comes behind them, since its size is the
# agent's, then what only a vehicle with a plant has: phi, p, the values of the plant's signals, measured phi, p. Last
# is the belief of a vehicle that does not know where it is, and where it is by ranges.
_SIZES = (*(sum(one.width or 1 for one in group) for group in (STATE, STATE, COMMAND, ERROR)), 4, len(CLOCK_ERROR))
_STATE, _NAV, _COMMAND, _ERROR, _QUATERNION, _CLOCK, _TELEMETRY = accumulate(_SIZES, initial=0)
_VALUES = Struct(f"<{_TELEMETRY}d").pack_into  # all but telemetry
_BELIEF = Struct(f"<{BELIEF_SIZE}d").pack_into
_LOCATED = Struct(f"<{LOCATED_SIZE}d").pack_into
_NO_NAV: tuple[float, ...] = (0.0,) * _SIZES[1]
_NO_ROLL: tuple[float, ...] = (0.0,) * 2
_NO_TAU: tuple[float, ...] = (0.0,) * 3
_RIGHT: tuple[float, ...] = (0.0,)
_PARTS = {
    "pose": pose_parts(NED, _STATE, _QUATERNION),
    "state": Doubles(STATE, _STATE).parts,
    "nav": Doubles(STATE, _NAV).parts,
    "command": Doubles(COMMAND, _COMMAND).parts,
    "error": Doubles(ERROR, _ERROR).parts,
    "clock": Doubles(CLOCK_ERROR, _CLOCK).parts,
}

# Where the pool has what is common to a tick's messages.
_TIME, _SEQUENCE = range(8), range(8, 12)
_TIMESTAMP, _NUMBERS = 12, 40  # a timestamp's length varies, and stays below 24 bytes
_FRAMED = np.array([*_SEQUENCE, *_TIME, *_TIME])  # what follows the channel in a record
_DIGESTED = np.array([*_TIME, *_TIME, *_SEQUENCE])  # what follows the topic in what is digested
_STAMP = Struct("<QI").pack_into

_MOST_PLACES = 4 * 1024 * 1024  # in the layouts that are kept, of 4 bytes each
_KEY_PLACES = 32  # what a vehicle takes in the key of a layout, counted in places
_Places = NDArray[np.int32]  # in the pool


class VehicleTopic(NamedTuple):
    channel: int
    name: str


class _Layout(NamedTuple):
    """Where the bytes of a tick's messages come from."""

    channels: NDArray[np.uint16]
    bounds: NDArray[np.int64]  # where in `records` each message begins, and behind them the end
    records: _Places
    digested: _Places


class _Slot(NamedTuple):
    """Where the doubles of a vehicle are in the pool."""

    place: int
    telemetry: Callable[..., None]  # packs it, behind the rest
    plant: Callable[..., None] | None  # packs what its plant adds; None: it has none
    behind: int  # where that begins
    believed: int  # where its belief begins; 0: it knows where it is
    located: int  # where its position by ranges begins; 0: it uses none
    kind: int  # number of its kind of report


class _Kind(NamedTuple):
    """What vehicles report."""

    agent: SignalLayout
    plant: tuple[Signal, ...] | None  # None: they have none
    navigates: bool  # the vehicles do not know where they are


class TickMessages:
    """Makes the messages of one tick after the other. Its memory does not grow with the run."""

    def __init__(
        self,
        topics: Mapping[str, Mapping[int, VehicleTopic]],
        agents: Mapping[int, SignalLayout],
        plants: Mapping[int, tuple[Signal, ...]],
        navigating: Collection[int] = (),
    ) -> None:
        """Lay out the pool. `topics`: of every topic group and vehicle. `agents`, `plants`: the signals of those that
        have some. `navigating`: the vehicles that do not know where they are.
        """
        self._topics = topics
        kinds = {i: _Kind(agent, plants.get(i), i in navigating) for i, agent in agents.items()}
        self._kinds = list(dict.fromkeys(kinds.values()))  # each kind of report once
        number = {kind: k for k, kind in enumerate(self._kinds)}
        self._slots: dict[int, _Slot] = {}
        place = _NUMBERS
        for i, kind in kinds.items():
            behind = place + 8 * (_TELEMETRY + kind.agent.size)
            added = 0 if kind.plant is None else 2 * len(ROLL) + width_of(kind.plant)
            telemetry, plant = (Struct(f"<{size}d").pack_into for size in (kind.agent.size, added))
            believed = behind + 8 * added
            located = believed + 8 * (BELIEF_SIZE if kind.navigates else 0)
            ranged = locates(kind.agent)
            self._slots[i] = _Slot(
                place,
                telemetry,
                plant if added else None,
                behind,
                believed if kind.navigates else 0,
                located if ranged else 0,
                number[kind],
            )
            place = located + 8 * (LOCATED_SIZE if ranged else 0)
        self._pool = bytearray(place)
        self._constants: dict[bytes, int] = {}  # places of the constants in the pool
        self._size, self._added = place, list[bytes]()  # size of the pool with what is still to be put at its end
        self._encoded: dict[tuple[str, int, int], NDArray[np.int64]] = {}
        self._messages: dict[tuple[str, int, int], tuple[_Places, _Places]] = {}
        self._layouts: dict[tuple[Any, ...], _Layout] = {}
        self._kept = 0  # places in all layouts and their keys

    def __call__(
        self,
        frame: Frame,
        commands: Mapping[int, Command],
        errors: Mapping[int, VehicleError],
        groups: Sequence[str],
        at_ns: int,
        stamp: bytes,
    ) -> Batch:
        """The messages of a tick in the groups that are due, in each the vehicles in ascending order; `stamp` is the
        time as `fleet.logs.schemas.stamp_field` writes it.
        """
        pool, there = self._pool, []
        reported = "guidance" in groups or "control" in groups or "located" in groups
        for row in frame.vehicles:
            i, eta, nav = row.id, row.eta, row.nav
            command = commands.get(i)
            tau, applied = (_NO_TAU, _NO_TAU) if command is None else (command.tau, row.tau)
            e, e_norm, formation, formation_norm = errors[i]
            place, pack_telemetry, pack_plant, behind, believed, located, _ = self._slots[i]
            if believed and nav:
                _BELIEF(pool, believed, *belief_values(row, errors[i]))
            phi = 0.0
            if pack_plant is not None:
                phi = row.plant[0]
                pack_plant(pool, behind, *row.plant, *(nav[len(STATE) :] or _NO_ROLL))
                nav = nav[: len(STATE)]
            _VALUES(
                pool, place, *eta, *row.nu, *(nav or _NO_NAV), *tau, *applied, *e, e_norm, *formation, formation_norm,
                *quaternion(eta[3], eta[4], phi), *(row.clock or _RIGHT),
            )  # fmt: skip
            telemetry = reported and command is not None and command.telemetry
            if telemetry:
                pack_telemetry(pool, place + 8 * _TELEMETRY, *telemetry)
                if located:
                    _LOCATED(pool, located, *located_values(row, telemetry))
            there.append((i, bool(nav), command is not None, bool(telemetry)))
        _STAMP(pool, 0, at_ns, frame.tick)
        pool[_TIMESTAMP : _TIMESTAMP + len(stamp)] = stamp
        layout = self._layout(groups, len(stamp), there)
        if self._added:
            # Not in place: a profiler that keeps our frames keeps arrays that look into the pool.
            self._pool = pool = pool + b"".join(self._added)
            self._added.clear()
        found = np.frombuffer(pool, np.uint8)
        records, digested = found.take(layout.records), found.take(layout.digested)
        return Batch(at_ns, frame.tick, layout.channels, layout.bounds, records, digested)

    def _layout(self, groups: Sequence[str], stamp: int, there: Sequence[tuple[int, bool, bool, bool]]) -> _Layout:
        """For the messages of these groups. `stamp`: length of the timestamp [bytes]. `there`: vehicle after vehicle,
        and whether it has a measurement, a command, telemetry.
        """
        key = (tuple(groups), stamp, tuple(there))
        if key in self._layouts:
            return self._layouts[key]
        messages: list[tuple[int, _Places, _Places]] = []
        for group in groups:
            topics = self._topics[group]
            for i, nav, command, telemetry in there:
                has = {"nav": nav, "belief": nav, "command": command}
                has |= dict.fromkeys(("guidance", "control", "located"), telemetry)
                if i in topics and has.get(group, True):
                    messages.append((topics[i].channel, *self._message(group, i, stamp)))
        none = [np.empty(0, np.int32)]
        records = np.concatenate([record for _, record, _ in messages] or none)
        digested = np.concatenate([part for _, _, part in messages] or none)
        channels = np.array([channel for channel, _, _ in messages], np.uint16)
        bounds = np.cumsum([0, *(len(record) for _, record, _ in messages)])
        if self._kept > _MOST_PLACES:
            self._layouts.clear()
            self._kept = 0
        self._kept += len(records) + len(digested) + _KEY_PLACES * len(there)
        self._layouts[key] = layout = _Layout(channels, bounds, records, digested)
        return layout

    def _message(self, group: str, i: int, stamp: int) -> tuple[_Places, _Places]:
        key = group, i, stamp if group == "pose" else 0
        if key not in self._messages:
            channel, name = self._topics[group][i]
            slot = self._slots[i]
            data = self._data(group, slot.kind, key[2])
            data = np.where(data < 0, slot.place + ~data, data)
            head = self._constant(HEAD.pack(MESSAGE, STAMP_BYTES + len(data), channel, 0, 0, 0)[: -len(_FRAMED)])
            length = self._constant(pack("<I", len(data)))
            record = np.concatenate((head, _FRAMED, data), dtype=np.int32)
            digested = np.concatenate((self._constant(name.encode()), _DIGESTED, length, data), dtype=np.int32)
            self._messages[key] = record, digested
        return self._messages[key]

    def _data(self, group: str, kind: int, stamp: int) -> NDArray[np.int64]:
        """Where the bytes of the encoded message come from; ~k for byte k of the vehicle's doubles."""
        key = group, kind, stamp
        if key not in self._encoded:
            parts = _parts(group, self._kinds[kind])
            places = list(range(_TIMESTAMP, _TIMESTAMP + stamp))
            for part in parts:
                places += self._constant(part) if isinstance(part, bytes) else range(~(8 * part), ~(8 * part + 8), -1)
            self._encoded[key] = np.array(places)
        return self._encoded[key]

    def _constant(self, data: bytes) -> range:
        if data not in self._constants:
            self._constants[data] = self._size
            self._size += len(data)
            self._added.append(data)
        place = self._constants[data]
        return range(place, place + len(data))


def _parts(group: str, kind: _Kind) -> list[bytes | int]:
    agent, plant, navigates = kind
    if group in ("belief", "located"):
        behind = _TELEMETRY + agent.size + (0 if plant is None else 2 * len(ROLL) + width_of(plant))
        if group == "belief":
            return Doubles(BELIEF, behind).parts
        return Doubles(LOCATED, behind + (BELIEF_SIZE if navigates else 0)).parts
    if group in ("guidance", "control"):
        return Doubles(signal_columns(getattr(agent, group)), _TELEMETRY + agent.group(group).start).parts
    if plant is None or group not in ("state", "nav", "plant"):
        return _PARTS[group]
    roll = _TELEMETRY + agent.size
    if group == "plant":
        return Doubles(signal_columns(plant), roll + len(ROLL)).parts
    start = roll if group == "state" else roll + len(ROLL) + width_of(plant)
    return [*_PARTS[group], *Doubles(ROLL, start, len(STATE) + 1).parts]
