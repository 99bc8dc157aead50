"""Programs that do what is hard to emulate, or what they must not do: as on Linux, or refused; nothing gets out."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import pytest
from own_program import RunProgram, lines, scenario

import fleet
from fleet.addons.programs import processes
from fleet.result.result import Result, Status

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")


@pytest.fixture
def real(run: RunProgram) -> Callable[..., Result]:
    """Runs a program as real processes."""
    return lambda text, **changes: run(text, process="yes", **changes)


def test_calls_that_are_hard_to_emulate_are_as_on_linux(tmp_path: Path, run: RunProgram) -> None:
    source = Path(__file__).parent / "hard_calls.c"
    subprocess.run(["cc", "-O1", "-w", "-pthread", "-o", str(tmp_path / "hard"), str(source)], check=True)
    (tmp_path / "own.yaml").write_text(scenario().replace("program.py", "hard").replace("vehicles: 2", "vehicles: 1"))
    result = fleet.run("own.yaml", out=tmp_path / "runs")
    held = ["held by a child: Success", "held by a thread that ended: Owner died"]
    assert lines(result) == [
        "queued 3: 5 6 7",
        "signalfd failed 0 times",
        "wrong end -1, broken pipe -1 Broken pipe",
        "ignored in a child: 7",
        *held,
        *held,
        "at another address: 0",
        "cancelled: 1",
        "threads, one after the other: 25000",
        "no such program: No such file or directory",
        "vfork: 2",
        "killed: 1",
        "stack overflow: 2",
        "wrong time: -1 1, clock -1",
        "at most 1024 files: 1 Too many open files",
        "the channel: -1 -1 -1",
        "untrapped: -1",
        "end: exit status 0",
    ]


def test_no_link_leads_out_of_a_home(real: Callable[..., Result], tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("outside")
    (outside / "file").write_text("kept")
    result = real(
        f"""
        import os, socket, sys
        outside = {str(outside)!r}
        os.symlink(outside, "folder"); os.symlink(outside + "/file", "file"); os.symlink(outside + "/new", "new")
        os.symlink("/", "root"); open("own", "w").close(); os.symlink("own", "link"); os.symlink("/tmp/x", "absolute")
        there = os.open("folder/file", os.O_RDONLY)
        def attempt(number, what, *arguments, **others):
            try: what(*arguments, **others)
            except OSError: pass
            else: print("done", number)
        attempt(1, open, "folder/a", "w"); attempt(2, open, "file", "a"); attempt(3, open, "new", "w")
        attempt(4, os.mkdir, "folder/b"); attempt(5, os.remove, "folder/file"); attempt(6, os.truncate, "file", 0)
        attempt(7, os.chmod, "file", 0o777); attempt(8, os.link, "folder/../folder/file", "hard")
        attempt(9, os.link, "folder/file", "hard"); attempt(10, os.rename, "folder/file", "stolen")
        attempt(11, open, f"/proc/self/fd/{{there}}", "w"); attempt(12, os.fchmod, there, 0o777)
        attempt(13, open, f"/proc/self/root{{outside}}/c", "w"); attempt(14, open, f"root{{outside}}/d", "w")
        attempt(15, open, "/home/auv/../.." + outside + "/e", "w"); attempt(16, os.utime, "file", (1, 1))
        attempt(17, os.utime, there, (1, 1)); attempt(18, os.symlink, "x", "folder/f")
        attempt(19, socket.socket(socket.AF_UNIX).bind, outside + "/g")
        attempt(20, open, f"/proc/1/root{{outside}}/h", "w")
        attempt(21, os.mknod, "device", 0o600 | 0o60000, 0x800); attempt(22, open, "/dev/kmsg", "w")
        folder = os.open(outside, os.O_RDONLY)
        attempt(23, os.open, "../i", os.O_CREAT | os.O_WRONLY, dir_fd=folder); os.fchdir(folder)
        attempt(24, open, "j", "w"); os.chdir("/home/auv")
        print(os.readlink("link"), os.readlink("absolute"), open("link").read() == "", os.readlink("folder") == outside)
        s = socket.socket(socket.AF_UNIX); s.bind("/tmp/socket"); print(s.getsockname())
        s = socket.socket(socket.AF_UNIX); s.bind(b"\\0name"); print(s.getsockname())
        """,
        arguments=f'["{outside}"]',  # what a program is told of it can see
    )
    assert result.status is Status.PASS, lines(result)
    said = lines(result)
    assert said[:3] == ["own /tmp/x True True", "/tmp/socket", "b'\\x00name'"] and said[-1] == "end: exit status 0"
    assert "/dev/kmsg is a device of the machine, which is refused" in said[3] and len(said) == 5
    assert [path.name for path in outside.iterdir()] == ["file"] and (outside / "file").read_text() == "kept"
    assert (outside / "file").stat().st_mtime > 1 and not (outside / "file").stat().st_mode & 0o111


def test_a_pipe_with_a_name_waits_for_its_other_end(real: Callable[..., Result]) -> None:
    result = real("""
        import subprocess
        script = "mkfifo p; (sleep 0.2; echo hello > p) & cat p; cat p & echo again > p; wait"
        print(subprocess.run(["sh", "-c", script], capture_output=True, text=True).stdout.split())
    """)
    assert lines(result)[0] == "['hello', 'again']"


FORKS = """
    import hashlib, os, signal, socket, socketserver, threading, time
    data = b"".join(hashlib.sha256(b"%d" % k).digest() for k in range(30000))
    def rest(s): return b"".join(iter(lambda: s.recv(65536), b""))
    # A server that forks for each client, another one for datagrams, and one that has forked before.
    class Stream(socketserver.StreamRequestHandler):
        def handle(self): self.wfile.write(self.rfile.readline().upper())
    class Datagram(socketserver.BaseRequestHandler):
        def handle(self): self.request[1].sendto(self.request[0].upper(), self.client_address)
    one = socketserver.ForkingTCPServer(("127.0.0.1", 7000), Stream)
    two = socketserver.ForkingUDPServer(("127.0.0.1", 7000), Datagram)
    for each in (one, two): threading.Thread(target=each.serve_forever, daemon=True).start()
    for _ in range(2):
        with socket.create_connection(("127.0.0.1", 7000)) as s: s.sendall(b"line\\n"); print(rest(s))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            s.sendto(b"packet", ("127.0.0.1", 7000)); print(s.recv(100))
    for each in (one, two): each.shutdown(); each.server_close()
    server = socket.create_server(("127.0.0.1", 7001))
    for k in range(2):
        if os.fork() == 0:
            with server.accept()[0] as s: s.sendall(s.recv(9) + b" by a child")
            os._exit(0)
    time.sleep(0.1)
    for _ in range(2):
        with socket.create_connection(("127.0.0.1", 7001)) as s: s.sendall(b"served"); print(rest(s))
    # A daemon: who has opened the sockets ends, and with that who put into them what came.
    packets = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); packets.bind(("127.0.0.1", 7002))
    if os.fork() == 0:
        time.sleep(0.1)
        s = socket.create_connection(("127.0.0.1", 7001)); s.sendall(data); s.shutdown(socket.SHUT_WR); print(rest(s))
        packets.sendto(b"the last", ("127.0.0.1", 7002))
        os._exit(0)
    stream, _ = server.accept()
    first = stream.recv(1000)
    time.sleep(0.1)
    if os.fork(): os._exit(0)
    print(first + rest(stream) == data, flush=True); stream.sendall(b"thanks"); stream.close(); print(packets.recv(100))
