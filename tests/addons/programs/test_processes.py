"""Programs that are real processes in simulated time: the same as on the host, the same bytes each time, no escape."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
from own_program import RunProgram, lines, scenario

import fleet
from agents.make_agent import make_agent
from fleet.addons.programs import processes
from fleet.addons.programs.executables import obstacle
from fleet.errors import FleetError
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.repeat.verify import verify
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario
from netem.wire.messages import Nav

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")


@pytest.fixture
def real(run: RunProgram) -> Callable[..., Result]:
    """Runs a program as real processes."""
    return lambda text, **changes: run(text, **changes)


def ending(result: Result, agent: int = 1) -> str:
    """How a program has ended."""
    return lines(result, agent)[-1]


STORY = """
    import asyncio, concurrent.futures, multiprocessing, os, queue, select, signal, socket, subprocess, sys, threading
    import time
    begin = time.monotonic()
    def tell(*words): print(*words, round(time.monotonic() - begin, 1), flush=True)
    def square(v):
        time.sleep(0.1)
        return v * v
    if __name__ == "__main__":
        found, event, condition, barrier = queue.Queue(), threading.Event(), threading.Condition(), threading.Barrier(2)
        def work(n):
            for _ in range(2):
                time.sleep(0.1 * n)
                found.put(n)
        workers = [threading.Thread(target=work, args=(n,)) for n in (1, 3)]
        for each in workers: each.start()
        for each in workers: each.join()
        tell("threads", [found.get() for _ in range(4)])
        try: found.get(timeout=0.1)
        except queue.Empty: tell("empty")
        threading.Timer(0.2, event.set).start()
        tell("event", event.wait(1))
        with condition: tell("condition", condition.wait(0.1))
        threading.Thread(target=barrier.wait).start()
        tell("barrier", barrier.wait() in (0, 1))
        lock = threading.RLock()
        with lock, lock: tell("lock", lock.acquire(timeout=0.1))
        with concurrent.futures.ThreadPoolExecutor(2) as pool: tell("pool", [*pool.map(square, range(4))])
        with multiprocessing.get_context("fork").Pool(2) as pool: tell("processes", pool.map(square, [1, 2]))
        script = "read x; sleep 0.2; echo got $x; exit 3"
        tell("child", subprocess.run(["sh", "-c", script], input=b"a", capture_output=True))
        tell("large", len(subprocess.run(["cat"], input=bytes(300_000), capture_output=True).stdout))
        child = subprocess.Popen(["sleep", "9"])
        child.terminate()
        tell("ended", child.wait())
        signal.signal(signal.SIGALRM, lambda *_: tell("alarm"))
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        time.sleep(0.3)
        one, other = socket.socketpair()
        reader, writer = os.pipe()
        threading.Timer(0.1, lambda: (os.write(writer, b"x"), other.sendall(b"y"))).start()
        tell("select", len(select.select([reader], [], [], 1)[0]), one.recv(1), os.read(reader, 1))
        tell("nothing", select.select([reader], [], [], 0.1))
        datagrams = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        datagrams.bind(("127.0.0.1", 0))
        datagrams.sendto(b"self", datagrams.getsockname())
        tell("datagram", datagrams.recvfrom(100)[0])
        closed = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        closed.connect(("127.0.0.1", 9))
        closed.send(b"x")
        try: closed.recv(1)
        except ConnectionRefusedError: tell("refused")
        try: socket.create_connection(("127.0.0.1", 9))
        except ConnectionRefusedError: tell("refused")
        server = socket.create_server(("127.0.0.1", 0))
        client = socket.create_connection(server.getsockname())
        served, _ = server.accept()
        client.sendall(bytes(100_000))
        client.shutdown(socket.SHUT_WR)
        tell("stream", sum(len(part) for part in iter(lambda: served.recv(65536), b"")))
        served.sendall(b"answer")
        served.close()
        tell("answer", client.recv(100), client.recv(100))
        async def echo(reader, writer):
            writer.write(await reader.readline())
            await writer.drain()
            writer.close()
        async def main():
            server = await asyncio.start_server(echo, "127.0.0.1", 0)
            reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
            writer.write(b"line\\n")
            tell("asyncio", await reader.read(), await asyncio.gather(*(asyncio.sleep(0.1, k) for k in range(3))))
            process = await asyncio.create_subprocess_exec("echo", "hello", stdout=-1)
            tell("async child", (await process.communicate())[0])
            try: await asyncio.wait_for(asyncio.sleep(9), 0.1)
            except TimeoutError: tell("timeout")
            server.close()
        asyncio.run(main())
        with open("own.txt", "w") as file: file.write("kept")
        tell(open("own.txt").read(), os.path.exists("own.txt"), sys.argv[1:])
