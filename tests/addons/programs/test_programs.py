"""Programs of somebody else as agents: what they import is their own, their time is simulated, and runs repeat."""

from __future__ import annotations

import asyncio
import gc
import shutil
import sys
from pathlib import Path
from textwrap import dedent

import pytest
from own_program import RunProgram, lines, same_bytes
from repository import ROOT
from tool import invoke

import fleet
from fleet.errors import ScenarioError
from fleet.result.result import Status

MEMBER = ROOT / "docs/examples/election_stack/member.py"


def test_time_is_simulated_and_chance_is_seeded(run: RunProgram) -> None:
    text = """
        import datetime, os, random, secrets, sys, time, uuid
        print(time.monotonic(), time.time() - 1767225600)
        time.sleep(0.5)
        print(time.perf_counter(), time.monotonic_ns(), datetime.datetime.now(), time.strftime("%Y %H:%M:%S"))
        print(random.random(), random.Random().random(), uuid.uuid4(), uuid.uuid1(), secrets.token_hex(2))
        print(os.urandom(2))
        print(sys.argv[1:], os.getpid(), f"{int(sys.argv[1])} v")
    """
    first = run(text)
    assert first.status is Status.PASS, (first.reason, first.lines)
    one = lines(first)
    assert one[0].startswith("0.0 0.0") and one[1] == "0.5 500000000 2026-01-01 00:00:00.500000 2026 00:00:00"
    assert one[4] == "['1'] 1001 1 v"
    assert lines(run(text)) == one and one[2] != lines(first, 2)[2]


def test_threads_take_turns(run: RunProgram) -> None:
    result = run("""
        import queue, sched, threading, time
        from concurrent.futures import ThreadPoolExecutor
        found, event, condition, barrier = queue.Queue(), threading.Event(), threading.Condition(), threading.Barrier(2)
        def work(n):
            for _ in range(3):
                time.sleep(0.1 * n)
                found.put((n, round(time.monotonic(), 2)))
        workers = [threading.Thread(target=work, args=(n,)) for n in (1, 2)]
        for each in workers: each.start()
        threading.Timer(0.15, event.set).start()
        print(event.wait(1), event.wait(0), time.monotonic())
        for each in workers: each.join()
        print([found.get() for _ in range(6)], found.empty())
        try: found.get(timeout=0.1)
        except queue.Empty: print("empty", time.monotonic())
        def notify():
            time.sleep(0.1)
            with condition: condition.notify()
        threading.Thread(target=notify).start()
        with condition: print(condition.wait(1), condition.wait(0.05), time.monotonic())
        threading.Thread(target=lambda: (time.sleep(0.1), barrier.wait())).start()
        barrier.wait()
        with ThreadPoolExecutor(2) as pool: print([*pool.map(lambda v: v * v, range(3))])
        s = sched.scheduler(time.monotonic, time.sleep)
        s.enter(0.2, 1, lambda: print("due", time.monotonic()))
        s.run()
        lock = threading.RLock()
        with lock, lock: print(lock.acquire(), threading.current_thread().name, threading.active_count())
        def fail(): raise ValueError("planned")
        threading.Thread(target=fail).start()
        time.sleep(0.01)
    """)
    assert result.status is Status.PASS, (result.reason, result.lines)
    said = lines(result)
    assert said[:3] == [
        "True True 0.15", "[(1, 0.1), (2, 0.2), (1, 0.2), (1, 0.3), (2, 0.4), (2, 0.6)] True", "empty 0.7"
    ]  # fmt: skip
    assert said[3:7] == ["True False 0.85", "[0, 1, 4]", "due 1.15", "True MainThread 1"]
    assert said[7].startswith("Exception in thread") and said[-1] == "ValueError: planned"


def test_datagrams_go_to_agents(run: RunProgram) -> None:
    result = run("""
        import socket, sys, time
        me = int(sys.argv[1])
        u = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        u.bind(("0.0.0.0", 9000))
        u.settimeout(0.2)
        u.sendto(b"from %d" % me, (f"10.0.0.{3 - me}", 9000))
        print(u.recvfrom(100), time.monotonic())
        try: u.recvfrom(100)
        except TimeoutError: print("nothing", time.monotonic())
        for refused in (lambda: socket.socket(), lambda: __import__("subprocess"), lambda: __import__("ssl"),
                        lambda: __import__("zenoh.ext")):
            try: refused()
            except (OSError, ImportError) as error: print("lockstep" in str(error))
    """)
    assert lines(result) == ["(b'from 2', ('10.0.0.2', 9000)) 0.03", "nothing 0.23", *["True"] * 4]


