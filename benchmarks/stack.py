"""The delay that `fleet netem` adds, and the rate that it carries: `python benchmarks/stack.py`.

1. One program sends to another over an ideal link: 1,000 messages/s of 100 bytes, then of 1 kB, and 30 messages/s of
   1 MB. The same two programs at one zenoh router are the baseline, before and after. The table has the latency from
   put to callback, and what the network adds. The median of several turns counts.
2. Four robots, each with a program that puts 100 bytes at a growing rate; each message goes to three neighbours. A rate
   holds if every message arrived, and at each robot at most 1 % more than 20 ms after it was put. The table ends where
   that is no longer so.
3. Ten robots, each with a program that puts on 100 topics in turn; each message goes to nine neighbours.

Senders say how late they were themselves: a machine that is busy with them measures nothing.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import click

from fleet.processes.ports import free_port

# A program: `send PORT KEY TOPICS RATE BYTES SECONDS BEGIN` or `hear PORT KEYS SECONDS BEGIN`; it prints JSON.
PROGRAM = """
import json, sys, time, zenoh
what, port, key, *rest = sys.argv[1:]
config = zenoh.Config()
settings = {"mode": "client", "connect/endpoints": ["tcp/127.0.0.1:" + port], "scouting/multicast/enabled": False}
for name, value in settings.items():
    config.insert_json5(name, json.dumps(value))
session, found = zenoh.open(config), []
seconds, begin = float(rest[-2]), float(rest[-1])
def heard(sample):
    found.append(time.monotonic_ns() - int.from_bytes(sample.payload.to_bytes()[:8], "little"))
if what == "hear":
    session.declare_subscriber(key, zenoh.handlers.Callback(heard, indirect=False))
    time.sleep(max(0.0, begin + seconds + 1.5 - time.monotonic()))
else:
    topics, rate, size = int(rest[0]), float(rest[1]), int(rest[2])
    publishers, rest = [session.declare_publisher(f"{key}/{n}") for n in range(topics)], bytes(size - 8)
    time.sleep(max(0.0, begin - time.monotonic()))
    for number in range(round(rate * seconds)):
        due = begin + number / rate
        while (left := due - time.monotonic()) > 0:
            time.sleep(min(left, 0.001))
        publishers[number % topics].put(time.monotonic_ns().to_bytes(8, "little") + rest)
        found.append(int((time.monotonic() - due) * 1e9))
found.sort()
at = lambda share: found[min(len(found) - 1, int(share * len(found)))] / 1e6 if found else None
print(json.dumps({"count": len(found), "p50": at(0.5), "p99": at(0.99), "most": at(1.0)}))
session.close()
"""
ROUTER = """
import json, sys, time, zenoh
config = zenoh.Config()
endpoint = "tcp/127.0.0.1:" + sys.argv[1]
settings = {"mode": "router", "listen/endpoints": [endpoint], "scouting/multicast/enabled": False}
for name, value in settings.items():
    config.insert_json5(name, json.dumps(value))
