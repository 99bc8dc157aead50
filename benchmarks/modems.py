"""Modems that programs open, for a long time: `python benchmarks/modems.py --modems 20 --rate 2 --minutes 60`.

Each modem has a client of UnetStack (`unetpy`), which broadcasts four bytes at random. The table has the memory and the
open descriptors of the console, the relay and the clients each minute. The verdict at the end says what the channel
carried, and whether the machine kept up (`punctual`).

With `--clock simulated` each node runs a client of its own in simulated time, and the run is made twice: the table has
how long both took, and their digests.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import click

import fleet

AROUND_M = 500.0  # the modems stand in a circle of this radius
BEGIN_S = 20.0  # until the ports are open, on a busy machine
AFTER_S = 10.0  # after the last message

# Programs: `RATE SECONDS PORT...` sends at random, and prints how many messages it gave its modems.
PROGRAM = """
import random, sys, time
from heapq import heapify, heapreplace
from unetpy import Services, TxFrameReq, UnetSocket
rate, seconds, ports = float(sys.argv[1]), float(sys.argv[2]), list(map(int, sys.argv[3:]))
draws, each = random.Random(1), rate / len(ports)
gateways = [UnetSocket("127.0.0.1", port).getGateway() for port in ports]
modems = [gateway.agentForService(Services.PHYSICAL) for gateway in gateways]
begin, sent = time.monotonic(), 0
turns = [(begin + draws.expovariate(each), n) for n in range(len(ports))]
heapify(turns)
while turns[0][0] < begin + seconds:
    at, n = turns[0]
    time.sleep(max(0.0, at - time.monotonic()))
    gateways[n].send(TxFrameReq(recipient=modems[n], to=0, data=[1, 2, 3, 4]))
    sent += 1
    heapreplace(turns, (at + draws.expovariate(each), n))
print(sent)
"""


def stack(modems: int, first: int, mac: str) -> dict[str, object]:
    """A file of `fleet netem` with so many modems, at ports from `first` on."""
    turns = [2.0 * math.pi * n / modems for n in range(modems)]
    nodes = {
        f"m{n + 1}": {
            "modem": {"unet": first + n},
            "place": f"{AROUND_M * math.cos(turn):.1f} {AROUND_M * math.sin(turn):.1f} 10 m",
        }
        for n, turn in enumerate(turns)
    }
    return {
        "title": f"{modems} modems",
        "nodes": nodes,
        "network": {"acoustic": {"modem": "s2c", "mac": mac, "queue": 10}},
    }


# A program of one node: `RATE SECONDS SEED PORT`.
CLIENT = """
import random, sys, time
from unetpy import Services, TxFrameReq, UnetSocket
rate, seconds, port = float(sys.argv[1]), float(sys.argv[2]), int(sys.argv[4])
draws = random.Random(int(sys.argv[3]))
gateway = UnetSocket("127.0.0.1", port).getGateway()
modem = gateway.agentForService(Services.PHYSICAL)
at = end = time.monotonic()
end += seconds
while (at := at + draws.expovariate(rate)) < end:
    time.sleep(max(0.0, at - time.monotonic()))
    gateway.send(TxFrameReq(recipient=modem, to=0, data=[1, 2, 3, 4]))
time.sleep(1e6)
"""


def simulate(folder: Path, modems: int, rate: float, minutes: float, mac: str, tick: str) -> None:
    """Make the run in simulated time twice, and print how long it took and its digest."""
    (folder / "client.py").write_text(CLIENT, "utf-8")
    run = ["python", "client.py", f"{rate / modems:g}", f"{60.0 * minutes:g}", "{number}", "{modem}"]
    more = {"clock": "simulated", "duration": f"{60.0 * minutes + AFTER_S:g} s", "tick": tick}
    text = json.dumps(stack(modems, 1, mac) | more | {"programs": {"m*": {"run": run}}})
    (folder / "modems.yaml").write_text(text, "utf-8")
    for _ in range(2):
        began = time.monotonic()
        found = fleet.run(folder / "modems.yaml", out=folder / "runs", trust=True)
        sent = sum(link.sent for link in found.ledger.values()) / (modems - 1)
        took_s = time.monotonic() - began
        times = (60.0 * minutes + AFTER_S) / took_s
        print(f"{took_s:7.1f} s, {times:5.1f} times real time, {sent:.0f} frames, {found.status}, {found.digest[:16]}")


def used(pid: int) -> str:
    """The memory [MB] and the open descriptors of a process."""
    with suppress(OSError, StopIteration):
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        kb = int(next(line for line in lines if line.startswith("VmRSS")).split()[1])
        return f"{kb / 1000:7.1f} MB {len(list(Path(f'/proc/{pid}/fd').iterdir())):4d}"
    return "      gone      "


def relay_of(console: int) -> int:
    """The process of the relay, which a child of the console has begun."""
    parents = {}
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
    children = [pid for pid, parent in parents.items() if parent == console]
    return next((pid for pid, parent in sorted(parents.items()) if parent in children), 0)


@click.command(help=__doc__)
@click.option("--modems", default=20, show_default=True)
@click.option("--rate", default=2.0, show_default=True, help="Messages of all clients together [1/s].")
@click.option("--minutes", default=60.0, show_default=True)
@click.option("--mac", default="csma", show_default=True)
@click.option("--first-port", default=23_400, show_default=True)
@click.option("--clock", type=click.Choice(["real", "simulated"]), default="real", show_default=True)
@click.option("--tick", default="100 ms", show_default=True, help="Of the run in simulated time.")
def main(modems: int, rate: float, minutes: float, mac: str, first_port: int, clock: str, tick: str) -> None:
    if clock == "simulated":
        with tempfile.TemporaryDirectory() as made:
            simulate(Path(made), modems, rate, minutes, mac, tick)
        return
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "modems.yaml").write_text(json.dumps(stack(modems, first_port, mac)), "utf-8")
        duration = f"{BEGIN_S + 60.0 * minutes + AFTER_S:g} s"
        said = (Path(folder) / "said").open("w+")
        run = subprocess.Popen(
            [sys.executable, "-m", "fleet", "netem", "modems.yaml", "--duration", duration],
            cwd=folder, stdout=said, stderr=subprocess.STDOUT,
        )  # fmt: skip
        time.sleep(BEGIN_S)
        ports = map(str, range(first_port, first_port + modems))
        clients = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(rate), str(60.0 * minutes), *ports], stdout=subprocess.PIPE, text=True
        )
        print("      min           console            relay          clients")
        relay, began = relay_of(run.pid), time.monotonic()
        while run.poll() is None:
            row = "  ".join(used(pid) for pid in (run.pid, relay, clients.pid))
            print(f"{(time.monotonic() - began) / 60.0:9.1f}  {row}", flush=True)
            with suppress(subprocess.TimeoutExpired):
                run.wait(60.0)
        print(f"{clients.communicate()[0].strip()} messages were given to the modems")
        said.seek(0)
        print("".join(line for line in said if not line.startswith("t = ")))


if __name__ == "__main__":
    main()
