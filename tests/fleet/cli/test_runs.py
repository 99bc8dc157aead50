"""The commands for the runs below a directory."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import pytest
from live_directory import live_directory
from tool import invoke

from fleet.cli.documents.logs import Runs
from netem.errors import BusError

HOURS = {"pass": 1, "check_failed": 50, "broken": 100, "interrupted": 300}


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run of each kind below `runs`, which began so many hours ago, and a live one."""
    monkeypatch.chdir(tmp_path)
    runs, now = tmp_path / "runs", datetime.now(UTC)  # noqa: TID251 (a name)
    for status, hours in HOURS.items():
        path = runs / f"{status}-1-{now - timedelta(hours=hours):%Y%m%d-%H%M%S}"
        (path / "log").mkdir(parents=True)
        (path / "scenario.yaml").write_text("")
        (path / "run.mcap").write_bytes(bytes(2_000_000))
        (path / "result.json").write_text(f'{{"status": "{status}", "sim_s": 60.0}}')
    return runs


def names(out: Path) -> set[str]:
    return {path.name.partition("-")[0] for path in out.iterdir() if not path.is_symlink()}


def test_ls(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def connect(*_: object, **__: object) -> None:
        raise BusError("nobody is there")  # where the directory's console is not, at once

    monkeypatch.setattr("netem.wire.bus.Bus.connect", connect)
    with live_directory(out, "rough-sea"):
        live, place, *lines = invoke("ls").stdout.splitlines()
        assert live.startswith("rough-sea-") and " pid " in place
        assert [line.split()[1:3] for line in lines[1:-1]] == [
            ["rough-sea", "live"],
            ["pass", "pass"],
            ["check_failed", "FAIL"],
            ["broken", "broke"],
            ["interrupted", "stopped"],
        ]
        assert [line.split()[-2:] for line in lines[2:-1]] == [["1", "h"], ["2", "days"], ["4", "days"], ["12", "days"]]
        assert lines[2].split()[3:7] == ["60", "s", "2.0", "MB"]
        assert lines[-1] == "5 runs, 8.0 MB, 1 live"
        document = msgspec.json.decode(invoke("ls", "--json").stdout, type=Runs, dec_hook=lambda kind, text: kind(text))
        assert [row.verdict for row in document.runs] == ["live", "pass", "FAIL", "broke", "stopped"]
        assert document.size_bytes == sum(row.size for row in document.runs)
        assert document.runs[1].age_s == pytest.approx(3600.0, abs=60.0)


def test_ls_of_nothing(tmp_path: Path) -> None:
    result = invoke("ls", "--out", tmp_path)
    assert (result.exit_code, result.stdout, result.stderr) == (0, "", f"no run below {tmp_path}\n")
    assert msgspec.json.decode(invoke("ls", "--json", "--out", tmp_path).stdout, type=Runs).live == []


@pytest.mark.parametrize(
    ("options", "stay"),
    [
        (["--keep", "0"], set()),
        (["--keep", "3"], {"pass", "check_failed", "broken"}),
        (["--older-than", "3 days"], {"pass", "check_failed"}),
        (["--older-than", "1 week", "--keep", "1"], {"pass", "check_failed", "broken"}),
        (["--verdict", "fail,broke"], {"pass", "interrupted"}),
        (["--verdict", "stopped", "--older-than", "500 h"], {"pass", "check_failed", "broken", "interrupted"}),
    ],
)
def test_prune(options: list[str], stay: set[str], out: Path) -> None:
    """First it only says what it would do; a live run stays whatever is asked for."""
    with live_directory(out, "live"):
        before = names(out)
        result = invoke("ls", "--prune", *options)
        assert result.exit_code == 0 and names(out) == before
        gone = len(HOURS) - len(stay)
        size = f"{gone} run{'' if gone == 1 else 's'}, {gone * 2}.0 MB"
        if not gone:
            assert result.stderr == "no run below runs is to go\n"
        else:
            assert result.stdout.splitlines()[-1] == f"would remove {size}; --yes does it"
        result = invoke("ls", "--prune", *options, "--yes")
        assert result.exit_code == 0 and names(out) == stay | {"live"}
        assert result.stdout == (f"removed {size}\n" if gone else "")
