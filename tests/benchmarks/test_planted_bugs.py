"""The planted defects: each is still where the product has its text, and the table says what was found."""

from __future__ import annotations

from pathlib import Path

import pytest
from marks import slow
from planted_bugs import BENCHES, BUGS, WITNESSES, Bug, plant, table, witnessed

from fleet.scenario.loading import load_scenario


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name)
def test_a_defect_can_be_planted(bug: Bug, tmp_path: Path) -> None:
    law = plant(bug, tmp_path)
    texts = {path.stem: path.read_text("utf-8") for path in tmp_path.iterdir()}
    assert law.partition(":")[0] in texts and len(texts) == len(bug.chain)
    for name, text in texts.items():
        compile(text, name, "exec")
    assert bug.new in texts[f"planted_{bug.name.replace('-', '_')}_{bug.chain[-1].rpartition('.')[2]}"]


@pytest.mark.parametrize("name", BENCHES)
def test_what_they_are_looked_for_with_is_a_scenario(name: str) -> None:
    bench = BENCHES[name]
    scenario = load_scenario(bench.scenario, bench.changes)
    assert scenario.undrawn.nemesis is not None and scenario.duration_ns == 60 * 10**9


@pytest.mark.parametrize("name", ["leads-too-long", *slow(*(name for name in WITNESSES if name != "leads-too-long"))])
def test_a_witness_fails_with_the_defect_alone(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (bug,) = (bug for bug in BUGS if bug.name == name)
    with_it, without = witnessed(bug)
    assert with_it and not without


def test_the_table_has_the_median_and_what_was_missed() -> None:
    line = {"bug": "a", "protocol": "p", "what": "w", "seed": 1, "most": 9, "found": True, "check": "C",
            "runs": 4, "without": 0, "reason": "", "least": ["fault"]}  # fmt: skip
    lines = list(table([line, line | {"seed": 2, "runs": 6}, line | {"bug": "b", "found": False}]))
    assert lines[2] == "| p | w | 5 | C | fault |" and lines[3] == "| p | w | not in 9 |  |  |"
    assert lines[-1] == "Found 1 of 2, median inf runs."
