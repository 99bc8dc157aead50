"""Programs of nodes in a stack file: whose they are, what is filled in, where numbers are, and what a record keeps."""

from __future__ import annotations

import struct
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fleet.errors import FleetError, ScenarioError
from fleet.execution.external_agents import refuse
from fleet.scenario.loading import parse_scenario
from fleet.scenario.programs import admit_programs
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.control import AgentSection
from fleet.scenario.schema.programs import (
    PLACEHOLDERS,
    expected_ending,
    fill_placeholders,
    path_of,
    programs_of,
    struct_of,
)
from fleet.scenario.sections.node_signals import node_layout, signals_of_node
from fleet.scenario.trust import Policy
from world.plugins.trust import trusting

NODES = {"m1": {}, "m2": {}, "shore": {}}
NUMBER = "x=(?P<value>.*)"


def stack(folder: Path | None = None, **sections: Any) -> Scenario:
    text = yaml.safe_dump({"title": "A stack", "nodes": NODES, "duration": "5 s", **sections}, sort_keys=False)
    return parse_scenario(text, "stack.yaml", folder=folder, policy=Policy(stranger=""))


def lines(scenario: Scenario) -> dict[str, str]:
    """The command line of each program, by its name."""
    found = programs_of(scenario.spec.programs or {}, scenario.nodes)
    return {name: " ".join(section.run) for name, _, section in found}


def test_a_pattern_means_all_its_nodes_and_a_later_entry_replaces_an_earlier_one() -> None:
    """Of the same program; a robot may have several programs, each with a name of its own."""
    programs = {"m*": "first", "*/nav": "nav {number}", "m2": "second 'of two'", "m1/nav": ["own", 7], "shore": "s"}
    found = lines(stack(programs={key: {"run": run} for key, run in programs.items()}))
    assert found == {
        "m1": "first", "m1/nav": "own 7", "m2": "second of two", "m2/nav": "nav {number}",
        "shore/nav": "nav {number}", "shore": "s",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("check", "expected"),
    [
        ("done", {"m1": "done", "m1/nav": "done", "m2": "done"}),
        ({"m1": "done"}, {"m1": "done", "m1/nav": "done", "m2": "running"}),
        ({"*": "done", "m2": "running"}, {"m1": "done", "m1/nav": "done", "m2": "running"}),
        ({"m1": "done", "m*": "running", "m1/nav": "done"}, {"m1": "running", "m1/nav": "done", "m2": "running"}),
        ({"*/nav": "done"}, {"m1": "running", "m1/nav": "done", "m2": "running"}),
    ],
)
def test_the_last_entry_that_fits_says_what_a_program_has_to_do(check: Any, expected: dict[str, str]) -> None:
    """Names of nodes stand for programs here, and not for numbers of vehicles."""
    found = stack(programs={"m*": {"run": "a"}, "m1/nav": {"run": "b"}}, checks={"programs": check})
    judged = found.spec.checks.programs
    names = programs_of(found.spec.programs or {}, found.nodes)
    assert {name: expected_ending(judged, name, node) for name, node, _ in names} == expected
    assert parse_scenario(found.to_yaml(), "again.yaml").spec.checks.programs == judged


def test_the_record_of_a_run_with_programs_loads_to_an_equal_scenario(tmp_path: Path) -> None:
    """From any folder: the folders of programs are absolute in it. What a run shows of a file is in its words."""
    (tmp_path / "sub").mkdir()
    ready = [{"line": "up [0-9]+$"}, {"token": "a/{node}"}, {"key": "b/**"}, {"port": 80}, {"after": "1 s"}]
    programs = {f"m1/p{n}": {"run": "a {listen}", "ready": one | {"within": "90 s"}} for n, one in enumerate(ready)} | {
        "m*": {"run": ["b", "{dir}"], "env": {"N": 5}, "in": "sub", "nice": 3, "stop": {"signal": "INT"}}
    }
    signals = {
        "a": {"of": "m*", "line": NUMBER, "unit": "m"}, "b": {"message": "k/{node}", "json": "[0].x"},
        "c": {"message": "k", "msgpack": ""}, "d": {"message": "udp/900", "struct": "<Hf[1]"},
        "e": {"message": "k", "count": "yes"}, "f": {"message": "/odom", "ros": "pose.pose.position.x"},
        "g": {"message": "k", "cbor": "y"},
    }  # fmt: skip
    found = stack(
        tmp_path, programs=programs, signals=signals, begin="2 s", compose="c.yaml",
        nodes=NODES | {"m1": {"udp": {"900": "m2:901"}}},
        faults=[{"at": "1 s", "for": "1 s", "kill": "m1"}, {"at": "3 s", "for": "1 s", "pause": "m1,m2"}],
        checks={"programs": "running", "signal": [{"topic": "a", "above": "0 m"}, {"topic": "e", "below": 3}]},
    )  # fmt: skip
    text = found.to_yaml()
    again = parse_scenario(text, "again.yaml")
    assert again == found
    assert again.to_yaml() == text
    assert (again.spec.programs or {})["m*"].folder == str(tmp_path / "sub")
    assert (again.spec.programs or {})["m1/p0"].folder == str(tmp_path)
    assert again.spec.compose == str(tmp_path / "c.yaml")
    assert 'N: "5"' in text and "kill: m1\n" in text.replace("}", "\n") and "programs: running" in text


