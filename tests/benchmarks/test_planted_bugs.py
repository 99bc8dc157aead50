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


def test_the_table_has_the_medians_and_what_was_missed() -> None:
    line = {"bug": "leads-too-long", "protocol": "p", "what": "w", "seed": 1, "found": True, "check": "C",
            "runs": 4, "cpu_s": 2.0, "without": 0, "reason": "", "least": ["fault"]}  # fmt: skip
    missed = line | {"bug": "b", "found": False, "least": []}
    lines = list(table([line, line | {"runs": 6}, line | {"runs": 8, "cpu_s": 3.0}, missed]))
    assert lines[2] == "| p | w | 2 | 3 of 3 | 6 (6 to 6) | 2 (2 to 2) | C | fault |"
    assert lines[3] == "| p | w |  | 0 of 1 | more | more |  |  |"
    assert lines[-2:] == ["Found by the median search: 1 of 2 defects.", "Of 1 with a witness: 1."]