SELECT = """
    import select, selectors, socket, sys, time
    me = int(sys.argv[1])
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    for each, port in zip(sockets, (9000, 9001)):
        each.bind(("", port))
        each.setblocking(False)
    print(select.select(sockets, [], [], 0.1), round(time.monotonic(), 2))
    print(select.select(sockets, sockets[:1], [], 0)[1] == sockets[:1], select.select(sockets, [], [], 0))
    sockets[0].sendto(b"one", (f"10.0.0.{3 - me}", 9001))
    found, _, _ = select.select(sockets, [], [])
    print(found == [sockets[1]], found[0].recvfrom(100), round(time.monotonic(), 2))
    with selectors.DefaultSelector() as selector:
        for name, each in zip("ab", sockets): selector.register(each, selectors.EVENT_READ, name)
        print(selector.select(timeout=0.5), round(time.monotonic(), 2))
        sockets[1].sendto(b"two", (f"10.0.0.{3 - me}", 9000))
        ((key, events),) = selector.select()
        print(key.data, key.fileobj.recv(100), round(time.monotonic(), 2))
    sockets[0].close()
    for wrong in (sockets[0], sys.stdin, 0):
        try: select.select([wrong], [], [], 0)
        except OSError as error: print(str(error)[:30])
"""


def test_select_waits_for_any_of_several_sockets(run: RunProgram) -> None:
    result = run(SELECT)
    assert result.status is Status.PASS, (result.reason, result.lines)
    assert lines(result) == [
        "([], [], []) 0.1", "True ([], [], [])", "True (b'one', ('10.0.0.2', 9000)) 0.13", "[] 0.63",
        "a b'two' 0.66", "[Errno 9] Bad file descriptor:", "fileno", "[Errno 9] Bad file descriptor:",
    ]  # fmt: skip


def test_select_has_the_same_bytes_in_processes_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert same_bytes(tmp_path, SELECT)


def test_zenoh_as_its_examples_use_it(run: RunProgram) -> None:
    result = run("""
        import sys, time, zenoh
        me = int(sys.argv[1])
        with zenoh.open(zenoh.Config()) as session:
            token = session.liveliness().declare_token(f"alive/{me}")
            alive = session.liveliness().declare_subscriber("alive/**", lambda s: print(s.kind, s.key_expr))
            fifo = session.declare_subscriber("demo/*/fifo")
            ring = session.declare_subscriber("demo/*/ring", zenoh.handlers.RingChannel(1))
            session.declare_queryable("what/**", lambda q: q.reply(q.key_expr, f"{me} says {q.parameters}"))
            time.sleep(0.2)
            publisher = session.declare_publisher(f"demo/{me}/fifo", encoding=zenoh.Encoding.TEXT_PLAIN)
            publisher.put("hello", attachment=b"more")
            for n in range(3): session.put(f"demo/{me}/ring", str(n))
            for _ in range(2):
                s = fifo.recv()
                print(s.key_expr, s.payload.to_string(), s.encoding, s.attachment.to_bytes())
            time.sleep(0.5)
            print(ring.try_recv().payload.to_string(), ring.try_recv(), fifo.try_recv())
            if me == 1:
                begin = time.monotonic()
                for reply in session.get("what/is?it", timeout=1.0):
                    print(reply.ok.key_expr, reply.ok.payload.to_string())
                print("answered", time.monotonic() - begin < 0.5)
                session.delete("demo/x")
            else:
                time.sleep(0.2)
            print(zenoh.KeyExpr("a/*").intersects(zenoh.KeyExpr("a/b")))
            try: zenoh.scout()
            except AttributeError as error: print(error)
        time.sleep(0.5)
    """)
    assert result.status is Status.PASS, (result.reason, result.lines)
    said = lines(result)
    assert "SampleKind.PUT alive/2" in said and "SampleKind.DELETE alive/2" in said
    assert "demo/1/fifo hello text/plain b'more'" in said and "demo/2/fifo hello text/plain b'more'" in said
    assert "2 None None" in said
    assert sorted(line for line in said if " says " in line) == ["what/is 1 says it", "what/is 2 says it"]
    assert said[-4:] == [
        "answered True",
        "True",
        "zenoh.scout is not there in lockstep; fleet netem runs the program with zenoh itself",
        "SampleKind.DELETE alive/2",
    ]


