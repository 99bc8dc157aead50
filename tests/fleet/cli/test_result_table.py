"""The result of a run on screens of several widths, against tests/expected/screen-result-*.txt."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from rich.console import Console as Terminal
from screens import assert_screen

from fleet.cli.result_table import show
from fleet.result.result import FaultEvent, Formation, LinkAge, Result, SignalValue, Status, VehicleResult, Wall
from fleet.result.verdict import Verdict
from netem.ledger import Account

CAUSES = {"loss": 23, "down": 40, "partition": 40, "deaf": 80, "dead receiver": 120}
VERDICTS = [
    Verdict("formation_error", True, "below 0.3 m after 95 s",
            "at most 0.004931 m (vehicle 1, 95 s), the median vehicle 0.004663 m"),
    Verdict("settle", False, "within 40 s", "vehicle 12 still 0.31 m off"),
]  # fmt: skip


def vehicle(i: int, **values: Any) -> VehicleResult:
    return VehicleResult(
        settle_10pct_s=73.2 + i, settle_5cm_s=None if i % 2 else 84.25, e_rms_m=0.007, e_final_m=0.001,
        formation_final_m=i / 1000, effort_Ns=81.9, u_cmd_max_mps=1.28, qp_failures=0, payloads_rejected=0, **values,
    )  # fmt: skip


def account(lost: dict[str, int]) -> Account:
    return Account(sent=1000, duplicated=4, delivered=1003 - sum(lost.values()), lost=lost, in_flight=1, corrupted=30)


def result(n: int = 4, lost: dict[str, int] | None = None, **values: Any) -> Result:
    links = [f"{i}->{j}" for i in range(1, n) for j in (i + 1,)] + [f"{i + 1}->{i}" for i in range(1, n)]
    ages = {name: LinkAge(0.3, 2.1, 4.1 + k / 100) for k, name in enumerate(["*", *links])}
    common = {
        "from_s": 0.0,
        "sim_s": 100.0,
        "vehicles": {str(i): vehicle(i) for i in range(1, n + 1)},
        "formation": Formation(n / 1000, n, 0.002, n),
        "ledger": {name: account(CAUSES if lost is None else lost) for name in links},
        "ages": ages,
        "events": [],
        "notes": [
            "agent 3: the law of controller my.module:Law reports nothing of its gains, so no picture shows them"
        ],
        "messages": 62161,
        "log_bytes": 4_600_000,
        "wall": Wall(in_process=False, startup_s=0.41, run_s=4.35, x_real_time=23.0),
        "status": Status.CHECK_FAILED,
        "directory": Path("runs/nemesis-1-20261122-062500"),
        "digest": "cdfdf2378a3e8d16ab",
        "checks": VERDICTS,
    }
    return Result(**common | values)


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
    assert [line.split()[0] for line in lines[rows + 1 : rows + 11]] == [str(i) for i in range(40, 30, -1)]
    assert lines[rows + 11] == "... and 30 more in result.json"
    assert [line.split()[0] for line in lines if "->" in line] == [f"{i}->{i - 1}" for i in range(40, 35, -1)]
    assert "... and 73 more links with 9.87 % lost in result.json" in lines


def test_a_continuation_counts_from_its_start() -> None:
    text = shown(result(from_s=20.0), 120, live=False)
    assert "\nvehicles; settling times count from the start at t = 20 s\n" in text
    assert "\npackets per directed link since t = 0, age of what was heard last\n" in text
    assert "80 s simulated, t = 20 to 100 s, in 4.35 s (23.0 x real time" in text


def test_a_title_is_not_folded_to_a_narrow_table() -> None:
    clean = {"1->2": replace(account({}), duplicated=0, in_flight=0, corrupted=0)}
    assert "\npackets per directed link, age of what was heard last\n" in shown(result(ledger=clean), 80)


def test_a_run_that_was_stopped_says_so_in_one_sentence() -> None:
    stopped = result()
    stopped.status, stopped.reason = Status.INTERRUPTED, "interrupted"
    assert shown(stopped, 80).startswith("stopped: interrupted\n")


def test_every_loss_is_counted_where_there_is_no_room_for_each_cause() -> None:
    text = shown(result(), 80)
    (total,) = (line.split() for line in text.splitlines() if line.startswith(" all "))
    sent, duplicated, delivered, lost, flying = map(int, total[1:6])
    assert sent + duplicated == delivered + lost + flying
    assert "lost: 720 dead receiver, 480 deaf, 240 down, 240 partition, 138 loss" in text


def test_verdicts_come_first_and_failed_ones_on_top() -> None:
    lines = shown(result(), 120).splitlines()
    assert [line.split(":")[0] for line in lines[:2]] == ["FAIL  settle", "pass  formation_error"]
    assert lines[-2:] == ["FAIL  1 of 2 checks: settle", "runs/nemesis-1-20261122-062500"]
    passed = result()
    passed.status, passed.checks = Status.PASS, VERDICTS[:1]
    assert "FAIL" not in shown(passed, 120)


def test_links_with_the_same_numbers_are_one_row() -> None:
    bad = account({"loss": 500})
    ledger = {f"{i}->{j}": account({}) for i in range(1, 7) for j in range(1, 7) if i != j} | {"3->4": bad}
    ages = {link: LinkAge(0.1, 0.2, 0.3) for link in ledger}
    ages |= {"*": ages["1->2"], "3->4": LinkAge(1.0, 2.0, 3.0)}
    lines = shown(result(6, ledger=ledger, ages=ages), 120).splitlines()
    begin = next(n for n, line in enumerate(lines) if line.lstrip().startswith("all "))
    assert [line.split("  ")[0].strip() or line.split()[0] for line in lines[begin + 1 : begin + 3]] == [
        "1->2 ... (29)",
        "3->4",
    ]
    assert "more" not in lines[begin + 3]


def test_events_of_vehicles_are_told_once_for_each() -> None:
    spells = [(2, 1.0), (3, 12.45), (3, 20.0)]
    events = [
        FaultEvent(at_s + late, f"tumbled-{i}", action, f"tumbled {i}")
        for i, at_s in spells
        for action, late in (("begins", 0.0), ("ends", 0.5))
    ]
    lines = shown(result(events=events), 80).splitlines()
    told = [line for line in lines if line.startswith("event")]
    assert told == ["event  tumbled 2: at 1 s", "event  tumbled 3: 2 times, first at 12.45 s"]
    many = [FaultEvent(1.0, "", "begins", f"tumbled {i}") for i in range(1, 21)]
    assert "event  ... and 10 more in result.json" in shown(result(events=many), 80)


def test_a_run_of_protocols_shows_what_they_reported() -> None:
    """And no times in which they settled: a protocol need not settle."""

    def reported(leader: float | None, battery: float) -> VehicleResult:
        signals = {"leader": SignalValue(leader, "1"), "battery": SignalValue(battery, "V")}
        return vehicle(1, agent="weakest:Weakest", signals=signals)

    dead = vehicle(3, agent="weakest:Weakest")
    text = shown(result(vehicles={"1": reported(3.0, 15.25), "2": reported(None, 15.5), "3": dead}), 80)
    lines = text.splitlines()
    assert "5 cm [s]" not in text and "settling" not in text
    begin = lines.index("vehicles; what weakest:Weakest reported at the end")
    assert [line.split() for line in lines[begin + 3 : begin + 6]] == [
        ["1", "3", "15.25", "0.0010"],
        ["2", "-", "15.5", "0.0010"],
        ["3", "-", "-", "0.0030"],
    ]
    assert_screen("result-protocol", text)


def test_moored_programs_without_signals_have_no_table_of_vehicles() -> None:
    """It had their numbers and no other column."""
    quiet = {str(i): replace(vehicle(i, agent="program:buddy.py"), formation_final_m=0.0) for i in (1, 2)}
    text = shown(result(2, vehicles=quiet, formation=Formation(0.0, 1, 0.0, 2)), 120)
    assert "UUV" not in text and "reported at the end" not in text


def test_moored_vehicles_have_no_errors_to_tell() -> None:
    """They are where they began. A protocol is told by what its agents report."""
    signals = {"there": SignalValue(4.0, "1")}
    rows = {str(i): replace(vehicle(i, agent="gossip:Gossip", signals=signals), formation_final_m=0.0) for i in (1, 2)}
    out = io.StringIO()
    show(result(vehicles=rows, formation=Formation(0.0, 1, 0.0, 2), checks=[]), Terminal(file=out, width=80))
    assert "there" in out.getvalue() and "formation" not in out.getvalue()


def test_a_run_that_did_not_begin_was_never_ready() -> None:
    """It was `ready in 0.00 s`."""
    broken = {"status": Status.BROKEN, "reason": "m1 was not ready within 20 s", "checks": [], "sim_s": 0.0}
    text = shown(result(**broken, wall=Wall(in_process=False, run_s=20.3)), 120)
    assert "distributed, never ready)" in text and "ready in" not in text