"""


def test_sockets_outlive_those_who_have_opened_them(real: Callable[..., Result]) -> None:
    result = real(FORKS)
    assert result.status is Status.PASS, lines(result)
    said = 2 * ["b'LINE\\n'", "b'PACKET'"] + 2 * ["b'served by a child'"]
    assert lines(result) == [*said, "True", "b'thanks'", "b'the last'", "end: exit status 0"]
    assert real(FORKS).digest == result.digest


def test_processes_that_wake_each_other_often_take_time(
    real: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = """
        import os, time
        ours, theirs = os.pipe(), os.pipe()
        if os.fork() == 0:
            while os.read(ours[0], 1): os.write(theirs[1], b"x")
        for k in range(COUNT): os.write(ours[1], b"x"); os.read(theirs[0], 1)
        print(time.monotonic() - 1000); os._exit(0)
    """
    monkeypatch.setattr(processes, "MOST_TURNS", 100)
    assert 0 < float(lines(real(text.replace("COUNT", "300")))[0]) < 0.2
    monkeypatch.setattr(processes, "MOST_FULL", 10)
    assert "wake each other without an end" in lines(real(text.replace("COUNT", "10**9")))[-1]


def test_a_pipe_of_a_grandchild_that_ends_has_its_end(real: Callable[..., Result]) -> None:
    result = real("""
        import subprocess
        for _ in range(30):
            made = subprocess.Popen(["sh", "-c", "sh -c 'sleep 0.01; echo last' & exit 3"], stdout=-1)
            assert made.wait() == 3 and made.stdout.read() == b"last\\n"
        print("read")
    """)
    assert lines(result) == ["read", "end: exit status 0"]


def test_memory_has_a_limit(real: Callable[..., Result], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "MEMORY_MB", 100)
    result = real("kept = []\nwhile True: kept.append(bytes([1]) * 1_000_000)", vehicles=1)
    assert result.status is Status.CHECK_FAILED
    assert lines(result)[-1].endswith("MiB of memory; 100 MiB are the most of an agent")
    result = real("""
        import signal
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        with open("large", "wb") as file:
            while True: file.write(bytes(1_000_000))
    """)
    assert "a file of it has more than 100 MiB" in lines(result)[-1]


OWNER = """
    import sys
    from fleet.addons.programs.processes import Processes
    text = "import os, time\\nprint(os.fork())\\nwhile True: pass"
    made = Processes([sys.executable, "-c", text, "lonely-987651"], {}, [], agent=1, agents=1, seed=1, tick_ns=10**7,
        now_ns=0, told=lambda *_: None)
    print("began", flush=True)
    made.begin()
"""


def test_nothing_is_left_of_an_owner_that_is_killed(tmp_path: Path) -> None:
    owner = subprocess.Popen([sys.executable, "-c", dedent(OWNER)], stdout=subprocess.PIPE, cwd=tmp_path)
    assert owner.stdout is not None and owner.stdout.readline() == b"began\n"
    time.sleep(0.5)
    owner.send_signal(signal.SIGKILL)
    owner.wait()
    owner.stdout.close()
    deadline = time.monotonic() + 5
    while left() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not left()


def left() -> list[str]:
    """Processes of the test's program."""
    found = []
    for pid in filter(str.isdecimal, os.listdir("/proc")):
        try:
            found.append(Path(f"/proc/{pid}/cmdline").read_text("utf-8"))
        except OSError:
            continue
    return [text for text in found if "lonely-987651" in text and "Processes" not in text]