MATCHING = """
    import time, zenoh
    session = zenoh.open()
    publisher, querier = session.declare_publisher("a/b"), session.declare_querier("c/**")
    print(publisher.matching_status.matching, querier.matching_status.matching)
    listener = publisher.declare_matching_listener()
    print(listener.try_recv())
    subscriber = session.declare_subscriber("a/*")
    publisher.declare_matching_listener(lambda status: print("matching", status.matching))
    time.sleep(0.1)
    subscriber.undeclare()
    print(publisher.matching_status.matching)
"""


def test_a_publisher_matches_if_somebody_may_hear_it(run: RunProgram) -> None:
    assert lines(run(MATCHING)) == ["True True", "MatchingStatus(matching=True)", "matching True", "True"]
    assert lines(run(MATCHING, vehicles=1)) == ["False False", "None", "matching True", "False"]


def test_asyncio_over_datagrams(run: RunProgram) -> None:
    result = run("""
        import asyncio, sys, time
        me = int(sys.argv[1])
        class Peer(asyncio.DatagramProtocol):
            def __init__(self): self.got = asyncio.Queue()
            def datagram_received(self, data, source): self.got.put_nowait((data, source))
        async def tick(n):
            for _ in range(2):
                await asyncio.sleep(0.1 * n)
                print("tick", n, round(asyncio.get_running_loop().time(), 2))
        async def main():
            loop = asyncio.get_running_loop()
            transport, peer = await loop.create_datagram_endpoint(Peer, local_addr=("0.0.0.0", 7000))
            transport.sendto(b"hi", (f"10.0.0.{3 - me}", 7000))
            print(await peer.got.get(), loop.time())
            try: await asyncio.wait_for(peer.got.get(), 0.2)
            except asyncio.TimeoutError: print("late", round(loop.time(), 2))
            async with asyncio.TaskGroup() as group:
                for n in (1, 2): group.create_task(tick(n))
            print(await asyncio.to_thread(lambda: 7), await loop.run_in_executor(None, lambda: 8))
            try: await asyncio.open_connection("10.0.0.2", 1)
            except NotImplementedError as error: print("lockstep" in str(error))
            transport.close()
        asyncio.run(main())
        print("over", time.monotonic())
    """)
    assert result.status is Status.PASS, (result.reason, result.lines)
    assert lines(result) == [
        "(b'hi', ('10.0.0.2', 7000)) 0.03", "late 0.23", "tick 1 0.33", "tick 2 0.43", "tick 1 0.43", "tick 2 0.63",
        "7 8", "True", "over 0.63",
    ]  # fmt: skip


RACE = """
    import asyncio, sys
    async def one(order, n):
        await asyncio.sleep(0)
        order.append(n)
    async def main():
        order = []
        await asyncio.gather(*(one(order, n) for n in range(5)))
        print(order)
    asyncio.run(main())
"""


def test_the_order_of_callbacks_is_fixed_or_by_chance(run: RunProgram) -> None:
    assert {lines(run(RACE), agent)[0] for agent in (1, 2)} == {"[0, 1, 2, 3, 4]"}
    seeded = [lines(run(RACE, order="seeded"), agent)[0] for agent in (1, 2)]
    assert any(order != "[0, 1, 2, 3, 4]" for order in seeded)
    assert [lines(run(RACE, order="seeded"), agent)[0] for agent in (1, 2)] == seeded


