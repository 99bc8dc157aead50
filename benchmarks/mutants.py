"""How many small mistakes in the code do the tests notice? A mutation score, on a random sample.

It clones the project's newest commit into a folder of its own, makes one small mistake at a time (a mutant), and runs
the tests of the room with `-x`. A mutant is killed if a test fails, or the tests take far too much CPU time. The score
is the share of the mutants that are killed. Some survivors are equivalent: no test can tell them from the code.

Of a room's tests, those run that have entered the function of the mistake, the quickest first. All of the room run if
it stands outside functions, or in one that no test enters: it may run while a module is imported. The trajectories of
`tests/golden/test_golden.py` are tests of the laws and of the plant. What runs only in processes that a test starts is
not seen to be entered.

    python benchmarks/mutants.py --room agents --count 75
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import cProfile
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
_GOLDEN = "tests/golden/test_golden.py"
# Its law hangs until an exception is raised in it from outside, which never arrives while calls are watched.
_HANGS = "tests/addons/studies/test_one_run.py::test_a_law_that_hangs_within_a_tick_costs_its_run"
ROOMS = {  # with their tests
    "netem": ["tests/netem"],
    "agents": ["tests/agents", _GOLDEN],
    "world": ["tests/world", _GOLDEN],
    "fleet/execution": ["tests/fleet/execution", "tests/fleet/repeat", "tests/system/test_deaths.py"],
    "fleet/protocols": ["tests/fleet/protocols"],
    "fleet/recorder": ["tests/fleet/recorder", "tests/fleet/repeat", "tests/system/test_same_bytes.py"],
    "fleet/addons/studies": ["tests/addons/studies", f"--deselect={_HANGS}"],
}
MEMORY = 4 << 30  # bytes that a mutant's tests may take
LEAST_S = 30.0  # of CPU time for the tests of a mutant, beside a multiple of what they take without it
HANGS_S = 600.0  # of wall time: it waits for something; pytest-timeout ends a test that hangs earlier
COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
COMPUTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
    ast.Pow: ast.Mult, ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip


class Mutant(NamedTuple):
    """One mistake: in place of the text from `begin` to `end` (line, column in bytes) stands another."""

    path: str  # in the repository
    kind: str
    begin: tuple[int, int]
    end: tuple[int, int]
    old: str
    new: str
    function: int  # first line of the innermost function around it, its decorators included; 0: outside functions

    @property
    def words(self) -> str:
        return f"{self.path}:{self.begin[0]}: {self.kind}: {_short(self.old)} -> {_short(self.new)}"

    def apply(self, text: str) -> str:
        """The text of the file with the mistake."""
        lines = text.encode().splitlines(keepends=True)
        before = b"".join(lines[: self.begin[0] - 1]) + lines[self.begin[0] - 1][: self.begin[1]]
        after = lines[self.end[0] - 1][self.end[1] :] + b"".join(lines[self.end[0] :])
        return (before + self.new.encode() + after).decode()


class Finder(ast.NodeVisitor):
    """All mutants of a file."""

    def __init__(self, path: str, text: str) -> None:
        self.found: list[Mutant] = []
        self._path, self._text, self._function = path, text, 0
        self.visit(ast.parse(text))

    def visit(self, node: ast.AST) -> None:
        """Mutants of a node, then of those in it."""
        for kind, new in _mistakes(node):
            self._add(kind, node, new)
        match node:
            case ast.JoinedStr():  # their parts have no places of their own in Python 3.11
                return
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):
                return
            case ast.AnnAssign():  # not the annotation
                parts: list[ast.AST] = [node.value] if node.value else []
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                defaults = [each for each in (*node.args.defaults, *node.args.kw_defaults) if each is not None]
                for part in (*node.decorator_list, *defaults):
                    self.visit(part)
                outer, self._function = self._function, min(d.lineno for d in (*node.decorator_list, node))
                for part in node.body:
                    self.visit(part)
                self._function = outer
                return
            case ast.Lambda():
                parts = [node.body]
            case _:
                parts = list(ast.iter_child_nodes(node))
        for part in parts:
            self.visit(part)

    def _add(self, kind: str, node: Any, new: ast.AST) -> None:
        where = node.test if isinstance(node, ast.If) else node
        old = ast.get_source_segment(self._text, where) or ""
        text = ast.unparse(ast.fix_missing_locations(new))
        # Brackets keep the order of evaluation, whatever stands around it; a statement needs none.
        text = text if isinstance(node, ast.AugAssign) else f"({text})"
        begin, end = (where.lineno, where.col_offset), (where.end_lineno, where.end_col_offset)
        self.found.append(Mutant(self._path, kind, begin, end, old, text, self._function))


def _mistakes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """What may stand in place of a node; of an `if` in place of its condition."""
    match node:
        case ast.Compare():
            for k, op in enumerate(node.ops):
                ops = [*node.ops[:k], COMPARED[type(op)](), *node.ops[k + 1 :]]
                yield "comparison", ast.Compare(node.left, ops, node.comparators)
        case ast.BinOp() if type(node.op) in COMPUTED and not _is_type(node):
            yield "arithmetic", ast.BinOp(node.left, COMPUTED[type(node.op)](), node.right)
        case ast.AugAssign() if type(node.op) in COMPUTED:
            yield "arithmetic", ast.AugAssign(node.target, COMPUTED[type(node.op)](), node.value)
        case ast.BoolOp():
            op: ast.boolop = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield "boolean operator", ast.BoolOp(op, node.values)
        case ast.UnaryOp(op=ast.Not()):
            yield "removed not", node.operand
        case ast.Constant(value=bool()):
            yield "constant", ast.Constant(not node.value)
        case ast.Constant(value=int()):
            yield "constant", ast.Constant(node.value + 1)
        case ast.Constant(value=float()):
            yield "constant", ast.Constant(2.0 * node.value or 1.0)
        case ast.IfExp() if not _has_other_mutants(node.test):
            yield "swapped branches", ast.IfExp(node.test, node.orelse, node.body)
        case ast.If(test=test) if not _has_other_mutants(test) and getattr(test, "id", "") != "TYPE_CHECKING":
            yield "swapped branches", ast.UnaryOp(ast.Not(), test)


def _has_other_mutants(test: ast.AST) -> bool:
    """Whether the swap is the same as another mutant, of the condition."""
    return isinstance(test, ast.UnaryOp) or (
        isinstance(test, ast.Compare)
        and isinstance(test.ops[0], (ast.Eq, ast.NotEq, ast.Is, ast.IsNot, ast.In, ast.NotIn))
    )


def _is_type(node: ast.BinOp) -> bool:
    """Whether it is a union of types, such as int | None."""
    return isinstance(node.op, ast.BitOr) and any(
        isinstance(each, ast.Constant)
        or (isinstance(each, ast.Name) and (each.id[:1].isupper() or each.id in dir(__builtins__)))
        for each in (node.left, node.right)
    )


def _short(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 70 else f"{text[:67]}..."


def mutants_of(root: Path, room: str) -> list[Mutant]:
    """All mutants of a room, in order."""
    found = []
    for file in sorted((root / room).rglob("*.py")):
        found += Finder(str(file.relative_to(root)), file.read_text("utf-8")).found
    return found


# What pytest loads in the processes below: this file is a plugin, too.


def pytest_collection() -> None:
    """Fewer examples, and those that fail are not made smaller: that takes long, and says nothing here."""
    from hypothesis import Phase, settings

    phases = [Phase.explicit, Phase.generate]
    settings.register_profile("mutants", settings.get_profile("laws"), max_examples=25, phases=phases)
    settings.load_profile("mutants")


def pytest_unconfigure(config: Any) -> None:
    """End at once: a thread of a session that a test left open would be waited for, for ever."""
    status = getattr(config, "mutants_status", None)
    if status is not None:
        sys.stdout.flush()
        os._exit(status)


def pytest_sessionfinish(session: Any, exitstatus: int) -> None:
    """Keep the exit code for the end."""
    session.config.mutants_status = int(exitstatus)


class Entered:
    """Which functions each test enters, and its CPU time; written as JSON at the end."""

    def __init__(self, root: Path, out: Path) -> None:
        self._root, self._out = f"{root}/", out
        self._codes: set[Any] = set()  # that other threads have entered
        # Written in C: a study's run took ten times as long with a trace function, and takes twice as long with it.
        self._profiler = cProfile.Profile(subcalls=False, builtins=False)
        self._began = 0.0
        self._tests: dict[str, dict[str, Any]] = {}
        self._files: dict[str, set[tuple[str, int]]] = {}  # by file, what fixtures enter that may serve several tests

    def _trace(self, frame: Any, event: str, arg: Any) -> None:
        self._codes.add(frame.f_code)

    def _taken(self) -> set[tuple[str, int]]:
        codes, self._codes = self._codes, set()
        self._profiler.disable()
        codes |= {entry.code for entry in self._profiler.getstats() if not isinstance(entry.code, str)}
        self._profiler.clear()
        here = ((code.co_filename, code.co_firstlineno) for code in codes)
        return {(name.removeprefix(self._root), line) for name, line in here if name.startswith(self._root)}

    def pytest_runtest_setup(self, item: Any) -> None:
        self._began = time.process_time()
        threading.settrace(self._trace)
        self._profiler.enable()

    def pytest_runtest_call(self, item: Any) -> None:
        self._files.setdefault(str(item.nodeid).split("::")[0], set()).update(self._taken())
        self._profiler.enable()

    def pytest_runtest_teardown(self, item: Any) -> None:
        took = time.process_time() - self._began
        self._tests[item.nodeid] = {"entered": sorted(self._taken()), "s": took}

    def pytest_sessionfinish(self) -> None:
        self._profiler.disable()
        threading.settrace(None)  # type: ignore[arg-type]
        for name, test in self._tests.items():
            test["entered"] = sorted({*test["entered"], *self._files[name.split("::")[0]]})
        self._out.write_text(json.dumps(self._tests), "utf-8")


def pytest_configure(config: Any) -> None:
    """Watch what is entered, where that is asked for."""
    if out := os.environ.get("MUTANTS_ENTERED"):
        config.pluginmanager.register(Entered(Path.cwd(), Path(out)))


class Bench:
    """A clone of the project, in which mistakes are made."""

    def __init__(self, folder: Path) -> None:
        self.root, self._scratch = folder / "clone", folder
        subprocess.run(["git", "clone", "-q", str(ROOT), str(self.root)], check=True)

    def pytest(self, tests: list[str], limit_s: float, **more: str) -> int | None:
        """Run tests; returns pytest's exit code, None: they took longer than `limit_s` of CPU time, or hang."""
        (self._scratch / "tests").write_text("\n".join(tests), "utf-8")
        here = str(Path(__file__).resolve().parent)
        env = {**os.environ, "PYTHONPATH": f"{self.root}:{here}", **more}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "mutants", "-p", "no:cacheprovider"]
        command += ["--basetemp", str(self._scratch / "temp"), f"@{self._scratch / 'tests'}"]
        with open(self._scratch / "output", "wb") as output, subprocess.Popen(
            command, cwd=self.root, env=env, stdout=output, stderr=output, start_new_session=True,
            preexec_fn=lambda: _limit(round(limit_s)),
        ) as process:  # fmt: skip
            try:
                code = process.wait(20.0 * limit_s + HANGS_S)
                return None if code == -signal.SIGXCPU else code
            except subprocess.TimeoutExpired:
                return None
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)  # also what the tests have left behind

    def entered(self, room: str) -> dict[str, dict[str, Any]]:
        """What each test of a room enters, and its CPU time [s]."""
        out = self._scratch / "entered.json"
        if code := self.pytest(ROOMS[room], 3600.0, MUTANTS_ENTERED=str(out)):
            raise SystemExit(f"{ROOMS[room]} fail without a mutant, exit code {code}: {self._scratch / 'output'}")
        found: dict[str, dict[str, Any]] = json.loads(out.read_text("utf-8"))
        if code := self.pytest([*found, "--collect-only"], 600.0):
            raise SystemExit(f"{ROOMS[room]} cannot be named one by one, exit code {code}: {self._scratch / 'output'}")
        return found

    def outcome(self, mutant: Mutant, tests: dict[str, dict[str, Any]], room: str) -> str:
        """killed, timeout, or survived."""
        at = [mutant.path, mutant.function]
        chosen = {name: test["s"] for name, test in tests.items() if mutant.function == 0 or at in test["entered"]}
        # A function that no test enters may have run while its module was imported.
        names = _quickest_file_first(chosen) if mutant.function and chosen else ROOMS[room]
        chosen = chosen or {name: test["s"] for name, test in tests.items()}
        file = self.root / mutant.path
        text = file.read_text("utf-8")
        try:
            file.write_text(mutant.apply(text), "utf-8")
            _forget_bytecode(file)
            code = self.pytest(names, LEAST_S + 10.0 * sum(chosen.values()))
        finally:
            file.write_text(text, "utf-8")
            _forget_bytecode(file)
        return "timeout" if code is None else "killed" if code else "survived"