def test_a_file_of_zenoh_is_found_from_the_record_as_well(tmp_path: Path) -> None:
    """A run of a study is made from its record, which lies elsewhere."""
    nodes = NODES | {"m1": {"listen": "tcp/127.0.0.1:7501", "zenoh": "keys/m1.json5"}}
    found = stack(tmp_path, nodes=nodes)
    assert (found.spec.nodes or {})["m1"].zenoh == str(tmp_path / "keys" / "m1.json5")
    assert parse_scenario(found.to_yaml(), "again.yaml") == found


@given(st.text("{}nodesumbr1 ", max_size=30), st.dictionaries(st.sampled_from(PLACEHOLDERS), st.integers()))
def test_only_known_placeholders_are_filled(text: str, values: dict[str, int]) -> None:
    """Other braces stay as they are, so that JSON may stand in a command line."""
    expected = text
    for name in PLACEHOLDERS:
        expected = expected.replace(f"{{{name}}}", str(values.get(name, f"{{{name}}}")))
    assert fill_placeholders(text, values) == expected


def test_what_is_filled_in_is_not_filled_in_again() -> None:
    assert (
        fill_placeholders('{"a": {node}} {listen} {no}', {"node": "{number}", "number": 3})
        == '{"a": {number}} {listen} {no}'
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [("", []), ("[0][-2]", [0, -2]), ("pose.x", ["pose", "x"]), ("a[1].b2._c", ["a", 1, "b2", "_c"]), (".a", ["a"])],
)
def test_a_path_is_steps(text: str, expected: list[str | int]) -> None:
    assert path_of(text) == expected


@pytest.mark.parametrize(
    "text", ["", "[0]", "<", "<Hf[2]", "<Hf[-1]", "<z", "x", "4x", "70000s", "<Hf[1] ", "99999999999B"]
)
def test_a_layout_without_such_a_number_is_none(text: str) -> None:
    assert struct_of(text) is None


@given(st.lists(st.sampled_from("bBhHiIqQfd"), min_size=1, max_size=6), st.data())
def test_a_layout_is_that_of_pythons_struct(kinds: list[str], data: st.DataObject) -> None:
    which = data.draw(st.integers(0, len(kinds) - 1))
    found = struct_of(f"<{''.join(kinds)}[{which}]")
    assert found is not None
    assert (found[0].size, found[1]) == (struct.calcsize(f"<{''.join(kinds)}"), which)


def test_a_signal_is_that_of_its_nodes_in_the_order_of_the_file() -> None:
    signals = {"b": {"line": NUMBER, "of": "m*"}, "a": {"line": "x", "count": "yes", "unit": "1"}}
    found = stack(programs={"m*": {"run": "a"}}, signals=signals)
    assert [list(signals_of_node(found.spec, i)) for i in (1, 2, 3)] == [["b", "a"], ["b", "a"], ["a"]]
    assert [signal.name for signal in node_layout(found.spec, 1).control] == ["b", "a"]


def test_programs_of_a_stranger_need_the_users_word() -> None:
    """The refusal names the command and its folder; a study asks before it makes any run."""
    scenario = stack(programs={"m1": {"run": "rm 'a b'"}}, compose="c.yaml")
    admit_programs(scenario.spec, Policy(stranger=""))
    with pytest.raises(FleetError) as caught:
        admit_programs(scenario.spec, Policy())
    assert "m1" in str(caught.value) and "rm 'a b'" in str(caught.value) and "--trust" in str(caught.value)
    with trusting(True):
        admit_programs(scenario.spec, Policy())


