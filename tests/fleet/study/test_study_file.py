"""The file of a study: every mistake at its place, and no text that does harm."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.errors import ScenarioError
from fleet.scenario.text.yaml_reader import Source
from fleet.study.errors import StudyError
from fleet.study.plan import plan_of
from fleet.study.spec import StudySpec
from fleet.study.study_file import is_study, parse_study, study_named
from fleet.study.sweep import load_points
from world.plugins.trust import trusting


def parse(text: str, folder: Path | None = None) -> StudySpec:
    return parse_study(Source("my.yaml", text), folder)


def mistakes(text: str) -> list[tuple[int, int, str, str]]:
    """Line, column, message and hint of each."""
    with pytest.raises(ScenarioError) as caught:
        parse(text)
    return [(problem.line, problem.column, problem.message, problem.hint) for problem in caught.value.problems]


def test_every_key_is_read() -> None:
    found = parse("""\
study:
  title: Where does it break?
  scenario: rough-sea
  run_takes: 1.5 s
  vary:
    loss: 0 %..90 %/10 %
    delay: [0 s, 1 s]
    network.acoustic: [{modem: s2c, mac: aloha}, {modem: fsk-80, mac: tdma, slot: 3 s}]
  zip: true
  seeds: [3, 7]
  draw: 5
  set:
    duration: 20 s
    vehicles: 8
    log: {every: 10 ticks}
  net: "* loss {loss} delay {delay}"
  fault: at 1s off 1
  measures: [e_rms_m, tumbles]
  timeout: 5 min
""")
    assert found == StudySpec(
        scenario="rough-sea",
        title="Where does it break?",
        run_takes="1.5 s",
        vary={
            "loss": "0 %..90 %/10 %",
            "delay": "0 s, 1 s",
            "network.acoustic": "{modem: s2c, mac: aloha}, {modem: fsk-80, mac: tdma, slot: 3 s}",
        },
        zip=True,
        seeds="3,7,3",
        draw=5,
        set={"duration": "20 s", "vehicles": "8", "log": "{every: 10 ticks}"},
        net=["* loss {loss} delay {delay}"],
        fault=["at 1s off 1"],
        measures=["e_rms_m", "tumbles"],
        timeout="5 min",
    )


def test_all_mistakes_are_told_each_at_its_place() -> None:
    found = mistakes("""\
vehicles: 4
study:
  scenari: x
  vary:
    delay: 1 s..0 s/3
    loss: [1, 1]
    a b: 1, 2
  seeds: -3
  zip: 7
  draw: 1.5
  measures: [e_rms, 3]
  timeout: 5
  run_takes: -1 s
  set: 3
  net: [1]