def _limit(cpu_s: int) -> None:
    """Bound what this process and each of its children may take."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 5))


def _quickest_file_first(chosen: dict[str, float]) -> list[str]:
    """Tests with their times, file by file: those of one share what they set up."""
    took: dict[str, float] = {}
    for name, s in chosen.items():
        took[name.split("::")[0]] = took.get(name.split("::")[0], 0.0) + s
    return sorted(chosen, key=lambda name: took[name.split("::")[0]])


def _forget_bytecode(file: Path) -> None:
    """A mutant may have the size and the second of the original, by which Python knows its bytecode."""
    for compiled in (file.parent / "__pycache__").glob(f"{file.stem}.*"):
        compiled.unlink()


def main() -> None:
    """Print each mutant with its outcome, and the score of each room."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--room", action="append", choices=ROOMS, help="only this one; may be given several times")
    parser.add_argument("--count", type=int, default=75, help="mutants of each room (default: 75)")
    parser.add_argument("--seed", type=int, default=1, help="which ones are drawn (default: 1)")
    parser.add_argument("--list", action="store_true", help="only print the mutants that would be tried")
    args = parser.parse_args()
    if args.count < 1:
        parser.error(f"--count: expected 1 or more, got {args.count}")
    scores = []
    with tempfile.TemporaryDirectory(prefix="mutants-") as name:
        bench = None if args.list else Bench(Path(name))
        for room in args.room or ROOMS:
            every = mutants_of(ROOT if bench is None else bench.root, room)
            drawn = random.Random(f"{args.seed}/{room}").sample(every, min(args.count, len(every)))
            if bench is None:
                print("\n".join(mutant.words for mutant in drawn))
                continue
            tests, begin, counts = (
                bench.entered(room),
                time.monotonic(),
                dict.fromkeys(("killed", "timeout", "survived"), 0),
            )
            for k, mutant in enumerate(drawn, 1):
                outcome = bench.outcome(mutant, tests, room)
                counts[outcome] += 1
                print(f"{room} {k}/{len(drawn)} {outcome}: {mutant.words}", flush=True)
            dead = counts["killed"] + counts["timeout"]
            told = ", ".join(f"{outcome} {n}" for outcome, n in counts.items())
            took = (time.monotonic() - begin) / 60
            score = f"{room}: {dead} of {len(drawn)} killed ({dead / len(drawn):.0%}); {told}"
            scores.append(f"{score}; drawn from {len(every)}; {took:.0f} min")
    print("\n".join(scores))


if __name__ == "__main__":
    main()
