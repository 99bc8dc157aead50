"""A file of nodes in simulated time: its programs as agents of moored vehicles that have the names of the nodes.

What is made is an ordinary scenario. So all that such a one has (digests, verify, studies, why) holds for it, and
nothing else has to know of it. (Rejected: a third kind of run, which would judge, disturb and record by itself.)
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from fleet.quantities import show_time
from fleet.scenario.schema.nodes import ModemPortSection, udp_target
from fleet.scenario.schema.programs import (
    DONE,
    RUNNING,
    ProgramSection,
    StackSignalSection,
    expected_ending,
    fill_placeholders,
    nodes_of,
    programs_of,
)
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.text.nodes import UNTIL_STOPPED_NS
from netem.namespaces import address

SIMULATED = "simulated"
ROUND_NS = 10_000_000  # programs speak at any time: a message waits for the next round, half of this on average
FRAME_NS = 100_000_000  # from one value of a signal in the log to the next, as on the wall clock
_ROUTER = "{zenoh}"  # the agent fills in where the router of its node is
_BEGIN_S = "1000"  # CLOCK_MONOTONIC at t = 0
_PYTHONS = ("python", "python3")
# Keys of a scenario that nodes and vehicles share.
_SHARED = (
    "name",
    "title",
    "seed",
    "duration",
    "stall_timeout",
    "expect",
    "graph",
    "faults",
    "nemesis",
    "checks",
    "log",
)
MODEM_PORTS = {"unet": 1100, "evologics": 9200, "micromodem": 7000}  # of a node that says 0; 7000 is our choice
# A node with a modem and no program, such as a buoy that answers ranges. (Rejected: `sleep infinity`, which waits for
# nothing that could come, and so counts as a deadlock.)
_NOBODY = ProgramSection(run=["sleep", "1000000000"])
Obstacle = tuple[tuple[str, ...], str, str]  # where, what is wrong, what to do


def obstacles(spec: ScenarioSpec) -> Iterator[Obstacle]:
    """What of a valid file of nodes needs the wall clock, or is not there in simulated time."""
    nodes = dict(spec.nodes or {})
    if spec.duration == UNTIL_STOPPED_NS:
        yield ("clock",), "simulated time needs an end", "duration: 60 s"
    programs = _programs_by_node(spec, list(nodes))
    for name, node in nodes.items():
        path = ("nodes", name)
        if not programs[name] and node.modem is None:
            yield path, "has no program, and nobody joins simulated time from outside", "programs: {NAME: {run: ...}}"
        for key in ("listen", "connect", "zenoh"):
            if getattr(node, key) is not None:
                yield (*path, key), "is of a real host", "leave it out: programs connect to {listen}"
        if node.isolate:
            yield path, "each program has a network of its own in simulated time: isolate is for the wall clock", ""
    for key in ("compose", "discovery", "header", "fragments"):
        if getattr(spec, key) is not None:
            yield (key,), "has no meaning in simulated time so far", "clock: real"
    for name, signal in (spec.signals or {}).items():
        if signal.ros is not None:
            yield ("signals", name), "messages of ROS 2 are not read in simulated time so far", "line: what it prints"
    for name, section in (spec.programs or {}).items():
        words = " ".join([*section.run, *section.env.values()])
        for place in ("zenoh", "dir"):
            if f"{{{place}}}" in words:
                yield ("programs", name), f"{{{place}}} is a file or port of a real host", "{listen}"


def simulated_values(spec: ScenarioSpec, folder: Path) -> dict[str, Any]:
    """The scenario of vehicles that a valid file of nodes is in simulated time, as values of its text.

    Args:
        spec: of the file; nothing of `obstacles` is in it.
        folder: of the file.
    """
    dumped = spec.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True)
    found = {key: dumped[key] for key in _SHARED if key in dumped}
    names = list(spec.nodes or {})
    tick_ns = _tick_ns(spec)
    tick = show_time(tick_ns)
    network = {"period": tick} | {k: v for k, v in dumped["network"].items() if k != "period"}
    checks = {key: value for key, value in found.get("checks", {}).items() if key != "punctual"}
    asked = spec.checks.programs
    offsets = [f"{x:g} {y:g} {z:g} m" for x, y, z in spec.formation.offsets or ()]
    per_vehicle = {}
    programs = _programs_by_node(spec, names)
    for number, name in enumerate(names, start=1):
        per_vehicle[str(number)] = {"agent": _agent(spec, names, number, programs[name] or {name: _NOBODY}, folder)}
    if any(len(here) > 1 for here in programs.values()):  # else the check says what it is asked in the user's words
        checks["programs"] = {name: _ends_as(asked, name, programs[name]) for name in names}
    else:
        checks["programs"] = checks.get("programs", RUNNING)
    return found | {
        "vehicles": len(names),
        "names": names,
        "moored": True,
        "tick": tick,
        "reference": {"start": "0 0 0 m", "velocity": "0 0 0 m/s"},
        "formation": {"offsets": offsets},
        "initial": [{"position": each} for each in offsets],
        "network": network,
        "checks": checks,
        "log": {"every": f"{max(1, FRAME_NS // tick_ns)} ticks"} | found.get("log", {}),
        "per_vehicle": per_vehicle,
    }


def command_folders(spec: ScenarioSpec) -> list[Path]:
    """Where the commands lie that a file of nodes names without a path, such as `bash`: on the wall clock it may
    start any.
    """
    first = {section.run[0] for section in (*(spec.programs or {}).values(), _NOBODY)}
    found = (shutil.which(word) for word in sorted(first) if "/" not in word)
    return [Path(file).resolve().parent for file in found if file is not None]


def _programs_by_node(spec: ScenarioSpec, names: Sequence[str]) -> dict[str, dict[str, ProgramSection]]:
    """The programs of each node, by name."""
    found: dict[str, dict[str, ProgramSection]] = {name: {} for name in names}
    for program, owner, section in programs_of(spec.programs or {}, names):
        found[owner][program] = section
    return found


def _ends_as(asked: Mapping[str, str] | None, node: str, programs: Mapping[str, ProgramSection]) -> str:
    """What the check says of all programs of a node together: it has ended when all of them have."""
    found = {expected_ending(asked, program, node) for program in programs} or {RUNNING}
    return found.pop() if len(found) == 1 else RUNNING if RUNNING in found else DONE


def _agent(
    spec: ScenarioSpec, names: Sequence[str], number: int, programs: Mapping[str, ProgramSection], folder: Path
) -> dict[str, Any]:
    first, section = next(iter(programs.items()))
    node = (spec.nodes or {})[names[number - 1]]
    known = {
        "listen": _ROUTER, "modem": str(_modem_place(node.modem)), "address": address(number),
        "node": names[number - 1], "number": number, "seed": spec.seed, "begin_s": _BEGIN_S,
        "duration_s": f"{spec.duration / 1e9:g}", "domain": "0",
    }  # fmt: skip
    ours = {} if node.udp else {
        "RMW_IMPLEMENTATION": "rmw_zenoh_cpp", "ZENOH_CONFIG_OVERRIDE": f'connect/endpoints=["{_ROUTER}"]',
    }  # fmt: skip
    agent = _program([fill_placeholders(word, known) for word in section.run], folder, section.folder)
    if environment := ours | {key: fill_placeholders(text, known) for key, text in section.env.items()}:
        agent["env"] = environment
    if awaited := [_ready(name, each, spec) for name, each in programs.items() if each.ready.line is not None]:
        agent["ready"] = awaited
    if beside := _data_files(folder, [each.folder for each in programs.values()]):
        agent["files"] = beside
    name = names[number - 1]
    if len(programs) > 1:
        agent["ends"] = _ENDS[expected_ending(spec.checks.programs, first, name)]
        agent["beside"] = {
            program.removeprefix(f"{name}/"): {
                "run": _command([fill_placeholders(word, known) for word in each.run], folder / (each.folder or "")),
                "env": {key: fill_placeholders(text, known) for key, text in each.env.items()},
                "ends": _ENDS[expected_ending(spec.checks.programs, program, name)],
            }
            for program, each in [*programs.items()][1:]
        }
    told = {name: each for name, each in (spec.signals or {}).items() if names[number - 1] in nodes_of(each.of, names)}
    signals = {name: _signal(each, known) for name, each in told.items()}
    ways = {port: udp_target(text) for port, text in node.udp.items()}
    udp = {port: [names.index(way[0]) + 1, way[2]] for port, way in ways.items() if way is not None}
    if node.modem is not None:
        agent["modem"] = _modem(spec, names, number, node.modem)
    return agent | ({"signals": signals} if signals else {}) | ({"udp": udp} if udp else {})


def _modem_place(modem: ModemPortSection | None) -> int | str:
    """Where programs open the modem of their node; each node has ports of its own."""
    return "" if modem is None else modem.where or MODEM_PORTS[modem.language]


def _modem(spec: ScenarioSpec, names: Sequence[str], number: int, modem: ModemPortSection) -> dict[str, Any]:
    """The modem of a node as the key of a program."""
    given: dict[str, Any] = modem.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True)
    given.pop("host", None)
    addresses = {
        name: node.modem.address or i
        for i, (name, node) in enumerate((spec.nodes or {}).items(), start=1)
        if node.modem
    }
    return given | {modem.language: _modem_place(modem), "name": names[number - 1], "addresses": addresses}


def _tick_ns(spec: ScenarioSpec) -> int:
    """The tick: in water all starts are at ticks, on both clocks."""
    return ROUND_NS if spec.network.acoustic is None else spec.tick


def _ready(name: str, section: ProgramSection, spec: ScenarioSpec) -> dict[str, Any]:
    """What a program prints when it is ready, and when it is late: at the latest with the end of the run."""
    within_ns = min(section.ready.within, spec.duration - 2 * _tick_ns(spec))
    return {"name": name, "line": section.ready.line, "within_s": max(0, within_ns) / 1e9}


def _signal(section: StackSignalSection, known: Mapping[str, object]) -> dict[str, Any]:
    """A signal of a node as one of its program."""
    given = section.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True)
    more = {} if section.message is None else {"message": fill_placeholders(section.message, known)}
    return {key: value for key, value in given.items() if key not in ("of", "unit")} | more


_ENDS = {RUNNING: "no", DONE: "yes"}  # of what the check wants of a program


_MOST_DATA = 20_000_000  # bytes of files that are copied for each program, and how many files
_MOST_FILES = 64


def _data_files(folder: Path, below: Iterable[str | None]) -> list[str]:
    """Files that programs of a node find where they run on the wall clock; none if they are many, or large.

    They are copied into its home. Python finds modules without that.
    """
    folders = dict.fromkeys(folder / (each or "") for each in below)
    found = [file for each in folders if each.is_dir() for file in sorted(each.iterdir()) if _is_data(file)]
    if len(found) > _MOST_FILES or sum(file.stat().st_size for file in found) > _MOST_DATA:
        return []
    return [str(file.resolve()) for file in found]


def _is_data(file: Path) -> bool:
    return file.is_file() and not file.name.startswith(".") and file.suffix not in (".py", ".mcap")


def _command(words: Sequence[str], here: Path) -> list[str]:
    """A command line whose files are those of its folder."""
    return [str((here / word).resolve()) if (here / word).is_file() else word for word in words]


def _program(words: Sequence[str], folder: Path, below: str | None) -> dict[str, Any]:
    """A command line as the keys of a program. A file that it names is the one of its folder."""
    here = folder / (below or "")
    first, *rest = words
    named = _command(rest, here)
    if first in _PYTHONS and rest[:1] == ["-m"]:
        return {"program": {"module": rest[1]}, "arguments": named[2:]}
    if first in _PYTHONS and rest:
        return {"program": str(Path(below or "", rest[0])), "arguments": named[1:]}
    return {"program": shutil.which(first) or str(Path(below or "", first)), "arguments": named}