session = zenoh.open(config)
time.sleep(1e6)
"""
READY_S, MOST_LATE_MS = 2.0, 20.0
LATENCIES = ((1000, 100), (1000, 1000), (30, 1_000_000))  # messages/s, bytes
RATES = (1_000, 2_000, 2_500, 3_000, 3_500, 4_000, 5_000, 6_000, 8_000)  # messages/s of all robots
TOPICS_RATES = (250, 500, 750, 1_000)


def until_open(ports: Sequence[int]) -> None:
    for port in ports:
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.05)


def program(*words: object) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", PROGRAM, *map(str, words)], stdout=subprocess.PIPE, text=True)


def said(process: subprocess.Popen[str]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(process.communicate()[0].splitlines()[-1])
    return found


@contextmanager
def router() -> Iterator[int]:
    port = free_port(None)
    process = subprocess.Popen([sys.executable, "-c", ROUTER, str(port)])
    until_open([port])
    yield port
    process.kill()
    process.wait()


@contextmanager
def netem(nodes: int, result: dict[str, Any]) -> Iterator[list[int]]:
    """A run of the network; its result is in `result` afterwards."""
    ports = [free_port(None) for _ in range(nodes)]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "stack.yaml"
        own = {f"r{i}": {"listen": f"tcp/127.0.0.1:{port}"} for i, port in enumerate(ports, start=1)}
        file.write_text(json.dumps({"title": "A benchmark", "nodes": own}), "utf-8")
        words = [sys.executable, "-m", "fleet", "netem", str(file), "-o", folder, "--json", "-q"]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        until_open(ports)
        yield ports
        process.send_signal(signal.SIGINT)
        result |= json.loads(process.communicate()[0])


def pair(sender: int, hearer: int, rate: int, size: int, seconds: float) -> tuple[dict[str, Any], dict[str, Any]]:
    begin = time.monotonic() + READY_S
    hears = program("hear", hearer, "b/**", seconds, begin)
    sends = program("send", sender, "b/x", 1, rate, size, seconds, begin)
    return said(sends), said(hears)


def latency(rate: int, size: int, seconds: float, turns: int) -> None:
    print(f"{rate:5} messages/s of {size:7} bytes   heard  p50 [ms]  p99 [ms]  most [ms]  sender late, p99 [ms]")
    added = []
    for _ in range(turns):
        rows, result = [], dict[str, Any]()
        with router() as port:
            rows.append(("one zenoh router", *pair(port, port, rate, size, seconds)))
        with netem(2, result) as (first, second):
            rows.append(("fleet netem", *pair(first, second, rate, size, seconds)))
        with router() as port:
            rows.append(("one zenoh router", *pair(port, port, rate, size, seconds)))
        for name, sent, heard in rows:
            counts = f"{heard['count']:8}  {heard['p50']:8.2f}  {heard['p99']:8.2f}  {heard['most']:9.2f}"
            print(f"{name:32} {counts}  {sent['p99']:10.2f}", flush=True)
        base50, base99 = (sum(row[2][key] for row in (rows[0], rows[2])) / 2 for key in ("p50", "p99"))
        own = rows[1][2]
        added.append((own["p50"] / base50, own["p50"] - base50, own["p99"] - base99))
    times, more50, more99 = (median(column) for column in zip(*added, strict=True))
    print(f"p50 is {times:.1f} times the router's; added: {more50:.2f} ms (p50), {more99:.2f} ms (p99)")


def capacity(robots: int, topics: int, rates: Sequence[int], seconds: float) -> None:
    print(f"{robots} robots, {topics} topics each, 100 bytes")
    print("messages/s  packets/s    arrived of what was put   after put: p99 [ms]  most [ms]  sender late, p99 [ms]")
    for rate in rates:
        result: dict[str, Any] = {}
        with netem(robots, result) as ports:
            begin = time.monotonic() + READY_S + 0.2 * robots
            hear = [program("hear", port, "*/x/*", seconds, begin) for port in ports]
            send = [
                program("send", port, f"{i}/x", topics, rate / robots, 100, seconds, begin)
                for i, port in enumerate(ports)
            ]
            sent, heard = [said(one) for one in send], [said(one) for one in hear]
        put = sum(one["count"] for one in sent)
        arrived = sum(one["count"] for one in heard) - put  # each hears its own, too
        p99, most = (max(one[key] for one in heard) for key in ("p99", "most"))
        holds = arrived == (robots - 1) * put and p99 <= MOST_LATE_MS
        shown = f"{p99:19.1f}  {most:9.1f}  {max(one['p99'] for one in sent):10.1f}"
        what = f"{arrived:10} of {(robots - 1) * put:10}"
        print(f"{rate:10} {(robots - 1) * rate:10} {what}  {shown}  {'' if holds else 'ends here'}", flush=True)
        if not holds:
            return


@click.command()
@click.option("--seconds", default=10.0, show_default=True, help="Of each measurement.")
@click.option("--turns", default=3, show_default=True, help="Of each latency; their median counts.")
def main(seconds: float, turns: int) -> None:
    print(f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}")
    for rate, size in LATENCIES:
        latency(rate, size, seconds, turns)
    capacity(4, 1, RATES, seconds)
    capacity(10, 100, TOPICS_RATES, seconds)


if __name__ == "__main__":
    main()