"""


def test_a_program_prints_what_it_prints_on_the_host_in_real_time(run: RunProgram, tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(dedent(STORY))
    (tmp_path / "own.yaml").write_text(scenario())
    result = fleet.run("own.yaml", out=tmp_path / "runs", set={"duration": "9 s"})
    folder = tmp_path / "host"
    folder.mkdir()
    told = subprocess.run(
        [sys.executable, str(tmp_path / "program.py"), "1"], cwd=folder, capture_output=True, text=True, timeout=60
    )
    assert told.returncode == 0, told.stderr
    assert [*map(without_times, lines(result)[:-1])] == [*map(without_times, told.stdout.splitlines())]
    assert ending(result) == "end: exit status 0"
    simulated, host = (
        [float(line.rpartition(" ")[2]) for line in text] for text in (lines(result)[:-1], told.stdout.splitlines())
    )
    # A host that is busy is late and never early.
    assert all(one <= other + 0.15 for one, other in zip(simulated, host, strict=True))


def without_times(line: str) -> str:
    return line.rpartition(" ")[0]


CHANCE = """
    import hashlib, os, random, secrets, socket, sys, time, uuid
    class Thing: pass
    things = {Thing() for _ in range(50)}
    print([hash(each) % 97 for each in things], {"a", "b", "c"}, id(things), hash("text"))
    print(random.random(), os.urandom(4), secrets.token_hex(4), uuid.uuid1(), uuid.uuid4(), os.getpid(), time.time())
    print(socket.gethostname(), time.ctime(), os.getcwd(), os.environ["HOME"], os.cpu_count(), sys.argv)
    print(open("/dev/urandom", "rb").read(4), open("/proc/sys/kernel/random/uuid").read(), socket.if_nameindex())
    open("/tmp/here", "w").write("x"); print(os.stat("/tmp/here").st_mtime, os.stat("/tmp/here").st_size)
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("", 5000)); s.settimeout(0.05)
    me = int(sys.argv[1])
    for k in range(20):
        s.sendto(random.randbytes(9), ("auv%d" % (3 - me), 5000))
        try: print(s.recvfrom(100), time.monotonic())
        except TimeoutError: pass
