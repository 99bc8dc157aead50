"""Vehicles that programs steer: by keys of zenoh, by datagrams of a C program, and not at all."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from textwrap import dedent

import pytest
from own_program import lines, scenario

import fleet
from fleet.result.result import Result, Status

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")
WATER = {
    "moored": False, "formation": "{shape: line, spacing: 8 m}", "checks": "{tumbled: waived}",
    "reference": "{start: 0 0 5 m, velocity: 0.5 0 0 m/s}",
    "initial": "[{position: 0 0 5 m, surge: 0.1 m/s}, {position: 0 9 5 m, surge: 0.1 m/s}]",
}  # fmt: skip
BY_ZENOH = """
    import json, sys, time, zenoh
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([sys.argv[2]]))
    seen = []
    with zenoh.open(config) as session:
        session.declare_subscriber("self/nav", lambda s: seen.append(json.loads(s.payload.to_bytes())))
        others = session.declare_subscriber("**")
        time.sleep(0.5)
        session.put("self/cmd", json.dumps({"force": 7.0, "yaw": 1.0}))
        session.put("self/cmd", "no command")
        time.sleep(2)
        print(sorted(seen[-1]), len(seen[-1]["position"]), seen[-1]["t"] > 2.4)
        print(sorted({str(s.key_expr) for s in iter(others.try_recv, None)}))
        time.sleep(9)
"""
BY_DATAGRAMS = r"""
    #include <arpa/inet.h>
    #include <stdio.h>
    #include <string.h>
    #include <sys/socket.h>

    int main(void) {
      int in = socket(AF_INET, SOCK_DGRAM, 0), count = 0;
      struct sockaddr_in at = {.sin_family = AF_INET, .sin_port = htons(14560)}, to = at;
      to.sin_port = htons(14561);
      to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
      if (bind(in, (struct sockaddr *)&at, sizeof at)) return 1;
      char data[2000];
      for (ssize_t size; (size = recv(in, data, sizeof data - 1, 0)) > 0;) {
        data[size] = 0;
        if (++count == 100) puts(strstr(data, "\"position\": [") ? "1 v" : data), fflush(stdout);
        const char *command = "{\"force\": 7, \"pitch\": 0, \"yaw\": 1}";
        sendto(in, command, strlen(command), 0, (struct sockaddr *)&to, sizeof to);
      }
    }
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def steered(tmp_path: Path, program: str, **changes: str) -> Result:
    text = scenario('["{id}", "{zenoh}"]').replace("program: program.py", f"program: {program}")
    (tmp_path / "own.yaml").write_text(text)
    return fleet.run("own.yaml", out=tmp_path / "runs", set=WATER | changes)


def last_command(result: Result) -> list[float]:
    assert result.directory is not None
    tau: list[float] = fleet.open_log(result.directory)["uuv/2/command"]["tau"][-1].tolist()
    return tau


def test_a_zenoh_program_steers(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(dedent(BY_ZENOH))
    result = steered(tmp_path, "program.py")
    assert result.status is Status.PASS, (result.reason, lines(result))
    assert last_command(result) == [7.0, 0.0, 1.0]
    keys = "['position', 'psi', 'q', 'r', 't', 'theta', 'velocity']"
    assert lines(result) == [f"{keys} 3 True", "['self/cmd', 'self/nav']"]  # nothing of the other vehicle


def test_a_c_program_steers_by_datagrams(tmp_path: Path) -> None:
    (tmp_path / "program.c").write_text(dedent(BY_DATAGRAMS))
    subprocess.run(["cc", "-o", "program", "program.c"], cwd=tmp_path, check=True)
    result = steered(tmp_path, "program")
    assert result.status is Status.PASS, (result.reason, lines(result))
    assert last_command(result) == [7.0, 0.0, 1.0] and lines(result) == ["1 v"]


def test_a_velocity_is_held(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(
        "import json, socket, time\n"
        "to = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "command = json.dumps({'surge': 0.5, 'yaw_rate': -0.1})\n"
        "to.sendto(command.encode(), ('127.0.0.1', 14561))\n"
        "time.sleep(99)\n"
    )
    result = steered(tmp_path, "program.py", duration="12 s")
    assert result.directory is not None
    state = fleet.open_log(result.directory)["uuv/2/state"]
    assert state["u"][-1] == pytest.approx(0.5, abs=0.02) and state["r"][-1] == pytest.approx(-0.1, abs=0.005)


def test_a_program_that_commands_nothing_leaves_it_to_the_laws(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text("import time\ntime.sleep(99)\n")
    result = steered(tmp_path, "program.py")
    assert result.status is Status.PASS and last_command(result) not in ([7.0, 0.0, 1.0], [0.0, 0.0, 0.0])
