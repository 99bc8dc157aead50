"""One real computer among simulated vehicles: what its programs send, what they are given, and that it repeats."""

from __future__ import annotations

import shutil
import socket
import sys
from pathlib import Path
from textwrap import dedent
from time import monotonic_ns
from types import SimpleNamespace
from typing import Any

import psutil
import pytest
from free_ports import free_port
from live import Command, LiveRun
from pydantic import ValidationError
from tool import invoke
from waiting import wait_for

import fleet
from agents.api import UdpPort
from agents.plugged_agent import MAX_PAYLOAD_BYTES
from fleet.addons.hosts.gateway import MOST_WAITING, Gateway, UdpRule, modem_section
from fleet.errors import FleetError
from fleet.execution.gateways import agent_options
from fleet.scenario.schema.gateway import GatewaySection
from netem.clock import Clock
from netem.wire.messages import Delivery

LIMIT_S = 60.0
CONFIG: Any = SimpleNamespace(id=2, neighbours=(), tick_ns=20_000_000, round_ticks=1)
OTHER: Any = SimpleNamespace(id=1)
NAV: Any = SimpleNamespace(tick=0)
SIMULATED = """
import socket, sys
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
s.bind(("", int(sys.argv[1])))
s.settimeout(0.2)
while True:
    s.sendto(b"ping", ("10.0.0.2", int(sys.argv[1])))
    try:
        print("real", s.recvfrom(99)[0].decode(), flush=True)
    except TimeoutError:
        pass
"""


def join_file(run: LiveRun) -> Path:
    """The file with which agent 2 joins a run, when it is there."""
    file = run.out / "latest" / "join-2.json"
    wait_for(lambda: run.over or file.exists(), LIMIT_S, "the join file")
    assert not run.over, run.printed
    return file


def assert_repeats(run: LiveRun) -> None:
    checked = invoke("verify", run.directory, "--trust")
    assert checked.exit_code == 0 and "vehicle 2 is external" in checked.output, checked.output


def test_rules_are_read_or_refused_in_words() -> None:
    assert UdpRule.of("9000=auv.local:9100") == (9000, "auv.local", 9100)
    for wrong in ("9000", "9000=9100", "x=h:1", "0=h:1", "9000=h:70000", "=h:1", "9000=:1"):
        with pytest.raises(FleetError, match=r"expected PORT=HOST:PORT such as 9000=192\.168\.0\.7:9100"):
            UdpRule.of(wrong)


def test_datagrams_go_both_ways_and_what_has_no_room_waits_or_is_lost() -> None:
    ours, theirs = free_port(), free_port()
    said: list[str] = []
    real = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    real.bind(("127.0.0.1", theirs))
    real.settimeout(LIMIT_S)
    gateway = Gateway([UdpRule(ours, "127.0.0.1", theirs)], "", (), said.append).begin(CONFIG, Clock.LOCKSTEP)
    try:
        assert f"127.0.0.1:{ours}" in said[0]
        payloads = UdpPort(OTHER, ours).send(b"hello" * 1000, to=2)
        came = [Delivery(due_tick=0, sent_tick=0, src=1, seq=n, copy=0, payload=p) for n, p in enumerate(payloads)]
        assert gateway.decide(NAV, came).tau == (0.0, 0.0, 0.0)
        gateway.decide(SimpleNamespace(tick=10_000), [])  # type: ignore[arg-type]
        assert gateway.pace > 2.0  # 200 s in a moment: no real program follows
        assert real.recv(1 << 16) == b"hello" * 1000
        for number in range(60):  # one by one, or the system drops some
            real.sendto(bytes((number,)) * 30_000, ("127.0.0.1", ours))
            wait_for(lambda n=number: gateway._sent.qsize() > n, LIMIT_S, "the datagram")  # type: ignore[misc]
        first = gateway.transmit(NAV)
        assert 0 < sum(map(len, first)) <= MAX_PAYLOAD_BYTES
        heard = UdpPort(OTHER, ours)
        rounds = [first]
        while payloads_now := gateway.transmit(NAV):
            rounds.append(payloads_now)
        got = [
            one.data[0]
            for payloads_now in rounds
            for one in heard.receive(
                [Delivery(due_tick=0, sent_tick=0, src=2, seq=0, copy=0, payload=p) for p in payloads_now]
            )
        ]
        out, into, lost, _ = gateway.counts
        assert (len(got), into) == (out, 1) and got == sorted(got)
        assert out == MOST_WAITING // 30_588 and lost == 60 - out  # 21 packets of IP have 588 bytes of headers
    finally:
        gateway.close()
        real.close()


