"""Laws of the user's: how they are found, what happens when they fail, and that the log tells."""

from __future__ import annotations

import inspect
import json
import os
import shlex
import signal
import sys
import threading
import token
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from math import isnan
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import pytest
from failing_laws import failing
from failing_laws import module as module
from loops import agent_config
from marks import slow
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from refusals import check_refusals, words_of
from repository import ROOT
from tool import invoke

from agents.agent import Agent
from agents.config import Law
from agents.errors import AgentError, ControllerError
from agents.make_agent import make_agent
from agents.plugins import laws
from agents.signals import COMMANDED, HEARD
from fleet.addons.templates.verb import Kinds
from fleet.errors import RunBroken, ScenarioError
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from world.errors import PluginError
from world.plugins import loading

EXAMPLE = str(ROOT / "docs" / "examples" / "leader_follower.yaml")
GOOD = """
from agents.api import Signal

class Law:
    signals = (Signal("count", "1", "samples so far"), Signal("drawn", "m", "two draws", 2))

    def __init__(self, config, *, force=1.0):
        self.force, self.count = force, 0

    def step(self, sample):
        self.count += 1
        rng = sample.rng()
        return (self.force, 0.0, 0.0), {"count": self.count, "drawn": (rng.random(), rng.random())}

    def state(self):
        return {"count": self.count}

    def restore(self, values):
        self.count = values["count"]
"""


SCENARIO = """\
title: Four vehicles and a law
vehicles: 4
duration: 500 ms
reference: {{start: 5 1 5 m, velocity: 0.7 0.1 0 m/s}}
formation: {{shape: grid, spacing: 10 m}}
graph: {{shape: path}}
initial: {{scatter: 1 m, surge: 0.1 m/s}}
network: {{period: 100 ms}}
{}
"""
CHOICE_LINE = 9  # where the choice stands


def scenario(choice: str, *more: str) -> Scenario:
    return load_scenario("paper", ["duration=500 ms", "checks={}", choice, *more])


def run(s: Scenario, folder: Path, *, in_process: bool = True) -> Result:
    return execute(s, Options(folder / "runs", in_process=in_process, quiet=True))


def same_bytes(one: Result, other: Result) -> bool:
    return (one.directory / "run.mcap").read_bytes() == (other.directory / "run.mcap").read_bytes()


