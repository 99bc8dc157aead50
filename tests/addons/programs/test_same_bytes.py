"""Programs whose bytes could depend on the machine, the hour or the way of running: they do not.

Eight programs run beside each other, as one file that looks at its number. Each way of running compares all of them.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
from own_program import lines, scenario
from tool import invoke

import fleet
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.repeat.verify import verify
from fleet.result.result import Result
from fleet.scenario.loading import load_scenario

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")
PROGRAM = """
    import asyncio, gc, gzip, json, os, pickle, random, socket, sqlite3, statistics, subprocess, sys, tempfile
    import threading, time
    from concurrent.futures import ThreadPoolExecutor, as_completed
    from datetime import datetime

    me = int(sys.argv[1])
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    out.bind(("", 9000))
    out.settimeout(0.1)

    def tell(what):
        print(what, flush=True)
        out.sendto(repr(what).encode()[:500], ("10.0.0.255", 9000))
        try: print(out.recvfrom(1000))
        except TimeoutError: pass

    class Thing:
        def __init__(self, n): self.n, self.itself = n, self

    def addresses():  # a set in the order of addresses
        tell([each.n for each in {Thing(k) for k in range(12)}])

    def collected():  # what the collector finds, and when
        gone = []
        class Job(Thing):
            def __del__(self): gone.append(self.n)
        for k in range(900): Job(k)
        tell((len(gone), gc.get_count(), gone[-3:]))

    def packed():  # a time stamp within, and a sum of floats
        tell((gzip.compress(b"state")[4:8], statistics.NormalDist(0, 1).samples(1)[0]))

    def awaited():  # a set of tasks
        async def job(n): await asyncio.sleep(0.01); return n
        async def main():
            done, _ = await asyncio.wait([asyncio.create_task(job(n)) for n in range(7)])
            return [each.result() for each in done]
        tell(asyncio.run(main()))

    def dated():  # clocks and zones, through libraries
        base = sqlite3.connect(":memory:")
        now = datetime.now()
        tell((pickle.loads(pickle.dumps(now)).isoformat(), time.ctime(), time.tzname,
              base.execute("select datetime('now', 'localtime')").fetchone()))

    def stored():  # files, their times and names
        with tempfile.NamedTemporaryFile() as file: tell((file.name, os.stat(file.name).st_mtime, os.getcwd()))
        tell((sorted(os.environ), os.umask(0o22), os.cpu_count(), os.getloadavg(), time.process_time() >= 0))

    def threads():  # who is first
        found = []
        def work(n):
            for _ in range(3): found.append(n); time.sleep(0)
        with ThreadPoolExecutor(3) as pool:
            for each in as_completed([pool.submit(work, n) for n in range(6)]): each.result()
        tell(found)

    def children():  # numbers of processes, and chance in them
        code = "import os, random; print(os.getpid(), os.getppid(), random.random(), {'a', 'b', 'c'})"
        tell(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout)

    for _ in range(3):
        (addresses, collected, packed, awaited, dated, stored, threads, children)[me - 1]()
        time.sleep(random.random() / 10)
"""
_base: dict[str, Any] = {}


@pytest.fixture(autouse=True)
def first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Result:
    """The run that all others are compared with; made once, since each way makes one, too."""
    place = tmp_path.parent / "programs"  # the same path each time: a program sees where it lies
    place.mkdir(exist_ok=True)
    monkeypatch.chdir(place)
    (place / "program.py").write_text(dedent(PROGRAM))
    (place / "own.yaml").write_text(scenario(vehicles=8))
    if not _base:
        result = fleet.run("own.yaml", out=tmp_path / "runs")
        _base.update(result=result, lines=[lines(result, i) for i in range(1, 9)])
    assert all(said[-1] == "end: exit status 0" for said in _base["lines"]), _base["lines"]
    base: Result = _base["result"]
    return base


def same(result: Result) -> None:
    assert [lines(result, i) for i in range(1, 9)] == _base["lines"]
    assert result.digest == _base["result"].digest


@pytest.mark.parametrize("way", ["distributed", "hosted", "verify"])
def test_in_each_way_of_running(way: str, tmp_path: Path) -> None:
    if way == "verify":
        result = fleet.run("own.yaml", out=tmp_path / "runs")
        same(result)
        assert result.directory is not None and verify(result.directory).reproduced
        return
    loaded = load_scenario("own.yaml", ["agents.per_process=3"] if way == "hosted" else [])
    result = execute(loaded, Options(tmp_path / "runs", quiet=True))
    if way == "distributed":
        same(result)
    assert way == "distributed" or result.status == _base["result"].status


@pytest.mark.parametrize(
    "variables",
    [
        {"PYTHONHASHSEED": "7", "LANG": "de_DE.UTF-8", "LC_ALL": "C", "TZ": "Asia/Tokyo"},
        {"TMPDIR": "", "HOME": "/nonexistent", "PYTHONPATH": "/nonexistent", "PYTHONDONTWRITEBYTECODE": ""},
        {"OMP_NUM_THREADS": "3", "LD_BIND_NOW": "1", "MALLOC_ARENA_MAX": "1", "SOURCE_DATE_EPOCH": "0"},
    ],
)
def test_in_each_environment(
    variables: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(Path.home() / ".cache"))
    for name, value in variables.items():
        monkeypatch.setenv(name, value or str(tmp_path_factory.mktemp("other")))
    same(fleet.run("own.yaml", out=tmp_path / "runs"))


@pytest.mark.slow
def test_beside_other_work(tmp_path: Path) -> None:
    busy = [subprocess.Popen(["sh", "-c", "while :; do :; done"]) for _ in range(4)]
    try:
        same(fleet.run("own.yaml", out=tmp_path / "runs"))
    finally:
        for each in busy:
            each.kill()
            each.wait()


@pytest.mark.parametrize(
    "workers", [pytest.param(1, marks=pytest.mark.slow), 2, pytest.param(8, marks=pytest.mark.slow)]
)
def test_with_each_number_of_workers(workers: int, tmp_path: Path) -> None:
    done = invoke(
        "sweep", "own.yaml", "--seeds", "1..2", "--workers", workers, "--keep-logs", "all", "--out", tmp_path / "study"
    )
    assert done.exit_code == 0, done.output
    digests = [json.loads(path.read_text())["digest"] for path in sorted((tmp_path / "study").rglob("result.json"))]
    assert len(digests) == 2 and _base["result"].digest in digests
    assert _base.setdefault("sweep", digests) == digests


def test_a_run_that_goes_on_from_a_moment(first: Result, tmp_path: Path) -> None:
    """The programs run again from their beginning; nothing of them differs."""
    result = fleet.run("own.yaml", out=tmp_path / "runs")
    assert result.directory is not None
    done = invoke("run", "--from", f"{result.directory}@1s", "-q", "--out", tmp_path / "again")
    assert done.exit_code == 0, done.output
    again = json.loads((next((tmp_path / "again").glob("*/result.json"))).read_text())
    assert again["status"] == "pass"
