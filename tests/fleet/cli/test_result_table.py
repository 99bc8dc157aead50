"""The result of a run on screens of several widths, against tests/expected/screen-result-*.txt."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console as Terminal
from screens import assert_screen

from fleet.checks.verdict import Verdict
from fleet.cli.result_table import show
from fleet.execution.outcome import Result, Status

CAUSES = {"loss": 23, "down": 40, "partition": 40, "deaf": 80, "dead receiver": 120}
VERDICTS = [
    Verdict("formation_error", True, "below 0.3 m after 95 s",
            "at most 0.004931 m (vehicle 1, 95 s), the median vehicle 0.004663 m"),
    Verdict("settle", False, "within 40 s", "vehicle 12 still 0.31 m off"),
]  # fmt: skip


def vehicle(i: int, **values: Any) -> dict[str, Any]:
    return {
        "settle_10pct_s": 73.2 + i, "settle_5cm_s": None if i % 2 else 84.25, "e_rms_m": 0.007, "e_final_m": 0.001,
        "formation_final_m": i / 1000, "effort_Ns": 81.9, "u_cmd_max_mps": 1.28, "qp_failures": 0,
        "payloads_rejected": 0,
    } | values  # fmt: skip


def account(lost: dict[str, int]) -> dict[str, Any]:
    return {
        "sent": 1000,
        "duplicated": 4,
        "delivered": 1003 - sum(lost.values()),
        "lost": lost,
        "in_flight": 1,
        "corrupted": 30,
    }


def result(n: int = 4, lost: dict[str, int] | None = None, **values: Any) -> Result:
    links = [f"{i}->{j}" for i in range(1, n) for j in (i + 1,)] + [f"{i + 1}->{i}" for i in range(1, n)]
    ages = {name: {"mean_s": 0.3, "p95_s": 2.1, "max_s": 4.1 + k / 100} for k, name in enumerate(["*", *links])}
    common = {
        "from_s": 0.0,
        "sim_s": 100.0,
        "vehicles": {str(i): vehicle(i) for i in range(1, n + 1)},
        "formation": {"worst_m": n / 1000, "vehicle": n, "median_m": 0.002, "vehicles": n},
        "ledger": {name: account(CAUSES if lost is None else lost) for name in links},
        "ages": ages,
        "notes": [
            "agent 3: the law of controller my.module:Law reports nothing of its gains, so no picture shows them"
        ],
        "messages": 62161,
        "log_bytes": 4_600_000,
        "wall": {"in_process": False, "startup_s": 0.41, "run_s": 4.35, "x_real_time": 23.0},
    }
    directory = Path("runs/nemesis-1-20261122-062500")
    return Result(Status.CHECK_FAILED, directory, "cdfdf2378a3e8d16ab", verdicts=VERDICTS, values=common | values)


def shown(what: Result, width: int, *, live: bool = True) -> str:
    out = io.StringIO()
    show(what, Terminal(file=out, width=width, force_terminal=live, color_system=None))
    return "".join(f"{line.rstrip()}\n" for line in out.getvalue().splitlines())


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_heading_is_cut(width: int) -> None:
    text = shown(result(), width)
    assert max(map(len, text.splitlines())) <= width
    assert "\u2026" not in text
    assert_screen(f"result-{width}", text)


def test_elsewhere_lines_stay_whole() -> None:
    text = shown(result(), 120, live=False)
    assert_screen("result-no-terminal", text)
    assert any(
        line.startswith("note  agent 3: the law of ") and line.endswith("shows them") for line in text.split("\n")
    )


def test_many_vehicles_and_links_show_the_worst() -> None:
    text = shown(result(40, {"loss": 99}), 80)
    assert_screen("result-many", text)
    lines = text.splitlines()
    rows = lines.index("UUV  10 % [s]     5 cm [s]     10 s [m]  error [m]  effort [N s]      [m/s]")
    assert [line.split()[0] for line in lines[rows + 1 : rows + 21]] == [str(i) for i in range(40, 20, -1)]


def test_a_continuation_counts_from_its_start() -> None:
    text = shown(result(from_s=20.0), 120, live=False)
    assert text.startswith("vehicles; settling times count from the start at t = 20 s\n")
    assert "\npackets per directed link since t = 0, age of what was heard last\n" in text
    assert "80 s simulated, t = 20 to 100 s, in 4.35 s (23.0 x real time" in text


def test_a_title_is_not_folded_to_a_narrow_table() -> None:
    clean = {"1->2": account({}) | {"duplicated": 0, "in_flight": 0, "corrupted": 0}}
    assert "\npackets per directed link, age of what was heard last\n" in shown(result(ledger=clean), 80)


def test_a_run_that_was_stopped_says_so_in_one_sentence() -> None:
    stopped = result()
    stopped.status, stopped.reason = Status.INTERRUPTED, "interrupted"
    assert "\nstopped: interrupted\n" in shown(stopped, 80)


def test_every_loss_is_counted_where_there_is_no_room_for_each_cause() -> None:
    text = shown(result(), 80)
    (total,) = (line.split() for line in text.splitlines() if line.startswith(" all "))
    sent, duplicated, delivered, lost, flying = map(int, total[1:6])
    assert sent + duplicated == delivered + lost + flying
    assert "lost: 720 dead receiver, 480 deaf, 240 down, 240 partition, 138 loss" in text