def test_messages_that_wait_longer_than_a_round_are_counted_and_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Since the run is behind: its rounds come later than the wall clock has them."""
    ours = free_port()
    gateway = Gateway([UdpRule(ours, "127.0.0.1", 9)], "", (), lambda _: None).begin(CONFIG, Clock.LOCKSTEP)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as real:
            for number in range(3):
                real.sendto(b"hello", ("127.0.0.1", ours))
                wait_for(lambda n=number: gateway._sent.qsize() > n, LIMIT_S, "the datagram")  # type: ignore[misc]
        now_ns = monotonic_ns()
        monkeypatch.setattr("fleet.addons.hosts.gateway.monotonic_ns", lambda: now_ns + 3_000_000_000)
        assert len(gateway.transmit(NAV)) == 3 and gateway.counts.late == 3
        ((tick, told),) = gateway.take_notes()
        assert tick == 0 and "a message of its real program waited 30" in told
        assert gateway.take_notes() == []
    finally:
        gateway.close()


@pytest.mark.parametrize("text", ["unet", "unet=", "sonar=1", "unet=99999", "unet=tty"])
def test_a_modem_that_is_none_is_told(text: str) -> None:
    with pytest.raises(FleetError, match="--modem"):
        modem_section(text)


def test_a_port_that_is_taken_is_told() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        gateway = Gateway([UdpRule(port, "127.0.0.1", 9)], "", (), lambda _: None)
        with pytest.raises(FleetError, match=f"--udp {port}=127.0.0.1:9: Address already in use"):
            gateway.begin(CONFIG, Clock.LOCKSTEP)


@pytest.mark.once  # runs a program, as those of the add-on for programs
@pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")
def test_a_real_program_takes_part_in_a_run_that_repeats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A simulated program calls the real one over links with delay; verify takes its answers from the log."""
    monkeypatch.chdir(tmp_path)
    port, theirs = free_port(), free_port()
    (tmp_path / "calls.py").write_text(SIMULATED)
    (tmp_path / "mix.yaml").write_text(
        dedent(f"""
            title: A simulated program and a real one
            vehicles: 2
            moored: true
            tick: 20 ms
            duration: 1500 ms
            graph: {{shape: complete}}
            network: {{period: 20 ms, links: {{"*": delay 40ms}}}}
            agent: {{program: calls.py, arguments: ["{port}"]}}
            per_vehicle: {{2: {{external: true}}}}
        """)
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as real:
        real.bind(("127.0.0.1", theirs))
        real.settimeout(LIMIT_S)
        run = LiveRun(tmp_path / "runs", str(tmp_path / "mix.yaml"), "--speed", "1", "--trust")
        with run:
            file = run.out / "latest" / "join-2.json"
            wait_for(lambda: run.over or file.exists(), LIMIT_S, "the join file")
            assert not run.over, run.printed
            with Command("agent", "--join", file, "--udp", f"{port}=127.0.0.1:{theirs}") as agent:
                for _ in range(3):
                    data, sender = real.recvfrom(99)
                    assert data == b"ping"
                    real.sendto(b"pong", sender)
                assert run.status(LIMIT_S) == 0, run.printed
                wait_for(lambda: "the run is over" in agent.printed, LIMIT_S, "its last words")
                assert "of the real programs 3 messages went into the network" in agent.printed
        lines = (run.directory / "log" / "agent-1.log").read_text()
        assert lines.count("real pong") >= 2
    assert_repeats(run)


BUOY = """
    import os, sys
    port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
    text = b""
    while b"$CAMPA" not in text:
        text += os.read(port, 4096)
    print("heard a range request", flush=True)
"""


@pytest.mark.once
@pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")
def test_a_real_driver_has_the_modem_of_a_vehicle_in_the_one_water(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It measures the range to a simulated one: 300 m are 0.2 s. `verify` repeats the run."""
    monkeypatch.chdir(tmp_path)
    port = free_port()
    (tmp_path / "buoy.py").write_text(dedent(BUOY))
    (tmp_path / "water.yaml").write_text(
        dedent("""
            title: A simulated modem and a real driver
            vehicles: 2
            moored: true
            tick: 20 ms
            duration: 4 s
            formation: {offsets: [0 0 0 m, 300 0 0 m]}
            initial: [{position: 0 0 10 m}, {position: 300 0 10 m}]
            graph: {shape: complete}
            network: {period: 20 ms, acoustic: {modem: s2c, backoff: 100 ms}}
            agent: {program: buoy.py, arguments: [tty], modem: {micromodem: tty}}
            per_vehicle: {2: {external: true}}
        """)
    )
    run = LiveRun(tmp_path / "runs", str(tmp_path / "water.yaml"), "--speed", "1", "--trust")
    with run:
        file = join_file(run)
        with Command("agent", "--join", file, "--modem", f"micromodem={port}") as agent:
            wait_for(lambda: "real programs open the modem (micromodem) at" in agent.printed, LIMIT_S, "the port")
            with socket.create_connection(("127.0.0.1", port), timeout=LIMIT_S) as driver:
                driver.sendall(b"$CCCFG,SRC,2\r\n$CCMPC,2,1\r\n")
                text = b""
                while b"$CAMPR" not in text:
                    data = driver.recv(4096)
                    assert data, text
                    text += data
            assert run.status(LIMIT_S) == 0, run.printed
    assert b"$CAMPR,1,2,0.2000*" in text
    assert "heard a range request" in (run.directory / "log" / "agent-1.log").read_text()
    assert_repeats(run)


ANSWERS = """
import socket, sys
ours = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
ours.bind(("127.0.0.1", int(sys.argv[1])))
print("the real one begins", flush=True)
while True:
    data, sender = ours.recvfrom(99)
    ours.sendto(b"pong", sender)
"""
GATEWAY = """
title: A simulated program and a real one
vehicles: 2
moored: true
tick: 20 ms
duration: 1500 ms
graph: {{shape: complete}}
network: {{period: 20 ms, links: {{"*": delay 40ms}}}}
agent: {{program: calls.py, arguments: ["{port}"], signals: {{answers: {{line: "real pong", count: true}}}}}}
per_vehicle:
  2: {{gateway: {{udp: {{"{port}": "127.0.0.1:{theirs}"}}, run: [{python}, {program}, "{theirs}"]}}}}
checks: {{signal: {{topic: control.answers, vehicles: 1, above: 1, eventually_within: 1400 ms}}}}
"""


@pytest.mark.once
@pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")
def test_a_run_starts_what_stands_for_a_real_computer_and_so_does_a_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("calls.py").write_text(SIMULATED)
    Path("answers.py").write_text(ANSWERS)
    fields = {"port": free_port(), "theirs": free_port(), "python": sys.executable, "program": "answers.py"}
    Path("mix.yaml").write_text(GATEWAY.format(**fields))
    done = invoke("run", "mix.yaml", "--trust")
    assert done.exit_code == 0, done.output
    run = Path(done.stdout.strip().splitlines()[-1])
    said = (run / "log" / "gateway-2.log").read_text()
    assert "the real one begins" in said and "the run is over" in said and done.output.count("is a real computer") == 1
    assert invoke("verify", run, "--trust").exit_code == 0
    study = invoke("sweep", "mix.yaml", "--vary", "network.links.*.loss=0 %,100 %", "--seeds", 1, "--trust", "--quiet")
    assert study.exit_code == 0, study.output
    points = fleet.open_study(study.stdout.strip().splitlines()[-1]).summary()
    passed = [point.passed.value for point in points]
    assert passed == [1, 0]
    Path("mix.yaml").write_text(GATEWAY.format(**fields | {"python": "nowhere"}))
    broken = invoke("run", "mix.yaml", "--trust")
    assert broken.exit_code == 3, broken.output
    assert "the gateway of vehicle 2 ended with status" in broken.output
    assert "--run nowhere: No such file or directory" in broken.output
    assert not [p for p in psutil.process_iter(["cmdline"]) if str(fields["theirs"]) in (p.info["cmdline"] or [])]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "expected zenoh, udp or modem"),
        ({"carry": ["a"], "udp": {"9000": "h:1"}}, "carry has no effect without zenoh"),
        ({"udp": {"9000": "h"}}, "expected a port and where its program is"),
    ],
)
def test_a_gateway_that_is_none_is_told(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        GatewaySection.model_validate(given)


def test_a_gateway_is_what_fleet_agent_is_told() -> None:
    given = {"zenoh": "tcp/0.0.0.0:7501", "carry": ["a/**"], "udp": {"9000": "h:1"}, "modem": {"unet": 1101},
             "run": ["ssh", "auv", "go now"]}  # fmt: skip
    assert agent_options(GatewaySection.model_validate(given)) == [
        "--zenoh=tcp/0.0.0.0:7501", "--carry=a/**", "--udp=9000=h:1", "--modem=unet=1101", "--run=ssh auv 'go now'",
    ]  # fmt: skip


STRANGER = """
title: Somebody else's scenario
vehicles: 2
duration: 1 s
tick: 10 ms
graph: {edges: {1->2: 1, 2->1: 1}, reference: [1]}
network: {period: 100 ms}
reference: {start: 0 0 10 m, velocity: 0.5 0 0 m/s}
formation: {offsets: [0 0 0 m, 5 0 0 m]}
initial: [{position: 0 0 10 m}, {position: 5 0 10 m}]
per_vehicle: {1: {gateway: {udp: {"9123": "127.0.0.1:9124"}, run: [touch, WHERE]}}}
"""


def test_a_stranger_s_scenario_starts_no_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (stranger := tmp_path / "stranger").mkdir()
    (own := tmp_path / "own").mkdir()
    monkeypatch.chdir(own)
    (stranger / "s.yaml").write_text(STRANGER.replace("WHERE", str(own / "touched")))
    for verb in ("run", "sweep"):
        more = ("--seeds", 1) if verb == "sweep" else ()
        done = invoke(verb, stranger / "s.yaml", *more)
        assert done.exit_code == 2 and "would run touch" in done.output and "--trust runs it" in done.output, (
            done.output
        )
    assert not (own / "touched").exists()
