"""Baselines: the same pattern of messages with nothing in it, over bare zenoh and over pipes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from multiprocessing.connection import Connection, Pipe
from pathlib import Path

from fleet.bench.echo import echo_bus, echo_pipe
from fleet.errors import FleetError
from fleet.processes.children import Children, RunFolder
from netem.private_folder import PrivateFolder
from netem.wire.access import agent_role, generate
from netem.wire.bus import Bus
from netem.wire.keys import Keys

MESSAGE = b"x" * 100
READY_S = 60.0


def zenoh_barrier(n: int, ticks: int) -> float:
    """Ticks per second of "world -> n agents -> world" with agents that only echo.

    Raises:
        FleetError: an echo agent did not answer in time.
    """
    ids = tuple(range(1, n + 1))
    keys, credentials = Keys("bench"), generate(ids)
    with closing(RunFolder()) as private, _children() as (children, log):
        endpoint = private.endpoint  # as in a run
        bus = Bus.host(endpoint, keys, ids, credentials, private.path)
        try:
            channel = bus.channel(keys.cmd("*"))
            for i in ids:
                role = agent_role(i)
                children.start(role, f"fleet bench {i}", log, echo_bus, endpoint, keys.run, i, credentials[role])
            waiting = set(ids)
            puts = {i: bus.publisher(keys.nav(i)) for i in ids}
            deadline = time.monotonic() + READY_S
            while waiting:  # an echo is the proof of readiness
                for i in waiting:
                    puts[i](MESSAGE)
                time.sleep(0.05)
                while (item := channel.poll()) is not None:
                    waiting.discard(int(item[0].rsplit("/", 1)[1]))
                if time.monotonic() > deadline:
                    raise FleetError(f"{len(waiting)} echo agents did not answer within {READY_S:.0f} s", status=3)
            time.sleep(0.2)
            while channel.poll() is not None:
                pass
            began = time.perf_counter()
            for _ in range(ticks):
                for put in puts.values():
                    put(MESSAGE)
                for _ in ids:
                    channel.get()
            return ticks / (time.perf_counter() - began)
        finally:
            bus.close()


def pipe_barrier(n: int, ticks: int) -> float:
    """The same over OS pipes."""
    ends: list[Connection[bytes, bytes]] = []
    with _children() as (children, log):
        for i in range(1, n + 1):
            ours, theirs = Pipe()
            children.start(agent_role(i), f"fleet bench {i}", log, echo_pipe, theirs)
            theirs.close()
            ends.append(ours)
        for end in ends:
            end.send_bytes(MESSAGE)
        for end in ends:
            end.recv_bytes()
        began = time.perf_counter()
        for _ in range(ticks):
            for end in ends:
                end.send_bytes(MESSAGE)
            for end in ends:
                end.recv_bytes()
        return ticks / (time.perf_counter() - began)


@contextmanager
def _children() -> Iterator[tuple[Children, Path]]:
    with PrivateFolder("bench") as folder:
        children = Children(lambda _: None)
        try:
            yield children, folder / "log"
        finally:
            children.stop()
