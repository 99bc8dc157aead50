"""The marks on the pictures of the tracks: events of vehicles and their places, directions, desired places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fleet.logs.records import Array
from fleet.pictures.runs import Run, View, first_words
from fleet.quantities import vehicle_numbers
from fleet.scenario.sections.vehicle_events import DIVERGED, TUMBLED
from fleet.scene.model import SceneModel

# What begins a fault's text -> (what became of the vehicle, mark).
MARKS = {"kill": ("agent dead", "X"), TUMBLED: (TUMBLED, "*"), DIVERGED: (DIVERGED, "P")}
_ARROWS = 3  # per track


class Happening(NamedTuple):
    """An event of a vehicle."""

    vehicle: int
    what: str  # agent dead, tumbled, diverged
    mark: str
    t: float  # s
    position: Array  # m, NED


def happenings(run: Run, view: View, tracks: Mapping[int, tuple[Array, Array]]) -> list[Happening]:
    """The events of the vehicles in a picture, in the order of time.

    Args:
        tracks: times [s] and positions (samples, 3) [m, NED] of each vehicle.
    """
    found = []
    for fault in (*run.log.faults, *run.log.events):
        kind, _, who = fault.what.partition(" ")
        for i in numbers(who) if kind in MARKS else ():
            if i in tracks and (view.window is None or view.window[0] <= fault.begin <= view.window[1]):
                t, positions = tracks[i]
                k = min(int(np.searchsorted(t, fault.begin)), len(t) - 1)
                found.append(Happening(i, *MARKS[kind], fault.begin, positions[k]))
    return sorted(found, key=lambda one: (one.t, one.vehicle))


def numbers(text: str) -> Sequence[int]:
    """The vehicles that a fault's text names; none if it names something else."""
    try:
        return vehicle_numbers(text)
    except ValueError:
        return ()


def told(found: Sequence[Happening]) -> list[str]:
    """A line such as `tumbled: UUV 2 at 27.7 s (3 times), UUV 3 at 26.3 s` for each kind."""
    lines = []
    for what in dict.fromkeys(one.what for one in found):
        times: dict[int, list[float]] = {}
        for one in found:
            if one.what == what:
                times.setdefault(one.vehicle, []).append(one.t)
        often = {i: f" ({len(t)} times)" if len(t) > 1 else "" for i, t in times.items()}
        each = [f"UUV {i} at {t[0]:.4g} s{often[i]}" for i, t in times.items()]
        lines += [f"{what}: {first_words(each[k : k + 2], 2)}" for k in range(0, min(len(each), 6), 2)]
        if len(each) > 6:
            lines.append(f"{what}: {len(each) - 6} more")
    return lines


def directions(positions: Array) -> list[tuple[Array, float]]:
    """(position [m, NED], course [degrees from east to north]) at a few places along a track, evenly by its length."""
    steps = np.linalg.norm(np.diff(positions[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])
    if along[-1] < 1.0:  # m: it stays where it is
        return []
    found = []
    for share in (np.arange(_ARROWS) + 0.5) / _ARROWS:
        k = int(np.clip(np.searchsorted(along, share * along[-1]), 1, len(positions) - 1))
        back = max(int(np.searchsorted(along, along[k] - 0.01 * along[-1])) - 1, 0)
        north, east = positions[k, :2] - positions[back, :2]
        found.append((positions[k], float(np.degrees(np.arctan2(north, east)))))
    return found


def places(run: Run, view: View) -> dict[int, Array]:
    """Where each vehicle should be at the end of the picture [m, NED]."""
    if run.scenario is None:
        return {}
    t = min(view.window[1] if view.window else run.log.end, run.log.end)
    scene = SceneModel(run.scenario)
    reference, offsets = np.array(scene.reference(t)), scene.offsets(t)
    return {i: reference + np.array(offsets[i - 1]) for i in run.vehicles(view) if i <= len(offsets)}