def test_what_makes_runs_of_stacks_needs_their_programs_and_their_end() -> None:
    """It starts them, and waits for the end of each run."""
    refuse(stack(programs={"m1": {"run": "a"}}), "a run of a study", stacks=True)
    with pytest.raises(FleetError, match="name some in programs"):
        refuse(stack(), "a run of a study", stacks=True)
    endless = parse_scenario("title: x\nnodes: {a: {}, b: {}}\nprograms: {a: {run: x}}\n", "x.yaml")
    with pytest.raises(FleetError, match="duration"):
        refuse(endless, "a run of a study", stacks=True)
    with pytest.raises(FleetError, match="fleet netem runs it"):
        refuse(stack(programs={"m1": {"run": "a"}}), "fleet rare")


WHOLE: dict[str, Any] = {
    "nodes": NODES | {"m3": {}}, "begin": "1 s", "compose": "c.yaml",
    "programs": {"m1": {"run": "a {listen}", "ready": {"after": "1 s"}}, "shore/gcs": {"run": "b"}},
    "signals": {"x": {"of": "m1", "line": NUMBER}, "y": {"message": "k", "json": ""}},
    "faults": [{"at": "1 s", "for": "1 s", "kill": "m1"}, {"at": "2 s", "pause": "shore"}, {"at": "1 s", "mute": "m2"}],
    "graph": {"edges": ["m1-m2", "m2-m3", "m3-shore"]}, "network": {"links": {"m1->m2": "loss 3%"}},
    "checks": {
        "programs": {"m1": "done", "shore/gcs": "running"},
        "signal": [{"topic": "x", "above": 0}, {"topic": "y", "above": 0}],
    },
}  # fmt: skip


@pytest.mark.parametrize(
    ("section", "entry", "wrong", "place", "hint"),
    [
        ("programs", "m1", {"comand": "a"}, "comand", '"run"'),
        ("programs", "m1", {"command": ["a"], "nice": 3}, "command", '"run"'),
        ("programs", "m1", {"run": "a", "redy": {}}, "redy", '"ready"'),
        ("programs", "m1", {"run": 5}, "run", "run: [python"),
        ("programs", "m1", {}, "run", ""),
        ("programs", "m1", "python a.py", "m1", "write {key: value}"),
        ("programs", "shore/gcs", {"run": "a", "ready": {"lin": "x"}}, "lin", '"line"'),
        ("signals", "x", {"lin": NUMBER}, "lin", '"line"'),
        ("signals", "x", {"line": "("}, "line", ""),
        ("nodes", "m1", {"lisen": "tcp/127.0.0.1:7501"}, "lisen", '"listen"'),
        ("nodes", "m1", {"zenoh": 5}, "zenoh", "quotes"),
    ],
)
def test_what_names_a_wrong_entry_is_no_further_mistake(
    section: str, entry: str, wrong: Any, place: str, hint: str
) -> None:
    """A program with one typo was missing for its check and for faults, too, and `run` was missing beside `comand`."""
    stack(**WHOLE)
    with pytest.raises(ScenarioError) as caught:
        stack(**WHOLE | {section: WHOLE[section] | {entry: wrong}})
    (problem,) = caught.value.problems
    assert problem.key.endswith(place) and hint in problem.hint


def test_the_typo_in_the_only_program_leaves_nothing_without_effect() -> None:
    with pytest.raises(ScenarioError) as caught:
        stack(nodes=NODES, begin="1 s", programs={"m*": {"rn": "a"}}, checks={"programs": "running"})
    assert [problem.key for problem in caught.value.problems] == ["programs.m*.rn"]


