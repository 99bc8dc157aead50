"""Makes a scenario that fails a check as small as possible, so that it still fails.

Runs are deterministic: a scenario that fails once fails each time. Runs of programs on the wall clock are not, so two
of three have to fail. The steps are: leave out faults and triggers, and
then vehicles, sides and links of each fault (`ddmin`); shorten the run, shorten each fault and make it milder, and at
last leave out the last vehicles. They repeat until no step helps any more.
The candidates of one step run side by side. The smallest candidate that fails is taken, so the result does not depend
on the number of workers.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from fractions import Fraction
from itertools import pairwise
from math import inf, isfinite
from typing import Any, NamedTuple, TypeVar

from agents.controllers import laws
from fleet.addons.studies.engine_interface import Engine
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import NO_MODULES, Modules
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.plan import run_key
from fleet.addons.studies.row import FAILED, Row, majority
from fleet.addons.studies.targets import Targets, narrower, targets
from fleet.analysis.verdicts import PROGRAMS
from fleet.errors import ScenarioError
from fleet.execution.external_agents import refuse
from fleet.quantities import show_time, time_ns
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.programs import DONE
from fleet.scenario.sections.node_names import values_to_numbers
from fleet.scenario.text.yaml_reader import Source, plain, read
from netem.parsing import NUMBER
from world.plugins.loading import unit_file

MOST_ROUNDS = 5  # over everything, and over each number
_SHARES = (Fraction(1, 4), Fraction(1, 2), Fraction(3, 4), Fraction(9, 10))  # of a number that is made less
TIMES = frozenset({"at", "for", "id"})
_MORE_IS_WORSE = ("delay", "loss", "duplicate", "corrupt", "reorder")  # words of a link's condition
_NUMBER = re.compile(rf"(?<![\w.])({NUMBER.pattern})(?=\s*[^\W\d_]|\s*%|\s+[-+.\d]|\s*$)", re.ASCII)

Tree = dict[str, Any]  # a scenario as plain values


class Shrunk(NamedTuple):
    scenario: Scenario  # the smallest scenario
    check: str  # the check that fails
    found: tuple[str, str]  # the finding of that check, for the first scenario and for the smallest one
    runs: int  # the number of runs made
    steps: list[str]  # the reductions, in words and in order
    digest: str  # digest of the log of the smallest scenario's run


class Shrinker:
    def __init__(
        self, scenario: Scenario, engine: Engine, on_progress: Callable[[str, int], None], modules: Modules = NO_MODULES
    ) -> None:
        """Prepare it. `scenario`: its run fails a check. `on_progress`: called now and then with the present step, in
        words, and the number of runs made."""
        self._name, self._engine, self._tell, self._modules = scenario.name, engine, on_progress, modules
        self._rows: dict[str, Row] = {}  # by key of the run
        self._doing, self._left = "the run as it is", 1  # what is tried; runs that may still be made
        self._check = ""
        refuse(scenario, "a run of a study", stacks=True)
        self._tree, self._links = tree_of(scenario), scenario.graph.links
        self._are_told = are_told(scenario)

    def shrink(self, check: str | None = None, most_runs: int = 10_000) -> Shrunk:
        """Make the scenario smaller until no step helps, or `most_runs` runs were made. `check`: this check must still
        fail. None: the first check that fails. `most_runs`: limit on the number of runs. Raises StudyError: the
        scenario fails no check, or not this one."""
        self._left = most_runs
        first = self._run([self._tree])[0]
        self._check = self._failed(first, check)
        steps: list[str] = []
        for _ in range(MOST_ROUNDS):
            before = json.dumps(self._tree)
            for step in (
                *(self._fewer_faults, self._fewer_targets, self._shorter, self._shorter_faults, self._milder),
                *([] if self._are_told else [self._fewer_vehicles]),
            ):
                steps += step()
            if json.dumps(self._tree) == before:
                break
        last = self._run([self._tree])[0]
        least = parse_scenario(json.dumps(self._tree), self._name)
        return Shrunk(least, self._check, (_describe_found(first, self._check), _describe_found(last, self._check)),
                      len(self._rows), steps, last.digest or "")  # fmt: skip

    def _failed(self, row: Row, check: str | None) -> str:
        failing = row.failed_checks
        if not row.judged:
            raise StudyError(f"the run does not come to its end: {row.reason}")
        if not failing:
            raise StudyError("every check passes: there is nothing to shrink")
        if check is not None and check not in failing:
            raise StudyError(f"the check {check} does not fail; these do: {', '.join(failing)}")
        return check or failing[0]

    def _fewer_faults(self) -> Iterator[str]:
        for key in ("faults", "triggers"):
            faults, self._doing = self._tree.get(key) or [], f"fewer {key}"

            def fails(parts: list[list[Tree]], key: str = key) -> list[bool]:
                return self._fail([{**self._tree, key: part} for part in parts])

            left = ddmin(faults, fails)
            if len(left) < len(faults):
                self._tree[key] = left
                yield f"{len(left)} of {len(faults)} {key} are needed"

    def _fewer_targets(self) -> Iterator[str]:
        """Faults of fewer vehicles or links, and partitions that cut off fewer vehicles."""
        for k, fault in enumerate(self._tree.get("faults") or []):
            kind, name = _kind(fault), fault.get("id", k + 1)
            self._doing = f"fault {name} of fewer targets"
            if (found := _targets(self._tree, k)) is not None:

                def made(part: list[Any], found: Targets = found, k: int = k, kind: str = kind) -> Tree:
                    return _with_fault(self._tree, k, {kind: found.value(part, self._tree["vehicles"])})

                def fails(parts: list[list[Any]], made: Callable[[list[Any]], Tree] = made) -> list[bool]:
                    return self._fail([made(part) for part in parts]) if parts != [[]] else [False]

                left = ddmin(found.items, fails)
                if len(left) < len(found.items):
                    self._tree = made(left)
            tree: Tree | None = self._tree
            while tree is not None:
                self._tree = tree
                links = [link for link in self._links if max(link) <= tree["vehicles"]]
                less = narrower(kind, tree["faults"][k][kind], links)
                tree = self._least([_with_fault(self._tree, k, {kind: value}) for value in less])
            if (now := self._tree["faults"][k][kind]) != fault[kind]:
                yield f"fault {name} is {kind} {_words(now)} instead of {_words(fault[kind])}"

    def _shorter(self) -> Iterator[str]:
        """A run that ends earlier, but not before its check begins: it would fail for that reason alone."""
        checks = self._tree.get("checks") or {}
        waits = self._check == PROGRAMS and DONE in str(checks.get(PROGRAMS))
        if self._check == "recovery_time" or waits:  # which an earlier end always fails
            return
        self._doing = "a shorter run"
        before = self._tree["duration"]
        tick = time_ns(self._tree["tick"])
        end = self._shortened(time_ns(before), tick, lambda time: {**self._tree, "duration": time})
        if end < time_ns(before):
            yield f"{self._tree['duration']} instead of {before}"

    def _shortened(self, ns: int, step: int, made: Callable[[str], Tree]) -> int:
        """The shortest time [ns], in whole steps, with which the run still fails. `made`: the scenario with a time."""
        while True:
            shorter = [time for share in _SHARES if 0 < (time := int(share * ns) // step * step) < ns]
            trees = [made(show_time(time)) for time in shorter]
            if (tree := self._least(trees)) is None:
                return ns
            self._tree, ns = tree, shorter[trees.index(tree)]

    def _fewer_vehicles(self) -> Iterator[str]:
        self._doing = "fewer vehicles"
        before = self._tree["vehicles"]
        made = [_without_vehicles(self._tree, n) for n in range(1, before)]
        failing = [tree for tree, failed in zip(made, self._fail(made), strict=True) if failed]
        if any(self._tree.get(key) for key in ("faults", "triggers")):
            # A fleet that is too small may fail by itself: nobody is left to agree with. That is another failure.
            bare = [{**tree, "faults": [], "triggers": []} for tree in failing]
            failing = [tree for tree, alone in zip(failing, self._fail(bare), strict=True) if not alone]
        tree = failing[0] if failing else None
        if tree is not None:
            self._tree = tree
            yield f"{tree['vehicles']} of {before} vehicles are needed"

    def _shorter_faults(self) -> Iterator[str]:
        for k, fault in enumerate(self._tree.get("faults") or []):
            self._doing = f"fault {fault.get('id', k + 1)} shorter"
            if "for" not in fault:
                continue
            before = time_ns(fault["for"])

            def lasting(time: str, k: int = k) -> Tree:
                return _with_fault(self._tree, k, {"for": time})

            lasts = self._shortened(before, 10**6, lasting)
            if lasts < before:
                yield f"fault {fault.get('id', k + 1)} lasts {show_time(lasts)} instead of {show_time(before)}"

    def _milder(self) -> Iterator[str]:
        for k in range(len(self._tree.get("faults") or [])):
            fault = self._tree["faults"][k]
            kind = _kind(fault)
            if not KINDS[kind].every_number_strengthens:
                continue
            self._doing = f"fault {fault.get('id', k + 1)} milder"
            for place in number_places(fault[kind]):
                for _ in range(MOST_ROUNDS):
                    tree = self._least(list(self._weaker(k, kind, place)))
                    if tree is None:
                        break
                    self._tree = tree
            now = self._tree["faults"][k]
            if now != fault:
                yield f"fault {fault.get('id', k + 1)} is {_words(now[kind])} instead of {_words(fault[kind])}"

    def _weaker(self, k: int, kind: str, place: int) -> Iterator[Tree]:
        value = self._tree["faults"][k][kind]
        for share in (Fraction(0), *_SHARES):
            less = scale_number(value, place, share)
            if less != scale_number(value, place, Fraction(1)):
                yield _with_fault(self._tree, k, {kind: less})

    def _least(self, candidates: Sequence[Tree]) -> Tree | None:
        """The first of the candidates that fails; they are given from the least on."""
        return next((tree for tree, failed in zip(candidates, self._fail(candidates), strict=True) if failed), None)

    def _fail(self, trees: Sequence[Tree]) -> list[bool]:
        """Whether the run of each comes to its end and fails the check, and not because there was nothing to judge."""
        found = (row.checks.get(self._check) for row in self._run(trees))
        return [check is not None and not check.passed and check.value is not None for check in found]

    def _run(self, trees: Sequence[Tree]) -> list[Row]:
        if not self._modules.programs:
            return self._run_each(trees, "")
        rounds = [self._run_each(trees, ""), self._run_each(trees, "again")]
        rows: list[list[Row]] = [[*each] for each in zip(*rounds, strict=True)]
        open_ = [n for n, two in enumerate(rows) if majority(two, self._check)[1:] not in ((0, 2), (2, 2))]
        for n, row in zip(open_, self._run_each([trees[n] for n in open_], "once more"), strict=True):
            rows[n].append(row)
        return [majority(each, self._check)[0] for each in rows]

    def _run_each(self, trees: Sequence[Tree], which: str) -> list[Row]:
        """The row of each. `which`: of several runs of the same, on the wall clock."""
        texts = [json.dumps(tree) for tree in trees]
        keys = [run_key(text + which) for text in texts]
        new = {key: text for key, text in zip(keys, texts, strict=True) if key not in self._rows}
        wanted = dict(list(new.items())[: self._left])
        self._left -= len(wanted)
        tasks = (Task(key, 0, self._tree["seed"], self._name, text, inf, self._modules) for key, text in wanted.items())

        def take(rows: list[Row]) -> None:
            self._rows.update({row.key: row for row in rows})
            self._tell(self._doing, len(self._rows))

        self._engine.make(tasks, take, lambda: self._tell(self._doing, len(self._rows)))
        none = Row(seed=self._tree["seed"], status=FAILED, reason="the runs are used up")
        return [self._rows.get(key, none) for key in keys]


def are_told(scenario: Scenario) -> bool:
    """Whether programs or laws know how many vehicles there are: programs may, and a law that has the number, or a list
    of as many, among its parameters. Then a fleet without some of them is another one.
    """
    every = [each for its in scenario.controls for each in laws(its).items()]
    if scenario.names or any(unit_file(kind, law.name) for kind, law in every):
        return True
    told = [value for _, law in every for value in law.parameters.values()]
    counts = [len(each) if isinstance(each, list) else each for each in told]
    return any(type(count) is int and count == scenario.vehicles for count in counts)


def tree_of(scenario: Scenario) -> Tree:
    root, problems = read(Source(scenario.name, scenario.to_yaml()))
    if root is None or problems:
        raise ScenarioError(problems)
    values: Tree = plain(root)
    if scenario.nodes:  # inside, nodes have numbers
        faults = values_to_numbers(values.get("faults") or [], scenario.nodes)
        values |= {"vehicles": scenario.vehicles, "faults": faults}
    return values


def _describe_found(row: Row, check: str) -> str:
    value = row.checks[check].value
    return "no finite value" if value is None or not isfinite(value) else f"{value:.4g}"


def _kind(fault: Tree) -> str:
    return next(key for key in fault if key not in TIMES)


def _targets(tree: Tree, k: int) -> Targets | None:
    fault = tree["faults"][k]
    kind, name = _kind(fault), fault.get("id", f"f{k + 1}")
    return targets(kind, fault[kind], tree["vehicles"], tree["seed"], name)


def _with_fault(tree: Tree, k: int, changes: Tree) -> Tree:
    faults = [dict(fault) for fault in tree["faults"]]
    faults[k] |= changes
    return {**tree, "faults": faults}


def _without_vehicles(tree: Tree, n: int) -> Tree:
    """The scenario with the first n vehicles. If a fault concerns others alone, or something else names them, it is no
    valid scenario."""
    made = deepcopy(tree)
    made["vehicles"] = n
    for k, fault in enumerate(made.get("faults") or []):
        kind, found = _kind(fault), _targets(tree, k)
        if kind != "link" and found is not None and (left := [i for i in found.items if i <= n]):
            fault[kind] = found.value(left, n) if kind == "partition" or left != found.items else fault[kind]
    if isinstance(offsets := (made.get("formation") or {}).get("offsets"), list):
        made["formation"]["offsets"] = offsets[:n]
    if isinstance(made.get("initial"), list):
        made["initial"] = made["initial"][:n]
    return made


def number_places(value: Any) -> list[int]:
    """The numbers of a value that make the fault stronger, counted over all its texts."""
    found, count = [], 0
    for text in _texts(value):
        for match in _NUMBER.finditer(text):
            words = re.findall(r"[a-z]{4,}", text[: match.start()])
            if not words or (words[-1] in _MORE_IS_WORSE and "gemodel" not in text and "state" not in text):
                found.append(count)
            count += 1
    return found


def _texts(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [text for key, inner in value.items() if key != "vehicles" for text in _texts(inner)]
    return [str(value)]


def scale_number(value: Any, place: int, share: Fraction) -> Any:
    """The value with its number at `place`, counted over all its texts, times a share."""
    seen = 0

    def scale(match: re.Match[str]) -> str:
        nonlocal seen
        seen += 1
        return f"{float(Fraction(match[1]) * share):.4g}" if seen - 1 == place else match[0]

    def walk(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: inner if key == "vehicles" else walk(inner) for key, inner in value.items()}
        return _NUMBER.sub(scale, str(value))

    return walk(value)


def _words(value: Any) -> str:
    return json.dumps(value) if isinstance(value, dict) else str(value)


T = TypeVar("T")


def ddmin(items: Sequence[T], fails: Callable[[list[list[T]]], Sequence[bool]]) -> list[T]:
    """Delta debugging: a part of `items`, in their order, that fails and needs each of its items to fail.

    The algorithm ddmin of Zeller and Hildebrandt, "Simplifying and isolating failure-inducing input", IEEE Trans.
    Software Eng. 28 (2002), section 3.2. It is exact where a test gives the same answer each time, as a run of a
    scenario does. All parts of one size are tested side by side. Among those that fail it takes the first one, so the
    speed of workers changes nothing.

    Args:
        items: a list that fails.
        fails: says of each of some parts whether it fails. The empty list is asked for first.
    """
    if not items or fails([[]])[0]:
        return []
    left = list(items)
    pieces = 2
    while len(left) > 1:
        borders = [round(k * len(left) / pieces) for k in range(pieces + 1)]
        parts = [left[begin:end] for begin, end in pairwise(borders)]
        rests = [left[:begin] + left[end:] for begin, end in pairwise(borders)]
        # With two pieces each rest is the other part.
        found = _first(parts, fails)
        if found is not None:
            left, pieces = found, 2
        elif pieces > 2 and (found := _first(rests, fails)) is not None:
            left, pieces = found, pieces - 1
        elif pieces < len(left):
            pieces = min(2 * pieces, len(left))
        else:
            break
    return left


def _first(parts: list[list[T]], fails: Callable[[list[list[T]]], Sequence[bool]]) -> list[T] | None:
    return next((part for part, failed in zip(parts, fails(parts), strict=True) if failed), None)
