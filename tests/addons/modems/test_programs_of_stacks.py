"""Programs that a stack starts, and that open modems while they get ready."""

from __future__ import annotations

import sys
from pathlib import Path

from stacks import Stack
from waiting import wait_for

LIMIT_S = 60.0
# Its modem answers before t = 0. What the first one sends then is under way when the run begins.
PROGRAM = """
import socket, sys
modem = socket.create_connection(("127.0.0.1", int(sys.argv[1]))).makefile("rwb", buffering=0)
modem.write(b"+++AT?AL\\n")
print("address", modem.readline().decode().strip(), flush=True)
if sys.argv[2] == "sends":
    modem.write(b"+++AT*SENDIM,5,2,noack,early\\n")
for line in modem:
    print("hears", line.decode().strip(), flush=True)
"""


def test_a_modem_answers_programs_that_get_ready(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(PROGRAM, "utf-8")
    nodes = {name: {"modem": {"evologics": 0}, "place": f"{north} 0 10 m"} for north, name in enumerate("ab")}
    programs = {
        name: {"run": [sys.executable, "program.py", "{modem}", word], "ready": {"line": "address"}}
        for name, word in (("a", "sends"), ("b", "hears"))
    }
    water = {"acoustic": {"modem": "s2c", "backoff": "10 ms", "queue": 4}}
    with Stack(tmp_path, "--trust", nodes=nodes, network=water, programs=programs, begin="100 ms").begun() as stack:
        log = stack.directory / "log" / "b.log"
        wait_for(lambda: log.exists() and "RECVIM" in log.read_text("utf-8"), LIMIT_S, "what was sent before t = 0")
        stack.end()
    said = log.read_text("utf-8")
    assert "address" in said and said.count("RECVIM") == 1