"""


def test_the_bytes_are_those_of_the_seed(
    real: Callable[..., Result],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    first = real(CHANCE)
    assert first.status is Status.PASS, (first.reason, lines(first))
    elsewhere = tmp_path_factory.mktemp("elsewhere")  # not where Python lists the names, which are in its memory then
    for name, value in (("TMPDIR", str(elsewhere)), ("TZ", "Asia/Tokyo"), ("LANG", "C"), ("PYTHONHASHSEED", "7")):
        monkeypatch.setenv(name, value)
    assert real(CHANCE).digest == first.digest
    distributed = execute(load_scenario("own.yaml"), Options(tmp_path / "runs", quiet=True))
    assert distributed.digest == first.digest and lines(distributed) == lines(first)
    assert verify(distributed.directory).reproduced
    assert fleet.run("own.yaml", seed=2, out=tmp_path / "runs").digest != first.digest
    assert lines(first)[1] != lines(first, 2)[1], "two agents have the same chance"


def test_how_a_program_ends_is_judged(real: Callable[..., Result], monkeypatch: pytest.MonkeyPatch) -> None:
    def found(text: str) -> str:
        result = real(text)
        assert result.status is Status.CHECK_FAILED, (result.reason, result.lines)
        return next(check.found for check in result.checks if check.check == "programs")

    assert "ValueError: planned" in found("import time; time.sleep(1); raise ValueError('planned')")
    assert "exit status 3" in found("import sys; sys.exit(3)")
    assert "signal 9" in found("import os; os.kill(os.getpid(), 9)")
    text = found("import threading; lock = threading.Lock(); lock.acquire(); lock.acquire()")
    assert "deadlock: no thread can ever run" in text
    text = found("import os; r, w = os.pipe(); os.read(r, 1)")
    assert "deadlock" in text
    monkeypatch.setattr(processes, "CPU_S", 0.3)
    assert "computed for 0.3 s and did not wait" in found("while True: pass")


def test_waiting_for_the_network_is_no_deadlock_and_a_busy_loop_takes_time(
    real: Callable[..., Result],
) -> None:
    result = real("""
        import socket, time
        begin = time.monotonic()
        while time.monotonic() < begin + 0.1: pass
        print("went on", round(time.monotonic() - begin, 1))
        s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("", 5000)); s.setblocking(False)
        while time.monotonic() < begin + 0.3:
            try: s.recv(1)
            except BlockingIOError: pass
        print("polled", round(time.monotonic() - begin, 1))
        s.setblocking(True); s.recv(1)
    """)
    assert result.status is Status.PASS
    assert lines(result) == ["went on 0.1", "polled 0.3"]


def test_datagrams_go_where_they_are_sent(real: Callable[..., Result]) -> None:
    result = real("""
        import socket, struct, sys, time
        me = int(sys.argv[1])
        def open_(port):
            s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("", port)); s.settimeout(1)
            return s
        plain, group = open_(5000), open_(5001)
        group.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton("239.1.1.1") + bytes(4))
        six = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM); six.bind(("::", 5002)); six.settimeout(1)
        time.sleep(0.1)
        if me == 1:
            try: plain.sendto(b"x", ("10.0.0.255", 5000))
            except PermissionError: print("broadcast is to be asked for")
            plain.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            plain.sendto(b"to all", ("10.0.0.255", 5000))
            group.sendto(b"to the group", ("239.1.1.1", 5001))
            six.sendto(b"by six", ("fd00::2", 5002))
            plain.sendto(bytes(60_000), ("10.0.0.2", 5000))
            try: plain.sendto(b"x", ("192.0.2.1", 5000))
            except OSError as error: print(error)
            print(plain.recvfrom(100), group.recvfrom(100))
        else:
            print(plain.recvfrom(100), group.recvfrom(100), six.recvfrom(100)[:1], six.getsockname()[:2])
            print(len(plain.recv(65536)))
            print(socket.gethostbyname("auv1"), socket.getaddrinfo("auv-1", 80)[0][4])
    """)
    assert result.status is Status.PASS, lines(result)
    one, two = lines(result), lines(result, 2)
    assert one[0] == "broadcast is to be asked for" and "192.0.2.1 port 5000 is not in the water" in "".join(one)
    assert "[Errno 101] Network is unreachable" in one
    assert "(b'to all', ('10.0.0.1', 5000)) (b'to the group', ('10.0.0.1', 5001))" in one
    assert two[0].startswith("(b'to all', ('10.0.0.1', 5000)) (b'to the group', ('10.0.0.1', 5001)) (b'by six',)")
    assert two[1:3] == ["60000", "10.0.0.1 ('10.0.0.1', 80)"]


def test_a_shutdown_wakes_who_waits_at_a_socket_that_is_not_connected(real: Callable[..., Result]) -> None:
    text = """
        import socket, threading, time
        s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        s.bind(("", 5000))
        waiting = threading.Thread(target=lambda: print("woken with", s.recv(99), time.monotonic() - begin))
        begin = time.monotonic()
        waiting.start()
        time.sleep(0.5)
        try: s.shutdown(socket.SHUT_RDWR)
        except OSError as error: print(error.strerror)
        waiting.join()
    """
    told = "Transport endpoint is not connected", "woken with b'' 0.5", "end: exit status 0"
    assert lines(real(text)) == [*told]


def test_the_processes_of_an_agent_share_its_ports(real: Callable[..., Result]) -> None:
    text = """
        import os, socket, sys, time
        def bound(port, kind=socket.SOCK_DGRAM, reuses=0):
            s = socket.socket(socket.AF_INET, kind)
            if reuses: s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            try: s.bind(("", port))
            except OSError as error: return print("child" if child else "parent", port, error.strerror)
            s.settimeout(0.2)
            return s
        child = 0
        mine, server, shared, free = bound(7410), bound(80, socket.SOCK_STREAM), bound(90, reuses=1), bound(0)
        server.listen()
        child = not os.fork()
        if child:
            assert bound(7410) is None and bound(80, socket.SOCK_STREAM) is None
            other, again, also = bound(7412), bound(90, reuses=1), bound(0)
            print("free ports", also.getsockname()[1] - free.getsockname()[1])
            other.sendto(b"to the parent", ("127.0.0.1", 7410))
            print("child", other.recv(99))
            sys.exit()
        print("parent", mine.recv(99))
        bound(7412)
        mine.sendto(b"to the child", ("127.0.0.1", 7412))
        os.wait()
        print("parent", bound(7412).getsockname()[1])
    """
    in_use = "child 7410 Address already in use", "child 80 Address already in use"
    talk = "free ports 1", "parent b'to the parent'", "parent 7412 Address already in use", "child b'to the child'"
    assert lines(real(text)) == [*in_use, *talk, "parent 7412", "end: exit status 0"]


def test_streams_are_whole_over_links_that_lose(real: Callable[..., Result], tmp_path: Path) -> None:
    text = """
        import hashlib, socket, sys, time
        data = b"".join(hashlib.sha256(b"%d" % k).digest() for k in range(3000))
        if sys.argv[1] == "1":
            server = socket.create_server(("", 5000))
            client, address = server.accept()
            got = b"".join(iter(lambda: client.recv(65536), b""))
            print(address[0], got == data)
            client.sendall(b"thanks"); client.close()
        else:
            try: socket.create_connection(("10.0.0.1", 9))
            except ConnectionRefusedError: print("refused")
            s = socket.create_connection(("10.0.0.1", 5000))
            s.sendall(data); s.shutdown(socket.SHUT_WR)
            print(s.recv(100), s.recv(100))
    """
    (tmp_path / "program.py").write_text(dedent(text))
    (tmp_path / "own.yaml").write_text(scenario())
    changes = {"duration": "120 s", "network.links.*": "delay 20ms 10ms loss 20%"}
    result = fleet.run("own.yaml", out=tmp_path / "runs", set=changes)
    assert result.status is Status.PASS, lines(result, 2)
    assert lines(result) == ["10.0.0.2 True", "end: exit status 0"]
    assert lines(result, 2) == ["refused", "b'thanks' b''", "end: exit status 0"]


def test_an_agent_has_files_of_its_own(real: Callable[..., Result], tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "map.txt").write_text("deep")
    result = real(
        """
        import os, sys
        own = ("own", "/tmp/own", "/dev/shm/own", "data/new")
        print([os.path.exists(name) for name in own], open("data/map.txt").read())
        for name in own: open(name, "w").close()
        for name in (__file__, "/etc/new", sys.prefix + "/new"):
            try: open(name, "a")
            except OSError as error: print(error.strerror)
        print(os.getcwd(), os.path.realpath("own"), os.path.abspath("../up"))
        """,
        files="[data]",
    )
    assert result.status is Status.PASS, lines(result)
    for agent in (1, 2):
        said = lines(result, agent)
        assert said[0] == "[False, False, False, False] deep" and said[1:4] == 3 * ["Read-only file system"]
        assert said[4] == "/home/auv /home/auv/own /home/up"
    assert sorted(path.name for path in (tmp_path / "data").iterdir()) == ["map.txt"]


def test_signals_are_read_from_both_outputs(real: Callable[..., Result], tmp_path: Path) -> None:
    real("import sys, time; print('3 v', file=sys.stderr); time.sleep(9)")
    checks = {"checks": {"signal": {"name": "a-line", "topic": "control.v", "above": 2.5, "after": "1 s"}}}
    assert fleet.run("own.yaml", out=tmp_path / "runs", set=checks).status is Status.PASS


def test_a_file_of_the_shell_is_read_first(real: Callable[..., Result], tmp_path: Path) -> None:
    (tmp_path / "setup.bash").write_text("export DEPTH=$((30 + $#)) FOLDER=$(dirname ${BASH_SOURCE[0]})")
    text = f"import os, sys; print(os.environ['DEPTH'], os.environ['FOLDER'] == '{tmp_path}', sys.argv[1:])"
    assert lines(real(text, setup="setup.bash"))[0] == "30 True ['1']"
    with pytest.raises(FleetError, match="there is no file"):
        real(text, setup="nothing.bash")


def test_an_interpreter_may_lie_beside_the_program(real: Callable[..., Result], tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "python").symlink_to(sys.executable)
    text = "import sys; print(sys.orig_argv[0])"
    assert lines(real(text, interpreter="own/python"))[0] == str(tmp_path / "own" / "python")


def test_it_sees_as_many_processors_as_the_scenario_says(real: Callable[..., Result]) -> None:
    text = "import os; print(os.cpu_count(), len(os.sched_getaffinity(0)))"
    assert lines(real(text))[0] == "4 4"
    assert lines(real(text, processors="1"))[0] == "1 1"


def test_a_kill_is_one_and_the_program_begins_anew(real: Callable[..., Result], tmp_path: Path) -> None:
    text = """
        import atexit, sys, time
        atexit.register(print, "never printed by a kill")
        try:
            while True:
                print("lives", round(time.monotonic() - 1000, 1)); time.sleep(0.5)
        finally: print("never")
    """
    (tmp_path / "program.py").write_text(dedent(text))
    (tmp_path / "own.yaml").write_text(scenario())
    result = fleet.run("own.yaml", out=tmp_path / "runs", fault=["at 1.2s for 1s kill 1"])
    assert lines(result) == ["lives 0.0", "lives 0.5", "lives 1.0", "lives 2.2", "lives 2.7"]
    assert len(lines(result, 2)) == 6


def test_a_disk_outlives_a_kill_and_no_run(real: Callable[..., Result], tmp_path: Path) -> None:
    text = """
        import os, pathlib, sys, time
        count = pathlib.Path("count.txt")
        lives = len(count.read_text()) if count.exists() else 0
        count.write_text("x" * (lives + 1))
        print(lives, open("data.txt").read(), os.listdir("/tmp"), os.listdir("/dev/shm"))
        open("data.txt", "a").write(" more"), open("/tmp/a", "w"), open("/dev/shm/a", "w")
        os.mkfifo("pipe") if not lives else None
        time.sleep(99)
    """
    (tmp_path / "data.txt").write_text("data")
    (tmp_path / "program.py").write_text(dedent(text))
    (tmp_path / "own.yaml").write_text(scenario(files="[data.txt]"))
    faults = ["at 1s for 200ms kill 1", "at 2s for 200ms kill 1"]
    result = fleet.run("own.yaml", out=tmp_path / "runs", fault=faults)
    assert lines(result) == ["0 data [] []", "1 data more [] []", "2 data more more [] []"]
    assert lines(result, 2) == ["0 data [] []"] and (tmp_path / "data.txt").read_text() == "data"
    changed = [f"faults=[{{{', '.join(('at: 1 s', 'for: 200 ms', 'kill: 1'))}}}, {{at: 2 s, for: 200 ms, kill: 1}}]"]
    distributed = execute(load_scenario("own.yaml", changed), Options(tmp_path / "runs", quiet=True))
    assert distributed.digest == fleet.run("own.yaml", set=changed).digest
    assert lines(distributed) == lines(result)
    assert not [*Path(tempfile.gettempdir()).glob("uuv-fleet-kept-*/agent-1/home/count.txt")]


def test_nothing_is_left_when_runs_are_over(real: Callable[..., Result], tmp_path: Path) -> None:
    real("import subprocess, time; subprocess.Popen(['sleep', '987654']); time.sleep(99)")
    commands = [Path(f"/proc/{pid}/cmdline") for pid in os.listdir("/proc") if pid.isdecimal()]
    assert not [path for path in commands if path.exists() and b"987654" in path.read_bytes()]


def test_calls_that_do_not_come_from_the_c_library_are_answered(tmp_path: Path, run: RunProgram) -> None:
    source = Path(__file__).parent / "raw_calls.c"
    subprocess.run(["cc", "-O1", "-o", str(tmp_path / "raw"), str(source)], check=True)
    text = scenario().replace("program.py", "raw")
    (tmp_path / "own.yaml").write_text(text)
    result = fleet.run("own.yaml", out=tmp_path / "runs")
    assert result.status is Status.PASS, lines(result)
    said = lines(result)
    assert said[:2] == ["1767225600 0", "slept 500 ms"] and re.fullmatch("chance [0-9a-f]{8}", said[2])
    assert said[2] != lines(result, 2)[2] and "io_uring -38, raw socket -1" in said
    again = fleet.run("own.yaml", out=tmp_path / "runs")
    assert again.digest == result.digest
    (tmp_path / "own.yaml").write_text(text.replace('["{id}"]', '["{id}", reboot]'))
    refused = fleet.run("own.yaml", out=tmp_path / "runs")
    found = next(check.found for check in refused.checks if check.check == "programs")
    assert "system call 169 is not emulated in simulated time" in found


def test_what_libraries_do_at_their_beginning_is_in_simulated_time(tmp_path: Path, run: RunProgram) -> None:
    (tmp_path / "library.c").write_text("""
        #define _GNU_SOURCE
        #include <sched.h>
        #include <stdio.h>
        #include <time.h>
        __attribute__((constructor)) static void begin(void) {
            cpu_set_t set;
            sched_getaffinity(0, sizeof set, &set);
            printf("%ld with %d\\n", (long)time(0), CPU_COUNT(&set));
        }
    """)
    (tmp_path / "main.c").write_text("int main(void) { return 0; }")
    built = ["cc", "-shared", "-fPIC", "-o", "libown.so", "library.c"]
    linked = ["cc", "-Wl,--no-as-needed", "-o", "begun", "main.c", "-L.", "-lown", f"-Wl,-rpath,{tmp_path}"]
    for command in (built, linked):
        subprocess.run(command, check=True, cwd=tmp_path)
    (tmp_path / "own.yaml").write_text(scenario(processors="3").replace("program.py", "begun"))
    result = fleet.run("own.yaml", out=tmp_path / "runs")
    assert lines(result) == ["1767225600 with 3", "end: exit status 0"]


def test_what_cannot_be_preloaded_is_refused_before_the_run(tmp_path: Path, run: RunProgram) -> None:
    (tmp_path / "static.c").write_text("int main() { return 0; }")
    subprocess.run(["cc", "-static", "-o", str(tmp_path / "static"), str(tmp_path / "static.c")], check=True)
    assert "is a static program" in obstacle(tmp_path / "static")
    assert obstacle(sys.executable) == "" and obstacle("sh") == ""
    (tmp_path / "script").write_text(f"#!{tmp_path}/static\n")
    assert "is a static program" in obstacle(tmp_path / "script")
    (tmp_path / "own.yaml").write_text(scenario().replace("program.py", "static"))
    with pytest.raises(FleetError, match="is a static program"):
        fleet.run("own.yaml", out=tmp_path / "runs")
    result = run("import subprocess; subprocess.run(['./static'])", files="[static]")
    assert "PermissionError" in "".join(lines(result)) and "is a static program" in "".join(lines(result))


def test_a_copy_of_an_agent_starts_its_program_again(tmp_path: Path, run: RunProgram) -> None:
    run("import random, time\nwhile True: print(random.random()); time.sleep(0.1)")
    agent = make_agent(load_scenario("own.yaml").agent_config(1))
    program: Any = agent

    def texts(first: int, last: int) -> list[str]:
        navs = (Nav(0, tick, (0.0,) * 5, (0.0,) * 5) for tick in range(first, last))
        return [said.text for nav in navs for said in agent.decide(nav, []).said]

    before, expected = texts(0, 50), texts(50, 100)
    again = make_agent(load_scenario("own.yaml").agent_config(1))
    others = [agent]
    agent, program = again, again
    assert texts(0, 50) == before
    first = program._user._life
    program._user._owner -= 1  # as it is in a copy by fork
    assert texts(50, 100) == expected and len(before) == len(expected) == 5
    first.processes.close()
    for each in (program, *others):
        each._user._life.processes.close()
