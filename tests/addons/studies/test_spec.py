"""A study as people write it: its text read again is the same study, and options add to it."""

from __future__ import annotations

from inspect import signature
from math import inf
from pathlib import Path
from typing import Any

import click
import msgspec
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

import fleet
from fleet.addons.studies.option_values import BoundaryKeywords, SweepKeywords, keywords, seeds_text, set_values
from fleet.addons.studies.plan import plan_of
from fleet.addons.studies.spec import BoundarySpec, Spec, StudySpec
from fleet.addons.studies.study_file import is_file, parse_study, study_yaml
from fleet.addons.studies.values import axis
from fleet.addons.studies.verbs.study_options import given_values
from fleet.cli.declare import command
from fleet.errors import printable
from fleet.option import fields
from fleet.scenario.text.overrides import FAULT, NET, SET, Override
from fleet.scenario.text.yaml_reader import Source
from fleet.scenario.text.yaml_writer import yaml_text

TEXTS = st.text(max_size=30).filter(lambda text: printable(text) == text) | st.sampled_from(
    ["20", "1e-3", "true", "null", "~", "", "- a", "a: b", "#", "{a: 1}", "{a: {b: [1, x y]}}", "[1, 2]", "{name}"]
)
VALUES = st.sampled_from(
    ["nboc, bc", "0 %..90 %/10 %", "100 ms..2 s log 8", "7", "{a: 1}, {a: 2}", '"a, b", c', "0..1 latin 5", "1e-7, 2"]
)
KEYS = st.text(st.characters(exclude_categories=["C", "Z"], exclude_characters="="), min_size=1, max_size=20)
SPECS = st.builds(
    StudySpec,
    scenario=st.sampled_from(["paper", "nosuch", "/tmp/of my own.yaml"]),
    title=TEXTS,
    run_takes=st.sampled_from(["", "1.5 s"]),
    vary=st.dictionaries(KEYS, VALUES, max_size=3),
    zip=st.booleans(),
    seeds=st.sampled_from(["10", "3,7,9", "5..24", "7,7"]),
    draw=st.integers(0, 10**9),
    set=st.dictionaries(KEYS, TEXTS, max_size=3),
    net=st.lists(TEXTS, max_size=2),
    fault=st.lists(TEXTS, max_size=2),
    check=st.sampled_from(["", "max_age"]),
    measures=st.lists(st.sampled_from(["e_rms_m", "tumbles"]), max_size=2),
    until=st.sampled_from(["", "pass ±5 %"]),
    most_seeds=st.integers(1, 10**6),
    keep_logs=st.sampled_from(["none", "failed", "all"]),
    timeout=st.sampled_from(["", "5 min", "100 ms"]),
    budget=st.sampled_from(["", "5 min"]),
)


@given(SPECS)
def test_a_study_that_is_printed_is_read_as_the_same(spec: StudySpec) -> None:
    assert parse_study(Source("printed", study_yaml(spec))) == spec


def test_what_is_printed_reads_well() -> None:
    spec = StudySpec("paper", vary={"a": "1 s, 2 s"}, set=set_values(["log={every: 10 ticks}"]), net=["* loss {a}"])
    assert study_yaml(spec).splitlines() == [
        "study:",
        "  scenario: paper",
        "  vary:",
        '    a: "1 s, 2 s"',
        "  seeds: 10",
        "  set:",
        "    log:",
        "      every: 10 ticks",
        '  net: "* loss {a}"',
    ]


def test_the_file_of_a_scenario_is_printed_so_that_it_is_found_from_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert not is_file("paper")
    assert f'scenario: "{tmp_path}/my.yaml"' in study_yaml(StudySpec("my.yaml"))


def test_options_add_to_a_study_and_overrule_it() -> None:
    spec = StudySpec(
        "paper",
        vary={"loss": "0 %, 9 %", "profile": "paper, hardened"},
        set={"duration": "9 s", "controller": "bc"},
        net=["* loss {loss}"],
        seeds="20",
        measures=["tumbles"],
        timeout="1 s",
    )
    found = spec.with_options(
        vary={"loss": "1 %", "controller": "nboc, bc"},
        set={"profile": "hardened", "duration": "8 s"},
        net=["1->2 loss 5%"],
        fault=["at 1s off 1"],
        seeds="3",
    )
    assert found == StudySpec(
        "paper",
        vary={"loss": "1 %", "controller": "nboc, bc"},  # profile is set now
        set={"profile": "hardened", "duration": "8 s"},  # controller is varied now
        net=["* loss {loss}", "1->2 loss 5%"],
        fault=["at 1s off 1"],
        seeds="3",
        measures=["tumbles"],
        timeout="1 s",
    )
    assert spec.with_options(zip=True).zip
    assert spec.with_options(zip=True).with_options().zip


def test_a_plan_has_all_that_the_study_says() -> None:
    spec = StudySpec(
        "paper", vary={"x": "1, 2"}, set={"a": "{x}"}, net=["* loss 1%"], fault=["at 1s off 1"], seeds="4,2", draw=7
    )
    plan = plan_of(spec)
    assert plan.changes == (Override(SET, "a={x}"), Override(NET, "* loss 1%"), Override(FAULT, "at 1s off 1"))
    assert (plan.scenario, plan.axes, plan.seeds, plan.draw) == ("paper", (axis("x", "1, 2"),), (4, 2), 7)
    assert spec.timeout_s == inf
    assert spec.with_options(timeout="1.5 s").timeout_s == 1.5


def test_seeds_as_text() -> None:
    assert [seeds_text(20), seeds_text([7]), seeds_text([3, 9])] == ["20", "7,7", "3,9,3"]