def refused(**sections: Any) -> list[str]:
    """Each mistake: its key, message and hint."""
    with pytest.raises(ScenarioError) as caught:
        stack(**sections)
    return [f"{problem.message} | {problem.hint}" for problem in caught.value.problems]


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ({"run": ["a", "--to={lisen}"]}, 'programs.m1.run: {lisen} is no placeholder: did you mean "listen"?'),
        ({"run": "a {Node}"}, 'programs.m1.run: {Node} is no placeholder: did you mean "node"?'),
        ({"run": "a", "env": {"X": "{seeds}"}}, 'programs.m1.env.X: {seeds} is no placeholder: did you mean "seed"?'),
        (
            {"run": "a", "ready": {"key": "k/{name}"}},
            "programs.m1.ready.key: {name} is no placeholder: {node} and {number} are",
        ),
        (
            {"run": "a", "ready": {"token": "{listen}"}},
            "programs.m1.ready.token: {listen} is no placeholder: {node} and {number} are",
        ),
    ],
)
def test_an_unknown_placeholder_is_a_mistake(section: dict[str, Any], expected: str) -> None:
    """It was filled in as it stood, and the program got `{lisen}`."""
    (found,) = refused(programs={"m1": section})
    assert found == f"{expected} | "


def test_other_braces_of_a_command_line_are_its_own() -> None:
    """Of JSON, of a shell, of a format of the program's own."""
    for run in ('a {"seeds": {node}}', "sh -c 'echo ${seeds} {code} {}'", "a {1} {}", "curl -w %{http_code}"):
        stack(programs={"m1": {"run": run}})


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("a/{nam}/b", "signals.x.message: {nam} is no placeholder: {node} and {number} are | "),
        ("udp/901", "signals.x.message: none of its nodes has the port udp/901 | they have udp/900"),
        ("udp/9{number}0", "signals.x.message: none of its nodes has the port udp/910 | they have udp/900"),
        ("udp/abc", "signals.x.message: none of its nodes has the port udp/abc | they have udp/900"),
    ],
)
def test_a_signal_is_in_messages_that_can_come(message: str, expected: str) -> None:
    """A port that no node has was accepted, and the signal never spoke."""
    nodes = NODES | {"m1": {"udp": {"900": "m2:77"}}, "m2": {"udp": {"920": "m1:78"}}}
    (found,) = refused(nodes=nodes, signals={"x": {"of": "m1", "message": message, "struct": "<H"}})
    assert found == expected
    for own in ("udp/900", "udp/9{number}0"):
        stack(nodes=nodes, signals={"x": {"message": own, "struct": "<H"}})


@pytest.mark.parametrize(("key", "meant"), [("signal", "signals"), ("program", "programs"), ("check", "checks")])
def test_a_section_with_another_name_is_one_mistake_with_the_name_that_was_meant(key: str, meant: str) -> None:
    """What is in it is named elsewhere, and that is no further mistake."""
    sections = WHOLE | {"carry": ["k"]}
    sections[key] = sections.pop(meant)
    (found,) = refused(**sections)
    assert found == f'"{key}" has no meaning for nodes | did you mean "{meant}"?'


@pytest.mark.parametrize(
    ("signal", "expected"),
    [
        ({"message": "k", "json": "a" * 60 + "!"}, "expected a path such as [0][2] or pose.x"),
        ({"message": "k", "json": "a" * 2000}, "expected a path such as [0][2] or pose.x"),
        ({"line": "(?P<value>a{99999999999})"}, "is no regular expression"),
        ({"line": "(" * 5000 + ")" * 5000}, "has 10000 characters: 1000 at most"),
        ({"line": "(" * 50 + ")" * 50}, "line names no group"),
        ({"of": "[a" * 5000, "message": "k", "count": True}, "at most 1000 characters"),
    ],
)
def test_a_strangers_pattern_is_refused_and_holds_up_no_reader(signal: dict[str, Any], expected: str) -> None:
    """The first one had more ways to be a path than anybody can try; the next two were tracebacks."""
    found = refused(**WHOLE | {"signals": {"x": signal}})
    assert any(expected in each for each in found), found


def test_now_is_a_number_in_the_scenario_that_a_run_keeps() -> None:
    """The same for all vehicles, so that the run can be made again."""
    sections = [AgentSection.model_validate({"program": "p.py", "epoch": "now"}) for _ in range(2)]
    first, second = (dict(section.parameters or {})["epoch"] for section in sections)
    assert first == second and datetime.fromisoformat(first).replace(tzinfo=UTC).year >= 2026
    given = AgentSection.model_validate({"program": "p.py", "epoch": "2026-06-01T12:00:00"})
    assert given.parameters == {"epoch": "2026-06-01T12:00:00"}
