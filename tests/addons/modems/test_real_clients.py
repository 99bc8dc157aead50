"""Clients of others, unchanged, on modems of a run."""

from __future__ import annotations

import json
import subprocess
import sys
from math import exp
from pathlib import Path
from typing import Any

import pytest
from free_ports import free_port
from stacks import Stack

PROGRAMS = Path(__file__).parent / "programs"
LIMIT_S = 200.0
AIRTIME_S = 0.02
QUICK = """
name = "quick"
title = "A modem of a test: 20 ms on the air, and no noise"
[modem]
carrier = { value = 26, unit = "kHz", source = "assumption" }
bandwidth = { value = 16, unit = "kHz", source = "assumption" }
source_level = { value = 184, unit = "dB", source = "assumption" }
directivity = { value = 0, unit = "dB", source = "assumption" }
max_range = { value = 1, unit = "km", source = "assumption" }
interference_range = { value = 2, unit = "km", source = "assumption" }
mtu = { value = 64, unit = "bytes", source = "assumption" }
lost_below = { value = 8, unit = "dB", source = "assumption" }
clear_above = { value = 8, unit = "dB", source = "assumption" }
capture = { value = 100, unit = "dB", source = "assumption: whatever overlaps is lost" }
preamble = { value = 20, unit = "ms", source = "assumption" }
bit_rate = { value = 1e8, unit = "bit/s", source = "assumption" }
"""
WATER = {"acoustic": {"modem": "s2c", "backoff": "300 ms", "queue": 10}}


def says(program: str, *arguments: object) -> dict[str, Any]:
    """What a program prints, as JSON."""
    done = subprocess.run(
        [sys.executable, PROGRAMS / program, *map(str, arguments)],
        capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


@pytest.mark.slow
def test_a_program_for_unetstack_runs_as_it_is(tmp_path: Path) -> None:
    pytest.importorskip("unetpy")
    ports = [free_port(), free_port()]
    nodes = {f"auv{n}": {"modem": {"unet": port}, "place": f"{500 * n} 0 10 m"} for n, port in enumerate(ports, 1)}
    with Stack(tmp_path, nodes=nodes, network=WATER).begun() as stack:
        found = says("unet_program.py", *ports)
        result = stack.end()
    assert (found["addresses"], found["host"], found["mtu"]) == ([1, 2], 2, 64)
    assert found["heard"] == [[number, 2, 3] for number in range(5)] and all(found["sent"])
    assert all(abs(us - 333_333) <= 1 for us in found["travel_us"])  # 500 m at 1500 m/s
    assert found["too_long"] is False and found["range_m"] == pytest.approx(500.0, abs=0.01)
    assert (found["delivered"], found["by_link"], found["nobody"]) == (2, [9, 9], None)
    assert 0 <= found["began_us"] - found["asked_us"] < 10_000 + 1  # a tick of the run
    assert found["past"].startswith("the time is past")
    assert result.ledger["auv1->auv2"].delivered >= 7


@pytest.mark.slow
def test_a_script_of_acomms_runs_as_it_is(tmp_path: Path) -> None:
    pytest.importorskip("acomms")
    terminals = [tmp_path / "tty1", tmp_path / "tty2"]
    places = zip(terminals, (0, 1500), strict=True)
    nodes = {
        f"n{n}": {"modem": {"micromodem": str(path)}, "place": f"{x} 0 10 m"} for n, (path, x) in enumerate(places)
    }
    with Stack(tmp_path, nodes=nodes, network=WATER).begun() as stack:
        found = says("acomms_program.py", *terminals, tmp_path)
        stack.end()
    assert found["ids"] == [1, 2] and found["travel_s"] == 1.0
    assert found["acknowledged"] == ["2", "1", "1", "1"] and found["mini"] == ["1", "2", "1ABC"]
    assert 0.0 <= found["behind_s"] < 5.0
    assert not any(path.is_symlink() for path in terminals)


@pytest.mark.slow
@pytest.mark.parametrize("slot_s", [0.0, 0.03])
def test_ten_modems_that_talk_at_random_are_an_aloha(tmp_path: Path, slot_s: float) -> None:
    """The curves S = G exp(-2 G) and, in slots, S = G exp(-G), for ten modems: a receiver that talks hears nothing, and
    eight others may disturb.
    """
    pytest.importorskip("unetpy")
    (tmp_path / "quick.toml").write_text(QUICK, "utf-8")
    ports = [free_port() for _ in range(10)]
    nodes = {f"n{k}": {"modem": {"unet": port}, "place": f"{k} 0 10 m"} for k, port in enumerate(ports)}
    water = {"acoustic": {"modem": str(tmp_path / "quick.toml"), "backoff": "0 ms", "queue": 10}}
    rate, during_s = 2.5, 40.0  # transmissions per second of each, so that the load G is 0.5, or 0.75 in slots
    with Stack(tmp_path, nodes=nodes, network=water, tick="1 ms").begun() as stack:
        sent = says("aloha_program.py", rate, during_s, slot_s, *ports)
        result = stack.end()
    links = result.ledger.values()
    assert sum(link.sent for link in links) == 9 * sent and sent > 900
    share = sum(link.delivered for link in links) / sum(link.sent for link in links)
    each = sent / during_s / len(ports)
    expected = (1.0 - each * slot_s) ** 9 if slot_s else exp(-2.0 * 9 * each * AIRTIME_S)
    print(f"of {sent} frames {share:.4f} were heard, expected {expected:.4f}")
    assert share == pytest.approx(expected, rel=0.12)


@pytest.mark.slow
def test_programs_with_slots_of_their_own_never_collide(tmp_path: Path) -> None:
    """Each frame begins at its time, whatever the back-off of the channel is."""
    pytest.importorskip("unetpy")
    (tmp_path / "quick.toml").write_text(QUICK, "utf-8")
    ports = [free_port() for _ in range(4)]
    nodes = {f"n{k}": {"modem": {"unet": port}, "place": f"{k} 0 10 m"} for k, port in enumerate(ports)}
    water = {"acoustic": {"modem": str(tmp_path / "quick.toml"), "backoff": "300 ms", "queue": 10}}
    with Stack(tmp_path, nodes=nodes, network=water, tick="1 ms").begun() as stack:
        found = says("tdma_program.py", *ports)
        result = stack.end()
    assert len(found["late_us"]) == 40 and all(0 <= us <= 1_000 for us in found["late_us"])
    links = result.ledger.values()
    assert sum(link.delivered for link in links) == sum(link.sent for link in links) == 3 * 40


@pytest.mark.slow
def test_ranges_of_a_vehicle_that_moves_are_those_of_the_way(tmp_path: Path) -> None:
    """At 2 m/s. The other modem is at the origin, so a range is the place at some time between request and answer."""
    pytest.importorskip("unetpy")
    ports = [free_port(), free_port()]
    nodes = {f"auv{n}": {"modem": {"unet": port}, "place": f"{x} 0 10 m"} for n, (port, x) in
             enumerate(zip(ports, (300, 0), strict=True), 1)}  # fmt: skip
    with Stack(tmp_path, nodes=nodes, network=WATER).begun() as stack:
        found = says("moving_program.py", ports[0])
        stack.end()
    for before, measured, after in found:
        assert before - 0.5 < measured < after + 0.5, found
    assert found[-1][1] - found[0][1] > 5.0