def test_of_a_key_that_is_set_twice_the_last_counts() -> None:
    assert list(set_values(["a.b=1", "a={c: 1}", "a.b=2"]).items()) == [("a", "{c: 1}"), ("a.b", "2")]


# Of each option: the command line, the value in a file, the value in Python, and what the spec keeps.
SWEEP: dict[str, tuple[list[str], Any, Any, Any]] = {
    "vary": (["--vary", "a=1 s, 2 s"], {"a": ["1 s", "2 s"]}, {"a": ["1 s", "2 s"]}, {"a": "1 s, 2 s"}),
    "zip": (["--zip"], True, True, True),
    "seeds": (["--seeds", "3,7,3"], [3, 7], [3, 7], "3,7,3"),
    "draw": (["--draw", "5"], 5, 5, 5),
    "set": (["--set", "log={every: 2}"], {"log": {"every": 2}}, ["log={every: 2}"], {"log": "{every: 2}"}),
    "net": (["--net", "* loss 1%"], "* loss 1%", ["* loss 1%"], ["* loss 1%"]),
    "fault": (["--fault", "at 1s off 1"], ["at 1s off 1"], ["at 1s off 1"], ["at 1s off 1"]),
    "check": (["--check", "max_age"], "max_age", "max_age", "max_age"),
    "measures": (["--measure", "e_rms_m"], "e_rms_m", "e_rms_m", ["e_rms_m"]),
    "until": (["--until", "pass ±5 %"], "pass ±5 %", "pass ±5 %", "pass ±5 %"),
    "most_seeds": (["--most-seeds", "20"], 20, 20, 20),
    "keep_logs": (["--keep-logs", "all"], "all", "all", "all"),
    "timeout": (["--timeout", "90 s"], "90 s", 90.0, "90 s"),
    "budget": (["--budget", "90 s"], "90 s", 90, "90 s"),
}
BOUNDARY: dict[str, tuple[list[str], None, Any, Any]] = {
    "along": (["--along", "a=0..9"], None, "a=0..9", "a=0..9"),
    "per": (["--per", "b=1, 2"], None, {"b": [1, 2]}, {"b": "1, 2"}),
    "check": (["--check", "max_age"], None, "max_age", "max_age"),
    "level": (["--level", "0.9"], None, 0.9, 0.9),
    "width": (["--width", "0.2"], None, 0.2, 0.2),
    "seeds": (["--seeds", "5..9"], None, [5, 6], "5,6,5"),
}


def verb_of(spec: Spec, found: dict[str, Any]) -> click.Command:
    """A command that has the options of a spec, and writes down what was given."""

    def verb(scenario: str, *, asked: Any) -> None:
        found.update(given_values(asked))

    verb.__annotations__["asked"] = spec
    return command()(verb)


def typed(spec: Spec, args: list[str]) -> dict[str, Any]:
    """What a command gets that has the options of a spec."""
    found: dict[str, Any] = {}
    result = CliRunner().invoke(verb_of(spec, found), ["paper", *args], catch_exceptions=False)
    assert result.exit_code == 0, result.stderr
    return found


def test_each_option_is_the_same_on_the_command_line_in_a_file_in_python_and_in_the_record() -> None:
    assert list(SWEEP) == [name for name, field in fields(StudySpec).items() if field.flag is not None]
    keywords_of = {name: field.keyword for name, field in fields(StudySpec).items()}
    for name, (args, in_file, in_python, kept) in SWEEP.items():
        assert typed(StudySpec, args) == {name: kept}
        file = Source("a.yaml", yaml_text({"study": {"scenario": "paper", name: in_file}}))
        assert parse_study(file) == StudySpec("paper", **{name: kept})
        assert keywords(StudySpec, {keywords_of[name]: in_python}) == {name: kept}
        assert keywords_of[name] in signature(fleet.sweep).parameters
    whole = StudySpec("paper", **{name: kept for name, (*_, kept) in SWEEP.items()})
    assert msgspec.json.decode(msgspec.json.encode(whole), type=StudySpec) == whole
    assert [*BOUNDARY, "set", "net", "fault", "timeout"] == list(fields(BoundarySpec))
    for name, (args, _, in_python, kept) in BOUNDARY.items():
        assert name in signature(fleet.boundary).parameters
        assert keywords(BoundarySpec, {name: in_python}) == {name: kept}
        assert name == "seeds" or typed(BoundarySpec, args) == {name: kept}


@pytest.mark.parametrize("name", [name for name, (args, *_) in SWEEP.items() if name not in ("zip", "vary", "set")])
def test_a_text_that_a_terminal_would_obey_is_refused_on_the_command_line(name: str) -> None:
    """It would be shown on terminals. The texts of `set` and `vary` are read with their keys, when the study begins."""
    args, *_ = SWEEP[name]
    result = CliRunner().invoke(verb_of(StudySpec, {}), ["paper", args[0], f"{args[1]}\x1b[2J"])
    assert result.exit_code == 2


def test_a_keyword_that_says_nothing_changes_nothing_and_each_is_explained() -> None:
    assert keywords(StudySpec, {"timeout_s": inf, "until": None}) == {}
    assert "most_seeds: The most seeds of a point" in (fleet.sweep.__doc__ or "")


@pytest.mark.parametrize(("spec", "typed_as"), [(StudySpec, SweepKeywords), (BoundarySpec, BoundaryKeywords)])
def test_the_types_of_keywords_are_of_the_keywords_that_the_spec_declares(spec: Spec, typed_as: type) -> None:
    declared = {field.keyword for field in fields(spec).values() if field.flag is not None}
    assert set(typed_as.__annotations__) == declared - {"vary", "along", "per"}
