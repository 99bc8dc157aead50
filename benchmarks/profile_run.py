"""Where the time of a run goes, by process, as flame graphs and as a table: `python benchmarks/profile_run.py paper`.

py-spy looks into all processes of a run a hundred times a second and sees the threads that Python knows. zenoh's own
threads it cannot see: what they take is read from the system, as is the part that every process spends in the kernel.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import click
import msgspec
import psutil
from flame_graph import Frame, flame_graph
from msgspec import Meta, Struct
from rich.console import Console as Terminal
from soak import of_session, result_of

import fleet
from fleet.cores import cores
from fleet.errors import FleetError
from fleet.scenario.loading import load_scenario
from fleet.terminal.table import columns, show
from fleet.terminal.width import stdout

RATE = 100  # samples per second
SAMPLE_S = 0.1  # between two looks at the processes' times
END_S = 10.0  # for a run that is to end before its time
STILL_S = 30.0  # without work: py-spy stops processes to look into them, and seldom one stays stopped
TRIES = 2
AGENTS, CONSOLE = "agents", "console"
ZENOH, IMPORTS, OTHER = "zenoh", "imports", ""
# By how a file's path begins below the packages; the innermost function with such a file decides.
KINDS = {
    "zenoh/": ZENOH,
    "numpy": "numpy",
    "piqp": "QP",
    "msgspec/": "messages",
    "netem/wire/": "messages",
    "fleet/recorder/": "recorder",
    "fleet/logs/": "recorder",
    "mcap/": "recorder",
    "google/": "recorder",
    "zstd": "recorder",
    "agents/": "agent",
    "world/": "world",
    "netem/": "netem",
    "fleet/": "console's own",
}
_PACKAGES = f"{Path(fleet.__file__).parents[1]}/"  # of ours
_IMPORTING = ("<frozen importlib", "/importlib/")
_IMPORT = Frame("(imports)", IMPORTS)
_HINT = "in a container give it --cap-add SYS_PTRACE; elsewhere be root, or set kernel.yama.ptrace_scope to 0"


class ProcessTime(Struct):
    """Where the CPU time of one process went, or of all agents together."""

    process: Annotated[str, Meta(description="world, netem, agents, console, or run: all in one process.")]
    processes: Annotated[int, Meta(description="How many of them.")]
    cpu_s: Annotated[float, Meta(description="CPU time of all its threads [s].")]
    kernel: Annotated[float, Meta(description="Share of it that the kernel took, on behalf of whatever [1].")]
    shares: Annotated[dict[str, float], Meta(description="Share of it by what the time was for [1].")]
    samples: Annotated[int, Meta(description="How often py-spy saw it at work.")]
    flame_graph: Annotated[str, Meta(description="File of its flame graph; empty: it was not seen.")]


class Profiled(Struct):
    """Where the time of a run goes."""

    scenario: Annotated[str, Meta(description="What was run.")]
    cores: Annotated[str, Meta(description="`compiled` or `plain Python`: the cores of world, agents and netem.")]
    x_real_time: Annotated[float, Meta(description="Simulated time per wall time, while it was watched [1].")]
    processes: Annotated[list[ProcessTime], Meta(description="By process; those that take most first.")]


class _Schema(Struct):
    """What of py-spy's file is read: https://www.speedscope.app/file-format-schema.json."""

    shared: dict[str, list[dict[str, Any]]]
    profiles: list[dict[str, Any]]


@dataclass(slots=True)
class Times:
    """CPU time of the threads of the processes below one, as it was seen last."""

    roles: dict[int, str] = field(default_factory=dict)  # by process
    user: dict[tuple[int, int], float] = field(default_factory=dict)  # (process, thread) -> [s]
    kernel: dict[tuple[int, int], float] = field(default_factory=dict)

    def look(self, root: int) -> None:
        with suppress(psutil.Error):
            for process in psutil.Process(root).children(recursive=True):
                with suppress(psutil.Error):
                    for thread in process.threads():
                        self.user[process.pid, thread.id] = thread.user_time
                        self.kernel[process.pid, thread.id] = thread.system_time
                    if command := process.cmdline():  # one that has ended has no command any more
                        self.roles[process.pid] = _role(command, self.roles.get(process.ppid(), ""))

    def of(self, pids: Sequence[int], known: set[tuple[int, int]] | None = None) -> tuple[float, float]:
        """(user, kernel) time of processes; of the threads that are not known, if some are."""
        keys = [key for key in self.user if key[0] in pids and (known is None or key not in known)]
        return sum(self.user[key] for key in keys), sum(self.kernel[key] for key in keys)

    def total(self) -> float:
        """CPU time of all of them [s]."""
        return sum(self.user.values()) + sum(self.kernel.values())


def _role(command: list[str], above: str = "") -> str:
    """The role of a process; `above`: of its parent, whose command a child has between its fork and its exec."""
    words = " ".join(command)
    if words.startswith("fleet agent"):
        return AGENTS
    if words.startswith(("fleet world", "fleet netem")):
        return words.split()[1]
    return CONSOLE if "-m fleet run" in words and above != CONSOLE else ""  # "": the fork server and the like