""")
    assert found == [
        (
            1,
            1,
            'unknown key "vehicles": a study is the one key "study"',
            "keys of the scenario stand in set, below study",
        ),
        (3, 3, 'unknown key "scenari"', 'did you mean "scenario"?'),
        (3, 3, '"scenario" is missing in "study"', "a shipped name, or a file beside this one"),
        (5, 12, "vary: delay=1 s..0 s/3: the low end must be below the high end", ""),
        (6, 11, "vary: loss=1, 1: the value 1 is given twice", ""),
        (7, 10, "vary: expected a key such as network.links.*.loss, got 'a b'", ""),
        (8, 10, "seeds: expected a number of seeds such as 20, or seeds such as 5..24 or 3,7,9, got '-3'", ""),
        (9, 8, "zip: expected true or false, got 7", ""),
        (10, 9, "draw: expected a whole number from 0 on, got 1.5", ""),
        (11, 14, 'measures: there is no measure "e_rms"; did you mean "e_rms_m"?', ""),
        (11, 21, "measures: expected a text, got 3", ""),
        (12, 12, "timeout: expected a text, got 5", ""),
        (13, 14, 'run_takes: expected a time that is not negative, got "-1 s"', ""),
        (14, 8, "set: expected a mapping of keys of the scenario to values, got 3", ""),
        (15, 9, "net: expected a text, got 1", ""),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("study: 3", "study: expected a mapping with at least a scenario, got 3"),
        ("study:", "study: expected a mapping with at least a scenario, got nothing"),
        ("- study", 'study: expected a mapping with the key "study"'),
        ("study: {scenario: paper, scenario: ideal}", 'the key "scenario" is here twice'),
        ("study: {scenario: paper, seeds: 3, vary: {a: 1..9}}", "vary: a=1..9: how many values?"),
        ('study: {scenario: "a\\e[31mb"}', "scenario: a line break or a control character is in it"),
        ('study: {scenario: paper, set: {a: "\\e[31m"}}', "set: a line break or a control character is in it"),
        ('study: {scenario: paper, vary: {a: "1\\n2"}}', "vary: a line break or a control character is in it"),
        ("study: &a {scenario: paper, set: *a}", "stands for something that contains it"),
        ("study: {scenario: [", "not YAML"),
    ],
)
def test_what_is_no_study(text: str, message: str) -> None:
    assert message in mistakes(text)[0][2]


def test_no_message_has_a_control_character_of_the_file() -> None:
    with pytest.raises(ScenarioError) as caught:
        parse('{"\\e]0;x\\a": 1, study: {"\\e[2J": 1, scenario: paper, vary: {"\\e[31m": 1}, measures: ["\\e[1m"]}}')
    assert "\x1b" not in str(caught.value)


def test_a_scenario_beside_the_study_is_found_there(tmp_path: Path) -> None:
    (tmp_path / "beside").write_text("", "utf-8")
    assert parse("study: {scenario: my.yaml}", tmp_path).scenario == str(tmp_path / "my.yaml")
    assert parse("study: {scenario: beside}", tmp_path).scenario == str(tmp_path / "beside")
    assert parse("study: {scenario: paper}", tmp_path).scenario == "paper"
    assert parse("study: {scenario: paperr}", tmp_path).scenario == "paperr"  # whoever loads it says what is near


PIECES = st.sampled_from(
    ["study", "scenario", "vary", "set", "net", ": ", "\n", "\n  ", "\n    ", "- ", "{", "}", "[", "]", ",", "..", "/",
     "1", "9 %", "log 3", "paper", "&a", " *a", '"', "'", "\\e", "\t", "#", "seeds", "zip", "true", "measures", "\0"]
)  # fmt: skip


@given(st.lists(PIECES, max_size=40).map("".join))
def test_any_text_is_a_study_or_a_mistake(text: str) -> None:
    source = Source("any", f"study: {text}")
    if is_study(source):
        with suppress(ScenarioError):
            assert isinstance(parse_study(source), StudySpec)


def test_what_is_no_study_is_left_to_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scenario.yaml").write_text("vehicles: 3\n", "utf-8")
    Path("log.mcap").write_bytes(b"\x89MCAP0\r\n\xff\xfe")
    for name in ("paper", "nosuch", "nosuch.yaml", "scenario.yaml", "log.mcap", ".", "/dev/null", "a\0b", ""):
        assert study_named(name) is None, name
    with pytest.raises(StudyError, match='no study or scenario los-delay; did you mean "loss-delay"'):
        study_named("los-delay")


@pytest.mark.parametrize(
    ("file", "runs"), [("here.yaml", True), ("below/it.yaml", True), ("../stranger/it.yaml", False)]
)
def test_laws_of_a_study_obey_the_rules_of_scenarios(
    file: str, runs: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    for folder in (here, here / "below", tmp_path / "stranger"):
        folder.mkdir()
    monkeypatch.chdir(here)
    module = f"law_for_{Path(file).parent.name or 'here'}"
    Path(f"{module}.py").write_text("from pathlib import Path\nPath('it_ran').touch()\n", "utf-8")
    text = f"study: {{scenario: paper, set: {{controller: {{law: '{module}:Law'}}}}}}"
    Path(file).write_text(text, "utf-8")
    named = study_named(file)
    assert named is not None
    with pytest.raises(ScenarioError) as caught:
        load_points(plan_of(*named))
    assert Path("it_ran").exists() is runs
    assert ("has no 'Law'" if runs else f"would run {module}.py, which is not installed") in str(caught.value)
    if not runs:
        with pytest.raises(ScenarioError, match="has no 'Law'"), trusting(True):
            load_points(plan_of(*named))
        assert Path("it_ran").exists()
