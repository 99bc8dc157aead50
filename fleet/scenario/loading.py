"""Read a scenario, shipped or from a file, apply overrides, and report every mistake at once."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fleet.errors import Problem, ScenarioError
from fleet.quantities import describe_value
from fleet.scenario.catalogue import shipped_scenarios, shipped_text
from fleet.scenario.parts import Parts
from fleet.scenario.scenario import Reading, Scenario
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.text import scenario_yaml
from fleet.scenario.text.nodes import nodes_to_vehicles, with_moored_defaults
from fleet.scenario.text.overrides import Override, apply
from fleet.scenario.text.simulated_nodes import SIMULATED, command_folders, simulated_values
from fleet.scenario.text.yaml_reader import Mapping, Scalar, Source, plain, read
from fleet.scenario.text.yaml_writer import yaml_text
from fleet.scenario.trust import READING, TYPED, OverrideOrigin, Policy, ran_from, stranger
from fleet.scenario.validation import validate
from netem.files import read_bounded, read_file
from netem.limits import SCENARIO
from netem.parsing import nearest


def load_scenario(
    name_or_path: str | Path,
    overrides: Sequence[str | Override] = (),
    *,
    imports: bool = True,
    refused: list[Problem] | None = None,
    origin: OverrideOrigin = TYPED,
) -> Scenario:
    """The scenario of a shipped name or of a file, with overrides applied.

    Args:
        overrides: changes by options; a text alone is `key.path=value`, as for `--set`.
        imports: import the laws that the file names, to check that they can be used.
        refused: a list that receives the laws that may not run. None: such a law is an error.
        origin: the source of the overrides.

    Raises ScenarioError: with every mistake that was found, in the order of the file.
    """
    shown, text, folder = _text(str(name_or_path))
    why = origin.stranger or ("" if folder is None else stranger(Path(shown)))
    policy = Policy(why, imports, refused, origin.typed, own=ran_from(text) if why else ())
    return parse_scenario(text, shown, overrides, folder, policy)


def parse_scenario(
    text: str,
    source_name: str,
    overrides: Sequence[str | Override] = (),
    folder: Path | None = None,
    policy: Policy = READING,
) -> Scenario:
    """The scenario that `text` describes. A text without a name is named after its source.

    Args:
        overrides: changes by options; a text alone is `key.path=value`, as for `--set`.
        folder: the search for files of vehicles, and for modules of laws that are not installed, begins here. The
            current directory follows.
        policy: these modules may run; by default none.

    Raises ScenarioError: with every mistake that was found, in the order of the text.
    """
    source = Source(source_name, text)
    root, problems = read(source)
    if not isinstance(root, Mapping):
        if root is not None:
            got = describe_value(plain(root))
            problems.append(root.place.problem(f"expected keys with values, such as duration: 30 s; got {got}"))
        raise ScenarioError(problems)
    if "name" not in root.entries:
        name = re.sub(r"[^a-z0-9_-]+", "-", Path(source_name).stem.lower()).strip("-_")[:64] or "scenario"
        root = root.with_entry("name", root.place, Scalar(name, root.place))
    root, more = apply(root, overrides)
    root = nodes_to_vehicles(root, problems) if "nodes" in root.entries else with_moored_defaults(root)
    parts, mistakes = validate(root, folder, policy)
    problems += [*more, *mistakes]
    if parts is None or problems:
        raise ScenarioError(sorted(problems, key=lambda p: _order(p, source, overrides)))
    reading = Reading(text, tuple(overrides), folder, policy)
    if parts.spec.clock == SIMULATED:
        parts = _simulated_parts(parts.spec, source_name, folder, policy)
    return Scenario(parts, reading, source_name)


def _simulated_parts(spec: ScenarioSpec, source_name: str, folder: Path | None, policy: Policy) -> Parts:
    """The parts of a file of nodes in simulated time. Raises ScenarioError: a program of it cannot run there."""
    made = yaml_text(simulated_values(spec, folder or Path()))
    root, problems = read(Source(f"{source_name} in simulated time", made))
    assert isinstance(root, Mapping)
    if not policy.stranger:
        policy = replace(policy, own=(*policy.own, *command_folders(spec)))
    parts, mistakes = validate(root, folder, policy)
    if parts is None or problems or mistakes:
        raise ScenarioError([*problems, *mistakes])
    return parts


def with_overrides(scenario: Scenario, overrides: Sequence[str | Override]) -> Scenario:
    """Read the text of a scenario once more, with further overrides after the earlier ones.

    All values that the seed draws are drawn anew. Problems name the lines of the file. Raises ScenarioError.
    """
    text, before, folder, policy = scenario.reading
    return parse_scenario(text, scenario.source, [*before, *overrides], folder, replace(policy, refused=None))


def short_text(scenario: Scenario) -> str:
    """The text of a scenario with nothing that is so anyway; the whole text where that would be another scenario."""
    whole, short = scenario.to_yaml(), scenario_yaml.short_yaml(scenario.spec)
    try:
        again = parse_scenario(short, scenario.source, (), scenario.reading.folder, scenario.reading.policy)
    except ScenarioError:
        return whole
    return short if again.to_yaml() == whole else whole


def _order(problem: Problem, source: Source, overrides: Sequence[str | Override]) -> tuple[int, int, int]:
    rank = 0 if problem.file == source.name else 1 + [Override.of(o).name for o in overrides].index(problem.file)
    return rank, problem.line, problem.column


def _text(name_or_path: str) -> tuple[str, str, Path | None]:
    """Name of the source for problems, its text and its folder. An unknown name with a suffix or a slash is a path."""
    try:
        if name_or_path in shipped_scenarios():
            return f"{name_or_path}.yaml", shipped_text(name_or_path), None
        path = Path(name_or_path)
        if path.suffix == ".py":
            raise _unreadable(name_or_path, *_python_file(path))
        if path.suffix or "/" in name_or_path or path.exists():
            return name_or_path, _content(path).decode("utf-8-sig"), path.parent
    except UnicodeDecodeError as error:
        hint = "a log? fleet run --from goes on from one, fleet export --scenario makes a scenario of one"
        raise _unreadable(name_or_path, f"not UTF-8 text (byte {error.start})", hint) from None
    except IsADirectoryError:
        inside = path / "scenario.yaml"
        hint = f"did you mean {inside}, the scenario of that run?" if inside.exists() else ""
        raise _unreadable(name_or_path, "is a directory, not a scenario file", hint) from None
    except FileNotFoundError as error:
        raise _unreadable(name_or_path, error.strerror or str(error), _instead(path)) from None
    except (OSError, ValueError) as error:
        raise _unreadable(name_or_path, getattr(error, "strerror", None) or str(error)) from None
    hint = nearest(name_or_path, shipped_scenarios()) or "a file needs its suffix, as in my-scenario.yaml"
    raise _unreadable(name_or_path, "there is no such shipped scenario; fleet list shows them all", hint)


def _python_file(path: Path) -> tuple[str, str]:
    """The mistake in giving a Python file in place of a scenario, and a remedy."""
    wrong = "expected a scenario (YAML), got a Python file"
    beside = path.with_suffix(".yaml")
    if beside.exists():
        return wrong, f"did you mean {beside}?"
    return (wrong, f'a scenario names what is in it, as in agent: "{path.stem}:MyAgent"; fleet new writes both')


def _instead(path: Path) -> str:
    """A file or a scenario that ships which may be meant by a file that is not there."""
    other = {".yml": ".yaml", ".yaml": ".yml"}.get(path.suffix)
    if other and path.with_suffix(other).exists():
        return f"did you mean {path.with_suffix(other)}?"
    if path.stem in shipped_scenarios():
        return f"did you mean {path.stem}? The scenarios that ship have no suffix"
    try:
        files = [str(file) for file in path.parent.iterdir() if file.suffix in (".yaml", ".yml")]
    except OSError:
        files = []
    return nearest(str(path), files) or "fleet list lists the scenarios that ship, fleet new scenario NAME writes one"


def _content(path: Path) -> bytes:
    """The bytes of a file, or of an open descriptor: /dev/stdin, or /dev/fd/63 as a shell writes <(command)."""
    if path == Path("/dev/stdin") or path.parent in (Path("/dev/fd"), Path("/proc/self/fd")):
        with path.open("rb") as file:
            return read_bounded(file, SCENARIO.bytes)
    return read_file(path, SCENARIO.bytes)


def _unreadable(name: str, message: str, hint: str = "") -> ScenarioError:
    return ScenarioError([Problem(name or '""', 0, 0, message, hint)])