def test_what_an_endpoint_or_a_thread_awaits_takes_a_turn_of_the_loop(run: RunProgram) -> None:
    """In any order of callbacks the endpoint is connected, and others run before the answer of a thread is there."""
    text = """
        import asyncio
        class Peer(asyncio.DatagramProtocol):
            def connection_made(self, transport): self.transport = transport
        async def main():
            loop, said = asyncio.get_running_loop(), []
            for port in range(7000, 7010):
                transport, peer = await loop.create_datagram_endpoint(Peer, local_addr=("0.0.0.0", port))
                assert peer.transport is transport
            async def other(): said.append("other")
            task = loop.create_task(other())
            said.append(await asyncio.to_thread(lambda: "thread"))
            await task
            print(said)
            try: await asyncio.to_thread(int, "x")
            except ValueError: print("raised")
        asyncio.run(main())
    """
    assert lines(run(text)) == ["['other', 'thread']", "raised"]
    assert run(text, order="seeded").status is Status.PASS


def test_who_waits_in_a_thread_or_in_a_callback_blocks_what_it_would_in_asyncio(run: RunProgram) -> None:
    result = run("""
        import asyncio, time
        async def tick():
            for _ in range(2):
                await asyncio.sleep(0.2)
                print("tick", time.monotonic())
        async def main():
            other = asyncio.create_task(tick())
            await asyncio.to_thread(time.sleep, 0.3)
            print("thread", time.monotonic())
            await other
            other = asyncio.create_task(tick())
            time.sleep(0.5)
            print("callback", time.monotonic())
            await other
        asyncio.run(main())
    """)
    assert result.status is Status.PASS, (result.reason, result.lines)
    assert lines(result) == ["tick 0.2", "thread 0.3", "tick 0.4", "callback 0.9", "tick 1.1", "tick 1.3"]


def test_a_program_that_was_changed_a_moment_ago_is_the_new_one(run: RunProgram) -> None:
    """Python's cache knows a file by its size and the second."""
    assert [lines(run(f"print({n})")) for n in range(5)] == [[str(n)] for n in range(5)]


def test_modules_beside_it_are_the_programs_own(run: RunProgram, tmp_path: Path) -> None:
    """Each agent, and each life, has its own state."""
    (tmp_path / "beside").mkdir()
    (tmp_path / "beside" / "__init__.py").write_text("from .state import seen\n")
    (tmp_path / "beside" / "state.py").write_text("import time\nseen = []\nloaded = time.monotonic()\n")
    text = """
        import sys, json
        import beside.state as state
        from beside import seen
        seen.append(sys.argv[1])
        print(seen is state.seen, seen, state.loaded, json.dumps([1]), f"{len(seen)} v")
    """
    assert [lines(run(text), agent) for agent in (1, 2, 1)] == [
        ["True ['1'] 0.0 [1] 1 v"], ["True ['2'] 0.0 [1] 1 v"], ["True ['1'] 0.0 [1] 1 v"]
    ]  # fmt: skip
    assert "beside" not in __import__("sys").modules


