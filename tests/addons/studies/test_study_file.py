"""The file of a study: what is read, and no text that does harm. Its mistakes stand in `messages-study.txt`."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.plan import plan_of
from fleet.addons.studies.spec import StudySpec
from fleet.addons.studies.study_file import is_study, parse_study, study_named
from fleet.addons.studies.sweep import load_points
from fleet.errors import ScenarioError
from fleet.scenario.text.yaml_reader import Source
from world.plugins.trust import trusting


def parse(text: str, folder: Path | None = None) -> StudySpec:
    return parse_study(Source("my.yaml", text), folder)


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
    with pytest.raises(ScenarioError) as caught:
        load_points(plan_of(*named))
    assert Path("it_ran").exists() is runs
    assert ("has no 'Law'" if runs else f"would run {module}.py, which is not installed") in str(caught.value)
    if not runs:
        with pytest.raises(ScenarioError, match="has no 'Law'"), trusting(True):
            load_points(plan_of(*named))
        assert Path("it_ran").exists()
