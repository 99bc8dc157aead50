"""What a round trip over zenoh costs a process beside one over a pipe: CPU time, wake-ups, and messages per wake-up.

    python benchmarks/zenoh_wakeups.py --rounds 20000

It needs `eclipse-zenoh` alone. A parent sends 100 bytes, a child sends them back, and both wait for each other.
A wake-up is a voluntary context switch of any thread of the process. To wait for a message and answer it takes one.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import zenoh

MESSAGE = b"x" * 100
WARM_UP = 500
Exchange = Callable[[], None]


class Cost(NamedTuple):
    """Of one round trip, of one of the two processes."""

    cpu_us: float
    wake_ups: float


def main() -> None:
    """Measure both ways, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=20_000, help="round trips that are measured")
    rounds = parser.parse_args().rounds
    print(f"{'':8}{'wall [us]':>12}{'parent CPU [us]':>18}{'wake-ups':>10}{'child CPU [us]':>18}{'wake-ups':>10}")
    for name, measure in (("pipe", over_pipe), ("zenoh", over_zenoh)):
        wall_us, parent, child = measure(rounds)
        cells = f"{parent.cpu_us:18.1f}{parent.wake_ups:10.2f}{child.cpu_us:18.1f}{child.wake_ups:10.2f}"
        print(f"{name:8}{wall_us:12.1f}{cells}")


def over_pipe(rounds: int) -> tuple[float, Cost, Cost]:
    """Wall time of a round trip [us], and what it costs parent and child, over a pipe of the system."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    report, told = context.Pipe(duplex=False)
    child = context.Process(target=_echo_pipe, args=(theirs, told, rounds))
    child.start()

    def exchange() -> None:
        ours.send_bytes(MESSAGE)
        ours.recv_bytes()

    found = _measured(exchange, rounds)
    theirs_cost = Cost(*report.recv())
    child.join()
    return *found, theirs_cost


def over_zenoh(rounds: int) -> tuple[float, Cost, Cost]:
    """The same over zenoh sessions that a Unix socket joins."""
    context = multiprocessing.get_context("spawn")
    report, told = context.Pipe(duplex=False)
    with tempfile.TemporaryDirectory() as folder:
        endpoint = f"unixsock-stream/{Path(folder) / 'socket'}"
        with zenoh.open(_config("listen", endpoint)) as session:
            answers = session.declare_subscriber("there", zenoh.handlers.FifoChannel(64))
            put = session.declare_publisher("here")
            child = context.Process(target=_echo_zenoh, args=(endpoint, told, rounds))
            child.start()
            while answers.try_recv() is None:  # an echo is the proof that the child is there
                put.put(b"?")
                time.sleep(0.05)
            time.sleep(0.2)
            while answers.try_recv() is not None:
                pass

            def exchange() -> None:
                put.put(MESSAGE)
                answers.recv()

            found = _measured(exchange, rounds)
            theirs_cost = Cost(*report.recv())
            child.join()
    return *found, theirs_cost


def _config(way: str, endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("peer"))
    config.insert_json5("scouting/multicast/enabled", "false")
    for each in ("listen", "connect"):
        config.insert_json5(f"{each}/endpoints", json.dumps([endpoint] if each == way else []))
    return config


def _echo_pipe(connection: Connection[bytes, bytes], told: Connection[list[float], None], rounds: int) -> None:
    def exchange() -> None:
        connection.send_bytes(connection.recv_bytes())

    told.send(list(_measured(exchange, rounds)[1]))


def _echo_zenoh(endpoint: str, told: Connection[list[float], None], rounds: int) -> None:
    with zenoh.open(_config("connect", endpoint)) as session:
        questions = session.declare_subscriber("here", zenoh.handlers.FifoChannel(64))
        put = session.declare_publisher("there")

        def exchange() -> None:
            put.put(questions.recv().payload)

        while bytes((question := questions.recv()).payload) == b"?":
            put.put(question.payload)
        put.put(question.payload)  # the first of those that are measured
        told.send(list(_measured(exchange, rounds, first=1)[1]))


def _measured(exchange: Exchange, rounds: int, first: int = 0) -> tuple[float, Cost]:
    for _ in range(WARM_UP - first):
        exchange()
    before, wall = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
    for _ in range(rounds):
        exchange()
    wall, after = time.perf_counter() - wall, resource.getrusage(resource.RUSAGE_SELF)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return 1e6 * wall / rounds, Cost(1e6 * cpu_s / rounds, (after.ru_nvcsw - before.ru_nvcsw) / rounds)


if __name__ == "__main__":
    main()
