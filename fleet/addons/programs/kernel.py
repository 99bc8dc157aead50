"""What the kernel says of processes."""

from __future__ import annotations

import os
import select
from contextlib import suppress
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def process_group(leader: int) -> list[int]:
    """The processes of a group, by the kernel's numbers."""
    found = []
    for name in os.listdir("/proc"):
        if name.isdecimal():
            with suppress(OSError):
                if os.getpgid(int(name)) == leader:
                    found.append(int(name))
    return found


def wait_for_end(pid: int) -> None:
    """Wait until a process that ends has ended: the kernel may close its channel before its pipes."""
    with suppress(OSError):
        descriptor = os.pidfd_open(pid)
        try:
            ends = select.poll()
            ends.register(descriptor, select.POLLIN)
            ends.poll(1000)
        finally:
            os.close(descriptor)


def memory_kb(pid: int, file: str, keys: tuple[str, ...]) -> int:
    """The sum of some figures of a process's memory [kB]."""
    try:
        lines = Path(f"/proc/{pid}/{file}").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) for line in lines if line.startswith(keys))


def cpu_s(pid: int) -> float:
    """The time that a process has computed [s]; 0: there is none."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S
