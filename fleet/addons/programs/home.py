"""The disk of a program: its home, and the files of a host that it is shown, such as /etc/hosts."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from netem.private_folder import PrivateFolder

_HOME = "home"
_NOT_KEPT = (".shm", ".tmp", ".run", ".host")  # /dev/shm and so on: as after a restart of the computer
_COUNTERS = ("rchar", "wchar", "syscr", "syscw", "read_bytes", "write_bytes", "cancelled_write_bytes")  # of /proc


class Home:
    """A folder for the home of a program, from its start to `close`."""

    def __init__(
        self,
        files: Sequence[Path],
        agent: int,
        agents: int,
        epoch_ns: int,
        processors: int,
        disk: Path | None = None,
        disk_before: Path | None = None,
    ) -> None:
        """Make it, unless a former life of the program has left it.

        Args:
            files: files and folders that are copied into a new one.
            agent: number of the agent.
            agents: how many there are.
            epoch_ns: the real time at the beginning of a run [ns since 1970].
            processors: how many the program sees.
            disk: where it is, and stays when the program ends; None: in a private folder, which goes with the program.
            disk_before: in place of `disk`, how that was when this life began, see `copy_of_disk`; None: it was empty.
        """
        self._folder = PrivateFolder("home") if disk is None else None
        self.path = (self._folder.path if self._folder else disk or Path()).resolve() / _HOME
        if disk is None and disk_before is not None:
            _copy(disk_before, self.path)
        new = not self.path.exists()
        self.path.mkdir(exist_ok=True)
        for name in _NOT_KEPT:
            shutil.rmtree(self.path / name, ignore_errors=True)
            (self.path / name).mkdir()
        _show_host(self.path / ".host", agent, agents, epoch_ns, processors)
        for path in files if new else ():
            if path.is_dir():
                _copy(path, self.path / path.name)
            else:
                shutil.copy2(path, self.path / path.name)

    def close(self) -> None:
        """Remove it, unless it is to stay."""
        if self._folder is not None:
            self._folder.close()


def _show_host(host: Path, agent: int, agents: int, epoch_ns: int, processors: int) -> None:
    """Write what a program finds below /etc, /proc and /sys."""
    width = "10.0.{}.{}"
    names = [f"{width.format(i >> 8, i & 255)} auv{i} auv-{i} agent{i}" for i in range(1, agents + 1)]
    texts = {
        "hosts": "\n".join(["127.0.0.1 localhost", "::1 localhost ip6-localhost", *names, ""]),
        "resolv.conf": "",
        "nsswitch.conf": "passwd: files\ngroup: files\nhosts: files\nservices: files\nprotocols: files\n",
        "host.conf": "multi on\n",
        "hostname": f"auv-{agent}\n",
        "machine-id": f"{agent:032x}\n",
        "boot_id": f"00000000-0000-4000-8000-{agent:012x}\n",
        "timezone": "Etc/UTC\n",
        "meminfo": "MemTotal: 4194304 kB\nMemFree: 2097152 kB\nMemAvailable: 2097152 kB\nSwapTotal: 0 kB\n",
        "uptime": "1000.00 1000.00\n",
        "loadavg": "0.00 0.00 0.00 1/1 1\n",
        "stat": f"cpu 0 0 0 0 0 0 0 0 0 0\ncpu0 0 0 0 0 0 0 0 0 0 0\nbtime {epoch_ns // 10**9 - 1000}\n",
        "route": "Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\tWindow\tIRTT\n"
        "auv0\t0000000A\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0\n",
        "processors": f"0-{processors - 1}\n" if processors > 1 else "0\n",
        "dev": "Inter-| Receive | Transmit\n face |bytes packets errs drop fifo frame compressed multicast|"
        "bytes packets errs drop fifo colls carrier compressed\n"
        + "".join(f"  {name}: {' '.join('0' * 16)}\n" for name in ("lo", "auv0")),
        "self_stat": f"{1000 + agent} (program) S 1 1000 1000 0 -1 0 0 0 0 0 0 0 0 0 20 0 1 0 100000 "
        f"268435456 16384 {2**64 - 1} 1 1 0 0 0 0 0 0 0 0 0 0 17 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n",
        "self_statm": "65536 16384 4096 1 0 16384 0\n",
        "self_io": "".join(f"{name}: 0\n" for name in _COUNTERS),
        "empty": "",
    }
    for name, text in texts.items():
        (host / name).write_text(text)
    with suppress(OSError):
        shutil.copy("/usr/share/zoneinfo/UTC", host / "localtime")


def copy_of_disk(disk: Path) -> Path | None:
    """Copy what a former life of a program has left, beside it; None: it has left nothing.

    Args:
        disk: the folder of its home.
    """
    home = disk / _HOME
    if not home.exists():
        return None
    copy = disk / f"before-{sum(1 for _ in disk.iterdir())}"
    _copy(home, copy)
    return copy


def _copy(source: Path, to: Path) -> None:
    """Copy a folder, without what cannot be copied, such as sockets, and without what does not outlive a start."""

    def left_out(folder: str, names: list[str]) -> list[str]:
        paths = [Path(folder, name) for name in names]
        return [each.name for each in paths if each.name in _NOT_KEPT or not (each.is_symlink() or _can_copy(each))]

    shutil.copytree(source, to, symlinks=True, ignore=left_out)


def _can_copy(path: Path) -> bool:
    return path.is_dir() or path.is_file()
