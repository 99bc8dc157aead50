"""What counts as slower, and files that are no figures: nothing is measured here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from benchmarks import fleets
from benchmarks.__main__ import main
from benchmarks.figures import FORMAT, Change, Figure, Measured, compare, read
from fleet.errors import FleetError

IDLE = {"processors": "2", "processor": "a processor", "Python": "3.11.7", "cores": "compiled"}


def rate(*ratios: float, of: float = 1000.0) -> Figure:
    """A figure of which more is better, with these ratios."""
    return Figure("N = 4: c distributed", "ticks/s", True, [of * ratio for ratio in ratios], "a", list(ratios))


def memory(*samples: float) -> Figure:
    return Figure("N = 4: PSS", "MB", False, list(samples))


def measured(*figures: Figure, **other: Any) -> Measured:
    values = {"machine": IDLE, "busy": 0.1, "versions": {"numpy": "2.1"}} | other
    return Measured(
        format=FORMAT, began="2026-11-22T10:00:00+00:00", command="python -m benchmarks", figures=[*figures], **values
    )


def change(old: Figure, new: Figure) -> Change:
    (found,) = compare(measured(old), measured(new), Path("old.json")).changes
    return found


STEADY = (0.20, 0.21, 0.20, 0.19, 0.20)


@pytest.mark.parametrize(
    ("old", "new", "verdict"),
    [
        (rate(*STEADY), rate(0.15, 0.16, 0.15, 0.14, 0.15), "slower"),
        (rate(*STEADY), rate(0.30, 0.31, 0.30, 0.29, 0.30), "faster"),
        (rate(*STEADY), rate(0.15, 0.16, 0.20, 0.14, 0.15), "same"),  # the ranges overlap
        (rate(0.200, 0.201, 0.202), rate(0.190, 0.191, 0.192), "same"),  # apart, but by less than the least change
        (rate(0.20, 0.30, 0.20), rate(0.18, 0.17, 0.16), "same"),  # apart, but by less than the repeats are
        (rate(0.20, 0.21), rate(0.10, 0.11), "same"),  # two repeats do not say how large the noise is
        (rate(*STEADY, of=1000.0), rate(*STEADY, of=500.0), "same"),  # the machine is half as fast, baseline and all
        (memory(10.0, 10.1, 10.2), memory(15.0, 15.1, 15.2), "slower"),
        (memory(10.0, 10.1, 10.2), memory(5.0, 5.1, 5.2), "faster"),
    ],
)
def test_a_change_is_more_than_the_noise_of_both(old: Figure, new: Figure, verdict: str) -> None:
    assert change(old, new).verdict == verdict


def test_a_change_says_by_how_much_and_how_large_the_noise_is() -> None:
    found = change(rate(*STEADY), rate(0.10, 0.11, 0.10, 0.09, 0.10))
    assert (found.compared, found.old, found.new, found.times_slower) == ("ratio", 0.20, 0.10, 2.0)
    assert found.noise == pytest.approx(0.2)  # 0.09 to 0.11, around 0.10
    found = change(memory(10.0, 10.0, 10.0), memory(20.0, 20.0, 20.0))
    assert (found.compared, found.times_slower, found.noise) == ("value", 2.0, 0.0)


def test_what_makes_two_measurements_less_comparable_is_said() -> None:
    other = {"processors": "4", "processor": "another", "Python": "3.12.0", "cores": "plain Python"}
    old, new = measured(memory(1.0, 1.0, 1.0)), measured(memory(1.0), machine=other, busy=1.5, versions={})
    assert compare(old, new, Path("old.json")).warnings == [
        "processors: 2 then, 4 now",
        "processor: a processor then, another now",
        "Python: 3.11.7 then, 3.12.0 now",
        "cores: compiled then, plain Python now",
        "numpy: 2.1 then, none now",
        "the machine was busy now: load 1.5 per processor",
        "figures with fewer than 3 repeats: their noise is not known, so they count as same",
    ]
    assert compare(old, old, Path("old.json")).warnings == []


def test_what_only_says_how_fast_the_machine_is_is_told_but_not_judged() -> None:
    then = Figure("start: python -c pass", "s of CPU time", False, [0.020, 0.021, 0.020], of_machine=True)
    now = Figure("start: python -c pass", "s of CPU time", False, [0.040, 0.041, 0.040], of_machine=True)
    found = compare(measured(then, memory(1.0, 1.0, 1.0)), measured(now, memory(1.0, 1.0, 1.0)), Path("old.json"))
    assert [change.name for change in found.changes] == ["N = 4: PSS"]
    assert found.warnings == ["the machine itself is slower now: start: python -c pass, 2.00 times the cost"]


def test_figures_that_only_one_has_are_named() -> None:
    found = compare(measured(rate(*STEADY)), measured(rate(*STEADY), memory(1.0)), Path("old.json"))
    assert [change.name for change in found.changes] == ["N = 4: c distributed"]
    assert found.missing == ["N = 4: PSS"]
    with pytest.raises(FleetError, match="it has no figure that was measured now"):
        compare(measured(memory(1.0)), measured(rate(*STEADY)), Path("old.json"))


def write(path: Path, document: Measured) -> Path:
    path.write_bytes(msgspec.json.encode(document))
    return path


def invoke(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [*map(str, arguments)])


def test_two_files_are_compared_without_measuring(tmp_path: Path) -> None:
    old = write(tmp_path / "old.json", measured(rate(*STEADY), memory(1.0, 1.0, 1.0)))
    slow = write(tmp_path / "slow.json", measured(rate(0.10, 0.11, 0.10), memory(1.0, 1.0, 1.0)))
    result = invoke("compare", old, slow)
    assert result.exit_code == 1
    assert "slower  N = 4: c distributed  2.00 x" in result.stdout
    assert result.stdout.splitlines()[-1] == "1 slower, 0 faster, 1 the same within the noise"
    assert invoke("compare", slow, old).exit_code == 0


def test_the_new_measurement_is_compared_and_both_are_one_document(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = write(tmp_path / "old.json", measured(memory(1.0, 1.0, 1.0)))
    monkeypatch.setattr(fleets, "measure_fleets", lambda *_, **__: measured(memory(2.0, 2.0, 2.0)))
    result = invoke("--compare", old, "--json", "-o", tmp_path / "new.json")
    assert result.exit_code == 1
    found = msgspec.json.decode(result.stdout, type=Measured)
    assert found.comparison is not None and [each.verdict for each in found.comparison.changes] == ["slower"]
    assert read(tmp_path / "new.json") == found
    assert json.loads(result.stdout)["comparison"]["with"] == str(old)


GOOD = json.loads(msgspec.json.encode(measured(rate(*STEADY))))


def figure(**other: Any) -> bytes:
    return json.dumps(GOOD | {"figures": [GOOD["figures"][0] | other]}).encode()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"\x89PNG\r\n\x00\xff", "expected the figures that -o wrote: "),
        (b'{"fleets": []}', "Object "),
        (json.dumps(GOOD | {"figures": []}).encode(), "it has no figure that was measured now"),
        (figure(samples=[]), "expected positive samples, "),
        (figure(ratios=[1.0]), "with a ratio each or none, of 'N = 4:"),
        (figure(ratios=[0.0] * 5), "expected positive samples"),
    ],
)  # fmt: skip
def test_a_file_that_is_something_else_is_refused_in_a_line(content: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "old.json"
    path.write_bytes(content)
    result = invoke("compare", path, path)
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"benchmarks: {path}: ") and reason in line