def test_a_program_that_fails_or_never_waits_ends_the_run_with_its_line(
    run: RunProgram, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed = run("import time\ntime.sleep(1)\nraise ValueError('planned')\n")
    assert failed.status is Status.BROKEN and "raised ValueError: planned (program.py:3)" in failed.reason
    ended = run("import sys\nsys.exit('no such file')\n")
    assert "it ended with 'no such file'" in ended.reason
    assert run("import sys\nsys.exit(0)\n").status is Status.PASS
    monkeypatch.setattr("fleet.addons.programs.agent.BUDGET_S", 0.2)
    hanging = run("while True:\n    pass\n")
    assert "it computed for 0.2 s and did not wait" in hanging.reason and "program.py:" in hanging.reason


def test_a_killed_program_begins_anew_without_a_trace(run: RunProgram, tmp_path: Path) -> None:
    text = """
        import random, sys, time
        try:
            print("life", time.monotonic(), random.random())
            while True:
                time.sleep(0.1)
        finally:
            print("finally")
    """
    (tmp_path / "program.py").write_text(dedent(text))
    run(text)
    killed = fleet.run("own.yaml", out=tmp_path / "runs", fault=["at 1s for 500ms kill 1"])
    gc.collect()
    said = lines(killed)
    assert [line.split()[:2] for line in said] == [["life", "0.0"], ["life", "1.5"]], said
    assert said[0].split()[2] != said[1].split()[2]


STUBBORN = """
    import asyncio, threading, time
    def forever():
        while True:
            try: time.sleep(0.1)
            except BaseException: pass
    threading.Thread(target=forever).start()
    async def main():
        asyncio.get_running_loop().create_task(asyncio.sleep(50))
        await asyncio.sleep(100)
    asyncio.run(main())
"""


def test_the_template_runs_and_passes_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert invoke("new", "program", "greatest").exit_code == 0
    result = fleet.run("greatest.yaml")
    assert result.status is Status.PASS, (result.reason, result.checks)
    assert invoke("check", "greatest_stack.yaml").exit_code == 0


def test_a_loop_of_who_runs_it_goes_on(run: RunProgram) -> None:
    async def host() -> None:
        before = asyncio.get_running_loop(), sys.get_asyncgen_hooks()
        assert run(RACE).status is Status.PASS
        assert (asyncio.get_running_loop(), sys.get_asyncgen_hooks()) == before

    asyncio.run(host())


def left() -> int:
    gc.collect()
    return sum(type(each).__name__ in ("ProgramLife", "ProgramLoop") for each in gc.get_objects())


def test_nothing_of_a_run_is_left(run: RunProgram) -> None:
    """The collector does not see into threads that wait."""
    before = left()
    sleeping = "import threading, time\nthreading.Timer(9, print).start()\nwhile True:\n    time.sleep(0.1)\n"
    for text in (sleeping, RACE, STUBBORN.replace("except BaseException", "except Exception")):
        assert run(text).status is Status.PASS
    assert left() == before


def test_a_program_that_catches_everything_ends_too(run: RunProgram) -> None:
    assert run(STUBBORN).status is Status.PASS
    gc.collect()


def test_mistakes_are_told_where_they_are(run: RunProgram, tmp_path: Path) -> None:
    for key, value, words in (
        ("order", "odd", "order: expected ready or seeded, got 'odd'"),
        ("cots", "1", "there is no key 'cots'"),
    ):
        with pytest.raises(ScenarioError, match=words):
            run("pass", **{key: value})
    with pytest.raises(ScenarioError, match="line is no regular expression"):
        run("pass", signal="(")


def test_a_log_runs_no_program_of_mine_unasked(
    run: RunProgram, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run("print('0 v')")
    mark, elsewhere = tmp_path / "mark", tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "program.py").write_text(f"open({str(mark)!r}, 'w')\n")
    assert result.directory is not None
    log = shutil.copytree(result.directory, elsewhere / "run")
    shutil.copy(elsewhere / "program.py", log)
    monkeypatch.chdir(elsewhere)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "of-somebody-else"))
    refused = invoke("verify", log)
    assert refused.exit_code == 2 and "--trust runs it" in refused.stderr, refused.output
    assert not mark.exists()


@pytest.mark.parametrize("way", ["distributed", "hosted"])
def test_member_has_the_same_bytes_in_every_way(way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The zenoh program of our own example, unchanged."""
    from fleet.execution.execute import execute
    from fleet.execution.options import Options
    from fleet.scenario.loading import load_scenario

    monkeypatch.chdir(tmp_path)
    shutil.copy(MEMBER, tmp_path)
    (tmp_path / "member.yaml").write_text(
        dedent(r"""
        name: member
        title: member.py, unchanged
        vehicles: 3
        moored: true
        tick: 10 ms
        duration: 4 s
        graph: {shape: ring}
        network: {period: 10 ms, links: {"*": delay 40ms 20ms loss 20%}}
        agent:
          program: member.py
          arguments: ["tcp/unused", "{id}", "3", "1"]
          signals: {leader: '[\d.]+ (?P<value>\d+)$'}
        checks: {signal: {name: a-leader, topic: control.leader, above: 0, after: 3 s}}
        """).strip()
    )
    in_process = fleet.run("member.yaml")
    assert in_process.status is Status.PASS
    scenario = load_scenario("member.yaml", ["agents.per_process=3"] if way == "hosted" else [])
    result = execute(scenario, Options(tmp_path / "runs", quiet=True))
    assert result.status is Status.PASS, (result.reason, result.lines)
    assert result.directory is not None
    if way == "distributed":
        assert result.digest == in_process.digest
        assert "0.010 0.010 0" in (result.directory / "log" / "agent-1.log").read_text()