def logged(result: Result, topic: str) -> list[tuple[Any, Any]]:
    """(channel, decoded message) of one topic."""
    with (result.directory / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [(channel, message) for _, channel, _, message in reader.iter_decoded_messages([topic])]


def metadata_of(result: Result) -> dict[str, str]:
    with (result.directory / "run.mcap").open("rb") as file:
        return next(iter(make_reader(file).iter_metadata())).metadata


def nav(tick: int) -> Any:
    return SimpleNamespace(tick=tick, eta=(0.0,) * 5, nu=(0.1, 0.0, 0.0, 0.0, 0.0), roll=(), clock_ns=None, belief=())


# --- found -----------------------------------------------------------------


@pytest.fixture(autouse=True)
def _read_entry_points_anew() -> Iterator[None]:
    """They are read once per process."""
    loading.entry_points_of.cache_clear()
    yield
    loading.entry_points_of.cache_clear()


def test_entry_points_are_read_once_for_all_vehicles(
    module: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading them opens a file of every installed package."""
    point, read = EntryPoint("my-law", f"{module(GOOD)}:Law", loading.LAWS), []

    def entry_points(group: str) -> list[EntryPoint]:
        read.append(group)
        return [point] if group == loading.LAWS else []  # pydantic asks, too, if this is the first test of a process

    monkeypatch.setattr("importlib.metadata.entry_points", entry_points)
    fleet = scenario("controller=my-law")
    for i in range(1, fleet.vehicles + 1):
        make_agent(fleet.agent_config(i))
    assert read.count(loading.LAWS) == 1


def test_import_path_and_entry_point(module: Callable[[str], str], monkeypatch: pytest.MonkeyPatch) -> None:
    name = module(GOOD)
    by_path = laws.load("controller", Law(f"{name}:Law"))
    point = EntryPoint("my-law", f"{name}:Law", loading.LAWS)
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [point] if group == loading.LAWS else [])
    assert laws.load("controller", Law("my-law")) is by_path
    assert scenario("controller=my-law").agent_config(1).controller == Law("my-law")
    with pytest.raises(PluginError, match="installed: my-law"):
        laws.load("controller", Law("other"))


def changed(change: str) -> str:
    """The good law, parts of it replaced, or other code in its place."""
    text = change.removeprefix("code: ") if change.startswith("code: ") else GOOD
    for edit in [] if text is not GOOD or change == "as it is" else change.split(" ;; "):
        old, _, new = edit.partition(" =>")
        assert old in text, edit
        text = text.replace(old, new[1:])
    return text.replace("\\n", "\n")


def test_what_cannot_be_used_says_why_and_where(module: Callable[[str], str], tmp_path: Path) -> None:
    """Before anything runs, with the line of the scenario that names the law."""
    hide = {f"{tmp_path}/": ""}
    hide |= {str(found.__file__): f"lib/{found.__name__}.py" for found in (json, token)}

    def load(name: str, change: str, parameters: str = "{}") -> None:
        written = module(changed(change))
        hide[written] = "mine"
        law = Law(name.format(written), json.loads(parameters))
        with pytest.raises(PluginError) as caught:
            laws.load("controller", law)
        path = tmp_path / "s.yaml"
        choice = json.dumps({"law": law.name, "parameters": law.parameters}, ensure_ascii=False)
        path.write_text(SCENARIO.format(f"controller: {choice}"), "utf-8")
        with pytest.raises(ScenarioError) as refused:
            load_scenario(path)
        (found,) = refused.value.problems
        assert (found.file, found.line, found.source_line) == (str(path), CHOICE_LINE, f"controller: {choice}")
        if ":" in law.name:
            assert found.message == f"controller.law: {law.name}: {caught.value.problem}"
            assert found.hint == caught.value.hint
        else:
            assert found.message == f'controller.law: there is no controller "{law.name}"'
        raise caught.value

    check_refusals("agents/laws", load, hide=hide)


def test_the_page_shows_what_one_sees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The message of docs/guide/plugins.md, from the template with the page's typing error in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert invoke("new", "controller", "pid").exit_code == 0
    path = tmp_path / "pid.yaml"
    text = path.read_text("utf-8")
    wrong = 'controller: {law: "pid:Pid", parameters: {gian: 0.5}}'
    path.write_text(text.replace("controller: pid:Pid", wrong), "utf-8")
    result = invoke("check", "pid.yaml")
    sys.modules.pop("pid")
    assert f"```\n{result.stderr}```\n" in (ROOT / "docs" / "guide" / "plugins.md").read_text("utf-8")


def test_every_place_that_names_a_law_is_checked(module: Callable[[str], str], tmp_path: Path) -> None:
    name = module("class Nothing: pass")

    def load(choice: str) -> None:
        (tmp_path / "s.yaml").write_text(SCENARIO.format(choice.replace("MODULE", name)), "utf-8")
        load_scenario(tmp_path / "s.yaml")

    check_refusals("agents/places of laws", load, hide={name: "MODULE", str(tmp_path): "HERE"})


def test_an_entry_point_that_cannot_be_used(module: Callable[[str], str], monkeypatch: pytest.MonkeyPatch) -> None:
    """It exists: to say that there is no such controller would send its author the wrong way."""
    hide: dict[str, str] = {}

    def load(attribute: str, change: str) -> None:
        written = module(changed(change))
        hide[written] = "mine"
        point = EntryPoint("my-law", f"{written}:{attribute}", loading.LAWS)
        monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [point] if group == loading.LAWS else [])
        loading.entry_points_of.cache_clear()
        with pytest.raises(ScenarioError) as refused:
            scenario("controller=my-law")
        raise AgentError(refused.value.problems[0].message)

    check_refusals("agents/entry points", load, hide=hide)


@pytest.mark.parametrize("name", [s.name for s in (*HEARD, *COMMANDED)])
def test_a_guidance_law_leaves_our_signals_alone(name: str, module: Callable[[str], str]) -> None:
    """They share a topic, and a message has each field once. A controller's signals have a topic of their own."""
    law = Law(f"{module(GOOD.replace('count', name))}:Law")
    laws.load("controller", law)
    with pytest.raises(PluginError, match=f"signal '{name}' is reported already by every agent"):
        laws.load("guidance", law)


def test_what_a_module_prints_is_no_data(module: Callable[[str], str]) -> None:
    name = module("print('imported')\n" + GOOD)
    result = invoke("run", "paper", "--set", f"controller={name}:Law", "--show-config")
    assert "imported" not in result.stdout
    assert result.stderr == "imported\n"


# --- running ---------------------------------------------------------------


def test_telemetry_lands_in_the_log(module: Callable[[str], str], tmp_path: Path) -> None:
    name = module(GOOD)
    result = run(scenario(f"controller={{law: '{name}:Law', parameters: {{force: 2.5}}}}"), tmp_path)
    assert result.status is Status.PASS, result.reason
    control = logged(result, "uuv/3/control")
    assert [m.count for _, m in control] == list(range(1, 51))
    assert json.loads(control[0][0].metadata["units"]) == {
        "count": ["1", "samples so far"],
        "drawn": ["m", "two draws"],
    }
    assert {tuple(m.tau) for _, m in logged(result, "uuv/3/command")} == {(2.5, 0.0, 0.0)}
    assert len({tuple(m.drawn) for _, m in control}) == 50
    metadata = metadata_of(result)
    assert metadata["resumable"] == "yes"
    assert metadata[f"law {name}:Law"].startswith("sha256 ")


def test_chance_is_a_function_of_seed_vehicle_and_tick(module: Callable[[str], str]) -> None:
    """What a law draws does not depend on its history, and differs between vehicles and seeds."""
    law = Law(f"{module(GOOD)}:Law")

    def drawn(i: int, ticks: list[int], seed: int = 1) -> tuple[float, ...]:
        agent = Agent(replace(agent_config(i), controller=law, seed=seed))
        for tick in ticks:
            telemetry = agent.decide(nav(tick), []).telemetry
        return telemetry[agent.layout.where("drawn")]  # type: ignore[index]

    assert drawn(1, [7]) == drawn(1, [1, 2, 3, 7])
    assert len({drawn(1, [7]), drawn(2, [7]), drawn(1, [8]), drawn(1, [7], seed=2)}) == 4


@pytest.mark.parametrize("more", ["", "self.state = [0.0]", "self.restore = None"])
def test_nobody_asks_for_the_state_of_a_law(more: str, module: Callable[[str], str], tmp_path: Path) -> None:
    """Versions up to 1.0 did. Laws that were written for them run, and so do laws with one of both methods."""
    method = "" if more else "    def state(self):\n        raise LookupError('no memory')\n"
    code = failing(10**9, "pass").replace("self.config = config", f"self.config = config; {more or 'pass'}") + method
    result = run(scenario(f"per_vehicle.2.controller={module(code)}:Law"), tmp_path)
    assert result.status is Status.PASS, result.reason


@pytest.mark.parametrize("name", ["self", "tick", "function", "timed", "found", "law"])
def test_a_parameter_may_have_any_name(name: str, module: Callable[[str], str]) -> None:
    code = GOOD.replace("self, config, *, force=1.0", "me, config, /, **given").replace(
        "self.force, self.count = force, 0", "me.force, me.count = sum(given.values()), 0"
    )
    law = Law(f"{module(code)}:Law", {name: 3.0})
    assert make_agent(replace(agent_config(1), controller=law)).step(nav(0), []).tau[0] == 3.0


FAILURES = words_of("agents/failing laws")


def broken(s: Scenario, folder: Path) -> None:
    """Make a run that must break, and raise why it did."""
    result = run(s, folder)
    assert result.status is Status.BROKEN
    raise RunBroken(result.reason)


def test_failures_name_vehicle_tick_and_line(
    module: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line is the user's own, also if what raised was a library that he called."""
    monkeypatch.chdir(tmp_path)
    hide: dict[str, str] = {}

    def fail(line: str) -> None:
        name = module(failing(20, line))
        hide[name] = "mine"
        broken(scenario(f"controller={name}:Law"), tmp_path)

    check_refusals("agents/failing laws", fail, hide=hide)


WRONG = ("return (float('nan'), 0.0, 0.0), {'a': 0.0}", "return (1.0, 0.0, 0.0), {'a': 0.0, 'b': 1.0}")


@pytest.mark.parametrize("line", ["raise SystemExit(0)", *slow("1 / 0", "return None", *WRONG)])
def test_failures_abort_a_distributed_run(line: str, module: Callable[[str], str], tmp_path: Path) -> None:
    """Whatever a law does, `sys.exit(0)` too: a run whose controller failed has not passed."""
    name = module(failing(20, line))
    result = run(scenario(f"controller={name}:Law"), tmp_path, in_process=False)
    assert result.status is Status.BROKEN
    (note,) = [line for line in result.lines if "controller failed" in line]
    said, _, place = FAILURES[line].partition(" (mine")
    assert said in note and note.endswith(f"{name}{place}")
    assert result.reason.startswith("agent 2 (pid ")
    assert json.loads((result.directory / "result.json").read_text("utf-8"))["exit"] == 3


@pytest.mark.slow
def test_coasting_is_the_same_in_processes(module: Callable[[str], str], tmp_path: Path) -> None:
    """Every kind of failure at once, one per vehicle, at different ticks: the run goes on, each vehicle without
    thrust from there on, and the log has the same bytes distributed as in one process."""
    choices = [
        f"per_vehicle.{i}.controller={module(failing(10 + i, line, vehicle=i))}:Law"
        for i, line in enumerate(FAILURES, start=1)
    ]
    s = scenario(*choices, "on_controller_error=coast", f"vehicles={len(FAILURES)}", "initial={scatter: 1 m}")
    alone, result = run(s, tmp_path), run(s, tmp_path, in_process=False)
    assert alone.status is result.status is Status.PASS
    assert same_bytes(alone, result)
    notes = {}
    for done in (alone, result):
        told = json.loads((done.directory / "result.json").read_text("utf-8"))["notes"]
        notes[done.directory] = sorted(told)
        assert len(told) == len(FAILURES)
    assert notes[alone.directory] == notes[result.directory]
    for i, words in enumerate(FAILURES.values(), start=1):
        said, tick = words.removeprefix("agent 2, tick 20: ").rpartition(" (mine")[0], 10 + i
        (note,) = [n for n in notes[alone.directory] if f" agent {i}: " in n]
        assert note.startswith(f"t = {tick / 100:.2f} s (tick {tick}) agent {i}: {said}")
        assert "; it is not called again, the vehicle coasts" in note
        taus = [tuple(m.tau) for _, m in logged(alone, f"uuv/{i}/command")]
        assert taus == [(1.0, 0.0, 0.0)] * tick + [(0.0, 0.0, 0.0)] * (50 - tick)
        assert [isnan(m.a) for _, m in logged(alone, f"uuv/{i}/control")] == [False] * tick + [True] * (50 - tick)


def test_a_failure_on_the_command_line(module: Callable[[str], str], tmp_path: Path) -> None:
    name = module(failing(20, "1 / 0"))
    choice = ["--set", f"controller={name}:Law", "--set", "checks={}", "--duration", "500 ms"]
    result = invoke("run", "paper", *choice, "--in-process", "--quiet", "--out", str(tmp_path))
    assert (result.exit_code, result.stdout) == (3, f"{(tmp_path / 'latest').resolve()}\n")
    assert result.stderr.startswith("fleet: agent 2, tick 20: Law raised ZeroDivisionError: division by zero (")


def test_leaving_the_debugger_interrupts_the_run(module: Callable[[str], str], tmp_path: Path) -> None:
    """`q` is as Ctrl-C; and an agent process, which has no terminal, says what to do instead."""
    name = module(failing(20, "import bdb; raise bdb.BdbQuit"))
    s = scenario(f"controller={name}:Law", "on_controller_error=coast")
    assert run(s, tmp_path).status is Status.INTERRUPTED
    (note,) = run(s, tmp_path, in_process=False).values["notes"]
    assert "Law raised BdbQuit: to debug, run it with --in-process (" in note


def test_a_law_that_prints_is_noted_once(
    module: Callable[[str], str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    code = failing(10**9, "pass").replace("        return", "        print('hello', sample.tick)\n        return")
    s = scenario(f"per_vehicle.2.controller={module(code)}:Law")
    alone = run(s, tmp_path)
    captured = capfd.readouterr()
    assert captured.out == ""  # standard output is data
    assert captured.err.count("hello") == 50
    result = run(s, tmp_path, in_process=False)
    for notes in (alone.values["notes"], result.values["notes"]):
        (note,) = notes
        assert "agent 2: Law prints (" in note
        assert ".py:11): 'hello'" in note or ".py:11): 'hello" in note
    assert (result.directory / "log" / "agent-2.log").read_text("utf-8").count("hello") == 50


def test_a_print_from_a_library_is_where_it_was_called(module: Callable[[str], str], tmp_path: Path) -> None:
    name = module(failing(20, "import pprint; pprint.pprint('hello')"))
    (note,) = run(scenario(f"controller={name}:Law"), tmp_path).values["notes"]
    assert f"{name}.py:10)" in note


@pytest.mark.parametrize(("line", "policy"), [("time.sleep(30)", "abort"), *slow(("while True: pass", "coast"))])
def test_a_law_over_its_budget(line: str, policy: str, module: Callable[[str], str], tmp_path: Path) -> None:
    """Also one that would never return: the message has the line at which it was."""
    name = module(failing(20, line))
    s = scenario(f"per_vehicle.2.controller={name}:Law", f"on_controller_error={policy}", "controller_budget=2 s")
    results = [run(s, tmp_path, in_process=in_process) for in_process in (True, False)]
    for result in results:
        said = "\n".join([result.reason, *result.lines, *result.values["notes"]])
        assert result.status is (Status.BROKEN if policy == "abort" else Status.PASS)
        assert "agent 2" in said
        assert "tick 20" in said
        assert "Law took longer than its budget of 2000 ms" in said
        assert f"{name}.py:10)" in said
    assert policy == "abort" or same_bytes(*results)


def test_the_budget_is_one_of_samples(module: Callable[[str], str]) -> None:
    """What is made once, a table or a network, may take its time."""
    code = failing(0, "time.sleep(0.06)", vehicle=1).replace(
        "self.config = config", "self.config = config; time.sleep(0.06)"
    )
    agent = make_agent(replace(agent_config(1), controller=Law(f"{module(code)}:Law"), budget_s=0.05))
    with pytest.raises(ControllerError, match="Law took longer than its budget of 50 ms"):
        agent.step(nav(0), [])


def test_the_budget_gives_the_timer_back(module: Callable[[str], str]) -> None:
    """In one process somebody else may be using it: this test suite does, for its own time limit."""
    agent = make_agent(replace(agent_config(1), controller=Law(f"{module(GOOD)}:Law"), budget_s=1.0))
    handler = signal.getsignal(signal.SIGALRM)
    left_s, _ = signal.setitimer(signal.ITIMER_REAL, 60.0)
    try:
        agent.step(nav(0), [])
        assert 50.0 < signal.getitimer(signal.ITIMER_REAL)[0] <= 60.0
        assert signal.getsignal(signal.SIGALRM) is handler
    finally:
        signal.setitimer(signal.ITIMER_REAL, left_s)


def test_the_budget_in_a_thread(module: Callable[[str], str]) -> None:
    """No signal comes there, so a law is judged when it is back."""
    code = failing(1, "time.sleep(2.1)", vehicle=1)
    agent = make_agent(replace(agent_config(1), controller=Law(f"{module(code)}:Law"), budget_s=2.0))
    raised: list[str] = []

    def work() -> None:
        agent.step(nav(0), [])
        try:
            agent.step(nav(1), [])
        except ControllerError as error:
            raised.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert len(raised) == 1
    assert "agent 1, tick 1: Law took longer than its budget of 2000 ms" in raised[0]


def test_a_law_that_cannot_be_made(module: Callable[[str], str], tmp_path: Path) -> None:
    name = module(GOOD.replace("self.force, self.count = force, 0", "raise ValueError('no such sea')"))
    s = scenario(f"controller={name}:Law")
    alone, result = run(s, tmp_path), run(s, tmp_path, in_process=False)
    assert alone.reason.startswith("agent 1, tick 0: Law raised ValueError: no such sea (")
    assert result.status is Status.BROKEN
    assert any(": controller failed: agent " in line and "no such sea" in line for line in result.lines)


# --- the other kinds -------------------------------------------------------


@pytest.mark.once
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[] if kind == "controller" else [pytest.mark.slow]) for kind in get_args(Kinds)]
)
def test_templates_run(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What `fleet new` writes runs as it is, does what its check asks, and is resumable."""
    monkeypatch.chdir(tmp_path)
    name = f"my_{kind}_law"
    arguments = ["new", "controller", name, "--kind", kind, "--dir", str(tmp_path / "the laws")]
    written = invoke(*arguments)
    assert written.exit_code == 0
    again = invoke(*arguments)
    assert again.exit_code == 2
    assert "is there already" in again.output
    *_, path = shlex.split(written.stdout)  # the command that it tells to type
    s = load_scenario(path, ["log.every=100 ticks"])
    result = run(s, tmp_path)
    assert result.status is Status.PASS, (result.reason, result.checks)
    assert metadata_of(result)["resumable"] == "yes"


@pytest.mark.parametrize("kind", ["guidance", *slow("tracking")])
def test_half_of_ours_and_half_of_yours(kind: str, module: Callable[[str], str], tmp_path: Path) -> None:
    """A guidance law with a tracking law of ours, and the other way round; distributed as in one process."""
    code = GOOD.replace("sample):", "sample, command):") if kind == "tracking" else GOOD
    name = module(code)
    s = scenario(f"{kind}={name}:Law", "profile=hardened")
    alone, result = run(s, tmp_path), run(s, tmp_path, in_process=False)
    assert alone.status is result.status is Status.PASS
    assert same_bytes(alone, result)
    mine, ours = ("guidance", "control") if kind == "guidance" else ("control", "guidance")
    rows = logged(alone, f"uuv/4/{mine}")
    assert [m.count for _, m in rows] == list(range(1, 51))
    assert json.loads(rows[0][0].metadata["units"])["drawn"] == ["m", "two draws"]
    assert len(logged(alone, f"uuv/4/{ours}")) == 50
    expected = (1.0, 0.0, 0.0)  # of a guidance law the commanded velocity, of a tracking law the force
    if kind == "guidance":
        assert {tuple(m.rho) for _, m in rows} == {expected}
    else:
        assert {tuple(m.tau) for _, m in logged(alone, "uuv/4/command")} == {expected}


def test_a_whole_agent_sends_what_it_likes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its payload is its own: twelve bytes here, which our codec would refuse. Distributed as in one process."""
    monkeypatch.chdir(tmp_path)
    arguments = ["new", "controller", "whole_agent", "--kind", "agent", "--dir", str(tmp_path)]
    assert invoke(*arguments).exit_code == 0
    s = load_scenario(str(tmp_path / "whole_agent.yaml"), ["duration=1 s", "checks={}"])
    alone, result = run(s, tmp_path), run(s, tmp_path, in_process=False)
    assert same_bytes(alone, result)
    assert {len(m.payload) for _, m in logged(alone, "link/1-2")} == {12}
    assert {m.heard for _, m in logged(alone, "uuv/1/control")} == {0.0, 1.0}
    assert not logged(alone, "uuv/1/guidance")


def test_a_whole_agent_that_answers_nonsense(module: Callable[[str], str], tmp_path: Path) -> None:
    hide = {f"{tmp_path}/": ""}

    def answer(sends: str, does: str) -> None:
        name = module(f"""\
            class Law:
                signals = ()
                def __init__(self, config): pass
                def transmit(self, nav): return {sends}
                def decide(self, nav, deliveries): return {does}
        """)
        hide[name] = "mine"
        broken(scenario(f"agent={name}:Law"), tmp_path)

    check_refusals("agents/nonsense of whole agents", answer, hide=hide)


@pytest.mark.parametrize(("method", "rounds"), [("transmit", 2), ("decide", 3)])
def test_a_whole_agent_that_fails_coasts(
    method: str, rounds: int, module: Callable[[str], str], tmp_path: Path
) -> None:
    """From the tick on at which it fails there is no force; what it has sent by then is the last."""
    name = module(f"""\
        class Law:
            signals = ()
            def __init__(self, config): pass
            def transmit(self, nav): return self.unless("transmit", nav, [b"mine"])
            def decide(self, nav, deliveries): return self.unless("decide", nav, ((1.0, 2.0, 3.0), {{}}))
            def unless(self, failing, nav, answer):
                return answer if (failing, nav.tick) != ({method!r}, 20) else 1 / 0
    """)
    result = run(scenario(f"agent={name}:Law", "on_controller_error=coast"), tmp_path)
    assert result.status is Status.PASS
    taus = [tuple(m.tau) for _, m in logged(result, "uuv/2/command")]
    assert taus == [(1.0, 2.0, 3.0)] * 20 + [(0.0, 0.0, 0.0)] * 30
    assert len(logged(result, "link/2-1")) == rounds


@pytest.mark.parametrize("name", ["json", "numpy", "fleet"])
def test_a_template_is_not_hidden_by_another_module(name: str, tmp_path: Path) -> None:
    """What is installed is found before what lies beside a scenario."""
    result = invoke("new", "controller", name, "--dir", str(tmp_path))
    assert result.exit_code == 2
    assert f"Python has a module '{name}' already (" in result.output
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("name", ["none", "true", "Signal", "MyPid", "x_the_law", "THE_CHOICE", "_x", "___", "a" * 70])
def test_a_template_may_have_any_other_name(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one that YAML, Python or the template has another use for."""
    monkeypatch.chdir(tmp_path)
    assert invoke("new", "controller", name, "--dir", str(tmp_path)).exit_code == 0
    assert sorted(os.listdir(tmp_path)) == [f"{name}.py", f"{name}.yaml"]
    s = load_scenario(tmp_path / f"{name}.yaml", ["duration=100 ms", "checks={}"])
    assert run(s, tmp_path).status is Status.PASS


# --- the worked example ----------------------------------------------------


@pytest.mark.slow
def test_the_worked_example_against_nboc(tmp_path: Path) -> None:
    """The table in docs/guide/plugins.md."""
    rows = {}
    for label, choice in (("leader-follower", []), ("NBOC", ["controller=nboc"])):
        result = run(load_scenario(EXAMPLE, [*choice, "log.every=5 ticks"]), tmp_path)
        assert result.status is Status.PASS, result.checks
        rows[label] = list(result.values["vehicles"].values())
        assert all(row["formation_final_m"] < 0.1 for row in rows[label])
    page = (ROOT / "docs" / "guide" / "plugins.md").read_text("utf-8")
    for label, vehicles in rows.items():
        (line,) = [text for text in page.splitlines() if text.startswith(f"| {label} |")]
        settle, rms, final, effort = ([float(x) for x in cell.split()] for cell in line.split("|")[2:6])
        assert [row["settle_10pct_s"] for row in vehicles] == pytest.approx(settle, abs=0.11)
        assert [row["e_rms_m"] for row in vehicles] == pytest.approx(rms, abs=0.001)
        assert [row["formation_final_m"] for row in vehicles] == pytest.approx(final, abs=0.001)
        assert [row["effort_Ns"] for row in vehicles] == pytest.approx(effort, abs=1.0)
    for follower, nboc in zip(*rows.values(), strict=True):
        assert all(nboc[key] < follower[key] for key in ("settle_10pct_s", "e_rms_m", "formation_final_m"))
        assert nboc["effort_Ns"] > follower["effort_Ns"]  # what the page says it costs


@pytest.mark.slow
def test_the_worked_example_in_processes(tmp_path: Path) -> None:
    s = load_scenario(EXAMPLE, ["duration=1 s", "checks={}"])
    assert same_bytes(run(s, tmp_path), run(s, tmp_path, in_process=False))


def test_the_worked_example_is_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page promises some thirty lines."""
    monkeypatch.syspath_prepend(str(Path(EXAMPLE).parent))
    load_scenario(EXAMPLE)  # which lets in what lies beside it
    found = laws.load("controller", Law("leader_follower:LeaderFollower"))
    source = inspect.getsource(found.step)
    assert len([line for line in source.splitlines() if line.strip() and not line.strip().startswith("#")]) <= 30