def py_spy() -> str | None:
    """Where py-spy is: beside our own Python, or else on the path."""
    return shutil.which("py-spy", path=os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")]))


def measure_profile(arguments: Sequence[str], scenario: str, out: Path) -> Profiled:
    """Run a scenario under py-spy and write a flame graph for each kind of process.

    Args:
        arguments: of `fleet run`.
        scenario: its name.
        out: the directory for the pictures, which is made.

    Raises:
        FleetError: py-spy is not there, or may not look; or the run did not come to its end.
    """
    spy = py_spy()
    if spy is None:
        raise FleetError("a profile needs py-spy, which is not installed: pip install py-spy", status=3)
    found = next(filter(None, (_watched(spy, arguments) for _ in range(TRIES))), None)
    if found is None:
        raise FleetError(
            f"the run stood still under py-spy for {STILL_S:g} s, {TRIES} times: try another py-spy", status=3
        )
    stacks, times, wall = found
    out.mkdir(parents=True, exist_ok=True)
    rows = _rows(stacks, times, out, scenario, in_process=wall["in_process"])
    return Profiled(scenario, cores(), wall["x_real_time"], sorted(rows, key=lambda row: -row.cpu_s))


def _watched(spy: str, arguments: Sequence[str]) -> tuple[Stacks, Times, dict[str, Any]] | None:
    """What py-spy saw of a run, its CPU times, and how fast it was; None: it stood still and was ended."""
    with tempfile.TemporaryDirectory(prefix="uuv-fleet-bench-") as name:
        folder = Path(name)
        command = [spy, "record", "--subprocesses", "--native", "--function", "--rate", str(RATE)]
        command += ["--format", "speedscope", "--output", str(folder / "stacks.json"), "--"]
        command += [sys.executable, "-P", "-m", "fleet", "run", *arguments, "--out", str(folder / "run"), "--quiet"]
        times = Times()
        said = _run(command, folder / "said.txt", times)
        if said is None:
            return None
        result = result_of(folder / "run")
        if result.get("status", "pass") not in ("pass", "check_failed"):
            raise FleetError(f"the run was {result['status']}: {result.get('reason', '')}", status=3)
        if not result or not (folder / "stacks.json").exists():
            raise FleetError(f"py-spy made no profile: {said}; if it may not look into processes: {_HINT}", status=3)
        return read_stacks((folder / "stacks.json").read_bytes()), times, result["wall"]


def _run(command: list[str], said: Path, times: Times) -> str | None:
    """Run py-spy to its end, and return what it said last; None: the run stood still and was ended."""
    still = False
    with said.open("wb") as file, _session(command, file) as process:
        done = threading.Event()

        def watch() -> None:
            nonlocal still
            worked, since = 0.0, time.monotonic()
            while not done.wait(SAMPLE_S):
                times.look(process.pid)
                if times.total() > worked + 0.05:
                    worked, since = times.total(), time.monotonic()
                elif time.monotonic() - since > STILL_S:
                    still = True
                    process.kill()
                    return

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            process.wait()
        finally:
            done.set()
            watcher.join()
    if still:
        return None
    lines = [line for line in said.read_text("utf-8", "replace").splitlines() if line.strip()]
    return " ".join(lines[-1:])[:300] or f"it exited with status {process.returncode}"


@contextmanager
def _session(command: list[str], output: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A process in a session of its own; what is left of it at the end of the block is ended."""
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
    )
    try:
        yield process
    finally:
        for number in (signal.SIGTERM, signal.SIGKILL):
            deadline = time.monotonic() + END_S
            for pid in of_session(process.pid):
                with suppress(ProcessLookupError):
                    os.kill(pid, number)
            while of_session(process.pid) and time.monotonic() < deadline:
                time.sleep(0.02)
        process.wait()


Stacks = dict[tuple[int, int], list[tuple[tuple[Frame, ...], float]]]  # (process, thread) -> stacks and seconds


def read_stacks(text: bytes) -> Stacks:
    """The stacks of py-spy's file, each with its functions from the outermost on.

    Raises:
        FleetError: py-spy wrote something else.
    """
    try:
        found = msgspec.json.decode(text, type=_Schema)
        frames = [_frame(values) for values in found.shared["frames"]]
        stacks: Stacks = {}
        for profile in found.profiles:
            _, pid, _, thread, *_ = str(profile["name"]).split(" ")  # Process 7 Thread 8 "MainThread"
            unit = {"seconds": 1.0}[profile["unit"]]
            pairs = zip(profile["samples"], profile["weights"], strict=True)
            stacks.setdefault((int(pid), int(thread)), []).extend(
                (_ours([frames[number] for number in numbers]), weight * unit) for numbers, weight in pairs
            )
    except (msgspec.DecodeError, KeyError, ValueError, IndexError, TypeError) as error:
        raise FleetError(f"the profile of this py-spy cannot be read: {error!r:.200}; take 0.4", status=3) from error
    return stacks


def _ours(stack: list[Frame]) -> tuple[Frame, ...]:
    """A stack from our first function on, if there is one, up to the first import."""
    begin = next((number for number, frame in enumerate(stack) if frame.kind), 0)
    end = next((number for number, frame in enumerate(stack) if frame.kind == IMPORTS), len(stack))
    return (*stack[begin:end], *([_IMPORT] if end < len(stack) else []))


def _frame(values: dict[str, Any]) -> Frame:
    name, file = str(values["name"]), str(values.get("file") or "")
    if any(part in file for part in _IMPORTING):
        return Frame(name, IMPORTS)
    _, installed, place = file.rpartition("/site-packages/")
    place = place if installed else file.removeprefix(_PACKAGES) if file.startswith(_PACKAGES) else Path(file).name
    kind = next((kind for begin, kind in KINDS.items() if place.startswith(begin)), OTHER)
    if "__mypyc" in place:
        kind = "compiled cores"
    if file.endswith(".py"):
        name = f"{Path(file).stem}.{name}"
    return Frame("?" if name.startswith("0x") else name, kind)


def kind_of(stack: Sequence[Frame]) -> str:
    """What a stack is for: what its innermost function with a known place is."""
    return next((frame.kind for frame in reversed(stack) if frame.kind), "other")


def _rows(stacks: Stacks, times: Times, out: Path, scenario: str, *, in_process: bool) -> Iterator[ProcessTime]:
    for role in filter(None, dict.fromkeys(times.roles.values())):
        pids = [pid for pid, of in times.roles.items() if of == role]
        name = "run" if in_process else role
        seen = {key: of for key, of in stacks.items() if key[0] in pids}
        user, kernel = times.of(pids)
        cpu_s = max(user + kernel, 1e-9)
        found: defaultdict[str, float] = defaultdict(float)
        for of in seen.values():
            for stack, seconds in of:
                found[kind_of(stack)] += seconds
        # py-spy says how Python's threads divide their time, the system how much that is.
        others = sum(times.of(pids, set(seen)))
        scale = (cpu_s - others) / max(sum(found.values()), 1e-9)
        shares = {kind: seconds * scale / cpu_s for kind, seconds in found.items()}
        unseen = "other" if in_process else ZENOH
        shares[unseen] = shares.get(unseen, 0.0) + others / cpu_s
        path = out / f"{name}.svg"
        merged = [pair for of in seen.values() for pair in of]
        if merged:
            title = f"{scenario}, {name}: {len(pids)} process{'es' * (len(pids) > 1)}, {cpu_s:.1f} s of CPU time"
            path.write_text(flame_graph(title, merged), "utf-8")
        yield ProcessTime(name, len(pids), cpu_s, kernel / cpu_s, shares, len(merged), str(path) if merged else "")


def show_profile(found: Profiled, terminal: Terminal) -> None:
    """Print where the time went, and where the pictures are."""
    named = sorted({kind for row in found.processes for kind in row.shares},
                   key=lambda kind: -sum(row.shares.get(kind, 0.0) * row.cpu_s for row in found.processes))  # fmt: skip
    headings = {"process": 0, "CPU\n[s]": 0, **{kind.replace(" ", "\n"): 1 for kind in named}, "in the\nkernel": 0}
    rows = [
        (
            row.process if row.processes == 1 else f"{row.process} ({row.processes})",
            f"{row.cpu_s:.2f}",
            *(f"{row.shares[kind]:.0%}" if kind in row.shares else "" for kind in named),
            f"{row.kernel:.0%}",
        )
        for row in found.processes
    ]
    title = f"where the time goes: {found.scenario}, {found.cores}, {found.x_real_time:.1f} x real time while watched"
    show(columns(headings, rows), title, terminal, "--json")
    for row in found.processes:
        if row.flame_graph:
            terminal.print(row.flame_graph, highlight=False, markup=False, soft_wrap=True)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("scenario")
@click.option("--duration", metavar="TIME", default="20 s", show_default=True, help="Simulated.")
@click.option("--in-process", is_flag=True, help="One process, no zenoh.")
@click.option("--set", "overrides", metavar="KEY=VALUE", multiple=True, help="Override one scenario key.")
@click.option("-o", "--out", metavar="DIR", type=click.Path(path_type=Path, file_okay=False), default=Path("profile"),
              show_default=True, help="Where the flame graphs go.")  # fmt: skip
def main(scenario: str, duration: str, in_process: bool, overrides: tuple[str, ...], out: Path) -> None:
    """Run SCENARIO and show where its time goes: a table, and a flame graph (SVG) for each kind of process.

    It needs py-spy. A run that is watched is slower. The checks of the scenario are left out.

    \b
    Examples:
      python benchmarks/profile_run.py paper
      python benchmarks/profile_run.py paper --set vehicles=20 --duration '10 s' -o twenty
      python benchmarks/profile_run.py paper --in-process
    """
    changes = [*overrides, f"duration={duration}", "checks={}"]
    try:
        name = load_scenario(scenario, changes).name  # a mistake in it is told now
        words = [scenario, *(word for change in changes for word in ("--set", change)), *["--in-process"] * in_process]
        show_profile(measure_profile(words, name, out), stdout())
    except FleetError as error:
        click.echo(error, err=True)
        sys.exit(getattr(error, "status", 2))


if __name__ == "__main__":
    main()
