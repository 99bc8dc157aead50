"""Baselines that know nothing of fleets: the pattern of messages over bare zenoh, and a loop of plain Python."""

from __future__ import annotations

import time
from contextlib import closing
from statistics import median

from fleet.errors import FleetError
from fleet.processes.children import Children
from fleet.processes.run_folder import RunFolder
from netem.private_folder import PrivateFolder
from netem.wire.bus import Bus
from netem.wire.credentials import Credentials, agent_role, generate
from netem.wire.keys import Keys

MESSAGE = b"x" * 100
READY_S = 60.0
ZENOH, LOOP = "a zenoh barrier", "plain Python loop"
_ROUNDS, _PASSES = 5, 20_000


def zenoh_barrier(n: int, ticks: int) -> float:
    """Ticks per second of "world -> n agents -> world" with agents that only echo.

    Raises:
        FleetError: an echo agent did not answer in time.
    """
    ids = tuple(range(1, n + 1))
    keys, credentials = Keys("bench"), generate(ids)
    children = Children(lambda _: None)
    with PrivateFolder("bench") as folder, closing(RunFolder()) as private:
        endpoint = private.endpoint  # as in a run
        bus = Bus.host(endpoint, keys, ids, credentials, private.path)
        try:
            channel = bus.channel(keys.cmd("*"))
            for i in ids:
                role = agent_role(i)
                arguments = (endpoint, keys.run, i, credentials[role])
                children.start(role, f"benchmark {i}", folder / "log", _echo, *arguments)
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
            children.stop()


def _echo(endpoint: str, run_id: str, vehicle: int, credentials: Credentials) -> None:
    keys = Keys(run_id)
    bus = Bus.connect(endpoint, credentials)
    put = bus.publisher(keys.cmd(vehicle))
    channel = bus.channel(keys.nav(vehicle))
    while True:
        put(channel.get()[1])


class _Point:
    __slots__ = ("x", "y")

    def __init__(self, x: float, y: float) -> None:
        self.x, self.y = x, y


def _turned(point: _Point, by: float) -> _Point:
    return _Point(point.x - by * point.y, point.y + by * point.x)


def loops_per_s() -> float:
    """Passes per second of CPU time of a loop with calls, objects and floats; the median of some rounds of some ms.

    The loop stays as it is: files of earlier versions are compared by it.
    """
    found = []
    for _ in range(_ROUNDS):
        began, point = time.process_time(), _Point(1.0, 0.0)
        for _ in range(_PASSES):
            point = _turned(point, 1e-4)
        found.append(_PASSES / (time.process_time() - began))
    return median(found)
