"""Zenoh programs, unchanged, with zenoh itself: at the endpoint of their agent they see what they see at a router."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent

import pytest
import zenoh
from own_program import lines, scenario
from repository import ROOT

import fleet
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")
MEMBER = ROOT / "docs/examples/election_stack/member.py"
CONFIG = """
    import json, sys, threading, time, zenoh
    where, me = sys.argv[1], int(sys.argv[2])
    def opened():
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([where]))
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("connect/timeout_ms", "30000")  # the host may be busy
        return zenoh.open(config)
    begin = time.monotonic()
    def until(s): time.sleep(max(0, begin + s - time.monotonic()))
    session = opened()
"""
# Two of them talk. What is said at the same moment is sorted, since a network may turn it round.
STORY = """
    token = session.liveliness().declare_token(f"alive/{me}")
    seen = []
    alive = session.liveliness().declare_subscriber(
        "alive/**", lambda s: seen.append(f"{s.kind} {s.key_expr}"), history=True)
    fifo = session.declare_subscriber("demo/*/fifo")
    ring = session.declare_subscriber(f"demo/{3 - me}/ring", zenoh.handlers.RingChannel(1))
    deleted = session.declare_subscriber("gone/**")
    def asked(q):
        if q.payload is not None: q.reply(f"what/{me}/payload", q.payload.to_bytes()[::-1], attachment=b"a")
        elif "fail" in str(q.parameters): q.reply_err(f"{me} fails".encode())
        elif "delete" in str(q.parameters): q.reply_del(f"what/{me}/gone")
        else:
            for n in range(2): q.reply(f"what/{me}/{n}", f"{me} says {n} to {q.parameters}")
    queryable = session.declare_queryable("what/**", asked)
    # Real programs do not begin at the same time: each waits until the other has declared all this.
    here = session.liveliness().declare_token(f"met/{me}")
    while not [*session.liveliness().get(f"met/{3 - me}", timeout=1.0)]: time.sleep(0.01)
    begin = time.monotonic()
    waits = zenoh.CongestionControl.BLOCK  # by default zenoh drops what a busy host does not take at once
    publisher = session.declare_publisher(
        f"demo/{me}/fifo", encoding=zenoh.Encoding.TEXT_PLAIN, congestion_control=waits)
    until(1.0)
    publisher.put("hello", attachment=b"more")
    publisher.put(b"x" * 100_000)
    for n in range(3): session.put(f"demo/{me}/ring", str(n), congestion_control=waits)
    found = []
    while len(found) < 4 and time.monotonic() < begin + 10:
        if (one := fifo.try_recv()) is None: time.sleep(0.01)
        else: found.append(one)
    def more(s): return s.attachment and s.attachment.to_bytes()
    print(sorted(f"{s.key_expr} {len(s.payload)} {s.encoding} {more(s)}" for s in found))
    until(2.0)
    print(ring.try_recv().payload.to_string(), ring.try_recv(), fifo.try_recv())
    def answers(selector, **how):
        said = []
        for reply in session.get(selector, timeout=3.0, target=zenoh.QueryTarget.ALL,
                                 consolidation=zenoh.ConsolidationMode.NONE, **how):
            if reply.ok is None: said.append(f"error {reply.err.payload.to_string()}")
            else:
                ok = reply.ok
                said.append(f"{ok.kind} {ok.key_expr} {ok.payload.to_string()} {more(ok)}")
        return sorted(said)
    if me == 1:
        print(answers("what/**?it"))
        print(answers("what/**", payload=b"abc"))
        print(answers("what/**?fail"), answers("what/**?delete"))
        print(answers("nobody/knows"), time.monotonic() - begin < 3)
        querier = session.declare_querier("what/**")
        print(sorted(r.ok.payload.to_string() for r in querier.get()))
    until(4.0)
    session.delete(f"gone/{me}")
    until(5.0)
    print(sorted(f"{s.kind} {s.key_expr}" for s in (deleted.try_recv(), deleted.try_recv()) if s is not None))
    print(sorted(set(seen)))
    if me == 2:
        until(5.3)
        token.undeclare()
        other = opened()
        own = other.declare_subscriber("own/x")
        until(6.3)
        session.put("own/x", "from one session to another")
        print(own.recv().payload.to_string())
    until(7.0)
    late = session.liveliness().declare_subscriber("alive/**", history=True)
    until(8.0)
    print(sorted({f"{s.kind} {s.key_expr}" for s in iter(late.try_recv, None)}))
    print([r.ok.key_expr for r in session.liveliness().get("alive/1", timeout=1.0)])
    until(9.0)
    session.close()
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def router() -> Iterator[str]:
    """A plain router on this host."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        place = f"tcp/127.0.0.1:{server.getsockname()[1]}"
    config = zenoh.Config()
    for key, value in (("mode", '"router"'), ("listen/endpoints", f'["{place}"]'),
                       ("scouting/multicast/enabled", "false")):  # fmt: skip
        config.insert_json5(key, value)
    with zenoh.open(config):
        yield place


def zenoh_run(tmp_path: Path, text: str, vehicles: int = 2, **changes: str) -> Result:
    (tmp_path / "program.py").write_text(dedent(CONFIG) + dedent(text))
    (tmp_path / "own.yaml").write_text(scenario('["{zenoh}", "{id}"]', vehicles))
    return fleet.run("own.yaml", out=tmp_path / "runs", set={"duration": "12 s", **changes})


def on_the_host(router: str, folder: Path) -> list[list[str]]:
    """What both say with a plain router, in real time."""
    texts = [folder / f"said-{me}.txt" for me in (1, 2)]
    both = []
    for me, text in enumerate(texts, 1):
        with text.open("w") as file:
            command = [sys.executable, "program.py", router, str(me)]
            both.append(subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT))
    try:
        for one in both:
            one.wait(60)
    except subprocess.TimeoutExpired:
        pass
    finally:
        for one in both:
            one.kill()
            one.wait()
    return [text.read_text().splitlines() for text in texts]


def test_programs_see_at_their_endpoint_what_they_see_at_a_router(router: str, tmp_path: Path) -> None:
    result = zenoh_run(tmp_path, STORY)
    assert result.status is Status.PASS, [lines(result, agent) for agent in (1, 2)]
    ours = [lines(result, me)[:-1] for me in (1, 2)]
    # Zenoh drops what a busy host does not take at once, also with BLOCK after a while.
    assert any(ours == (theirs := on_the_host(router, tmp_path)) for _ in range(3)), (ours, theirs)
    again = execute(load_scenario("own.yaml", ["duration=12 s"]), Options(tmp_path / "runs", quiet=True))
    assert again.digest == result.digest


def test_a_publisher_matches_at_the_endpoint(tmp_path: Path) -> None:
    """The endpoint listens to all, as the one of `fleet netem` does."""
    text = """
        publisher = session.declare_publisher("a/b")
        time.sleep(0.5)
        print(publisher.matching_status.matching)
    """
    assert lines(zenoh_run(tmp_path, text, 1))[0] == "True"


def test_what_is_damaged_or_too_long_is_dropped(tmp_path: Path) -> None:
    text = """
        seen = []
        subscriber = session.declare_subscriber("a/*", lambda s: seen.append(len(s.payload)))
        time.sleep(1)
        for size in (10, 70_000, 2_000_000): session.put(f"a/{me}", bytes(size))
        until(4)
        print(sorted(seen))
    """
    said = lines(zenoh_run(tmp_path, text))
    assert said[0].endswith("bytes is too long: 1048576 at most")
    assert said[1] == "[10, 10, 70000, 70000, 2000000]"
    damaged = zenoh_run(tmp_path, text, **{"network.links.*.corrupt": "100%"})
    assert lines(damaged)[1] == "[10, 70000, 2000000]"


def test_odd_datagrams_end_no_endpoint(tmp_path: Path) -> None:
    """Programs of others can send there, too."""
    text = """
        import msgpack, random, socket
        seen = []
        subscriber = session.declare_subscriber("a/*", lambda s: seen.append(s.payload.to_string()))
        until(1)
        to = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        odd = [[0, "a/#//b", b"x", "text"], [2, 1, "***", b"", None, None], [3, 7, 0, "a", b"", "text"], [4, 7, 1],
               [5, [7]], [6, 1, 3, 1 << 40, b"x"], [6, 1, -1, 2, b"x"], [0], [], 5, [5, 3],
               [2, 1, "a/b", None, None, None, 9]]
        for each in [*map(msgpack.packb, odd), *(random.randbytes(20) for _ in range(200))]:
            to.sendto(each, (f"auv{3 - me}", 7448))
        until(2)
        session.put(f"a/{me}", f"of {me}")
        until(3)
        print(sorted(seen))
    """
    result = zenoh_run(tmp_path, text)
    assert [lines(result, me)[0] for me in (1, 2)] == ["['of 1', 'of 2']"] * 2


@pytest.mark.parametrize("way", ["distributed", "hosted"])
def test_member_has_the_same_bytes_in_every_way(way: str, tmp_path: Path) -> None:
    """The zenoh program of our own example, with the arguments that 1.0 asked for."""
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
    loaded = load_scenario("member.yaml", ["agents.per_process=3"] if way == "hosted" else [])
    result = execute(loaded, Options(tmp_path / "runs", quiet=True))
    assert result.status is Status.PASS, (result.reason, result.lines)
    assert result.directory is not None
    assert result.digest == in_process.digest
    if way == "distributed":
        assert "0.000 1000.000 0" in (result.directory / "log" / "agent-1.log").read_text()
