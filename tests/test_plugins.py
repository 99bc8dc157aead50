"""Laws of the user's: how they are found, what happens when they fail, and that the log tells."""

from __future__ import annotations

import inspect
import json
import os
import random
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from textwrap import dedent
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner
from loops import agent_config
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from agents import plugins
from agents.agent import Agent, make_agent
from agents.config import Law
from agents.errors import PluginError
from fleet.cli import cli
from fleet.new import KINDS
from fleet.run import Options, Result, Status, execute
from fleet.scenario import Scenario, load_scenario

ROOT = Path(__file__).parent.parent
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


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Writes a module beside the scenario-to-be and returns its name, another one each time."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(code: str) -> str:
        name = f"law_{random.getrandbits(40)}"
        (tmp_path / f"{name}.py").write_text(dedent(code), "utf-8")
        return name

    return write


def failing(at: int, line: str) -> str:
    """A law whose step does something wrong at one tick; the faulty line is line 10."""
    return f"""\
import time
from agents.api import Signal

class Law:
    signals = (Signal("a", "1", ""),)
    def __init__(self, config):
        self.config = config
    def step(self, sample):
        if sample.tick == {at} and self.config.id == 2:
            {line}
        return (1.0, 0.0, 0.0), {{"a": 0.0}}
"""


def scenario(choice: str, *more: str) -> Scenario:
    return load_scenario("paper", ["duration=500 ms", "checks={}", choice, *more])


def run(s: Scenario, folder: Path, *, in_process: bool = True) -> Result:
    return execute(s, Options(folder / "runs", in_process=in_process, quiet=True))


# --- found -----------------------------------------------------------------


def test_import_path_and_entry_point(module: Callable[[str], str], monkeypatch: pytest.MonkeyPatch) -> None:
    name = module(GOOD)
    by_path = plugins.load("controller", Law(f"{name}:Law"))
    point = EntryPoint("my-law", f"{name}:Law", plugins.GROUP)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [point] if group == plugins.GROUP else [])
    assert plugins.load("controller", Law("my-law")) is by_path
    assert scenario("controller=my-law").agent_config(1).controller == Law("my-law")
    with pytest.raises(PluginError, match="installed: my-law"):
        plugins.load("controller", Law("other"))


MISTAKES = [
    (GOOD, "nowhere_at_all:Law", {}, "there is no module 'nowhere_at_all'", "beside the scenario"),
    ("import nowhere_at_all", "{}:Law", {}, "importing it failed: No module named 'nowhere_at_all'", ".py:1"),
    ("x = (", "{}:Law", {}, "SyntaxError", ".py:1"),
    ("\n1 / 0", "{}:Law", {}, "ZeroDivisionError", ".py:2"),
    (GOOD, "{}:Lwa", {}, "has no 'Lwa'", "it has Law"),
    ("Law = 3", "{}:Law", {}, "expected a class, got int", ""),
    ("class Law: pass", "{}:Law", {}, "it has no method step", "a controller needs step"),
    (GOOD.replace("def state", "def sate"), "{}:Law", {}, "only one of state and restore", "write both"),
    (GOOD.replace("signals = (", "signals = 3 #"), "{}:Law", {}, "expected signals as a tuple", "() reports nothing"),
    (GOOD.replace('"drawn", "m"', '"count", "m"'), "{}:Law", {}, "declared twice", ""),
    (GOOD.replace('"count", "1"', '"count", ""'), "{}:Law", {}, "has no unit", 'write "1"'),
    (GOOD.replace(', 2)', ', 0)'), "{}:Law", {}, "has width 0", ""),
    (GOOD, "{}:Law", {"froce": 2.0}, "unexpected keyword argument 'froce'", "force=1.0"),
    (GOOD, "{}", {}, "there is none of this name", "package.module:Class"),
    (GOOD, "a b:Law", {}, "expected package.module:Class", ""),
]  # fmt: skip


@pytest.mark.parametrize(("code", "name", "parameters", "problem", "hint"), MISTAKES)
def test_what_cannot_be_used_says_why(
    module: Callable[[str], str], code: str, name: str, parameters: dict[str, Any], problem: str, hint: str
) -> None:
    with pytest.raises(PluginError) as caught:
        plugins.load("controller", Law(name.format(module(code)), parameters))
    assert problem in caught.value.problem
    assert hint in caught.value.hint


def test_a_scenario_names_the_place_of_a_bad_law(tmp_path: Path) -> None:
    text = load_scenario("paper").to_yaml().replace("controller: nboc", "controller: nowhere_at_all:Law")
    path = tmp_path / "s.yaml"
    path.write_text(text, "utf-8")
    result = CliRunner().invoke(cli, ["check", str(path)])
    assert result.exit_code == 2
    assert "controller.law: nowhere_at_all:Law: there is no module 'nowhere_at_all'" in result.output
    assert "controller: nowhere_at_all:Law" in result.output
    misspelt = CliRunner().invoke(cli, ["check", "paper", "--set", "controller=nbco"])
    assert 'did you mean "nbc"?' in misspelt.output


# --- running ---------------------------------------------------------------


def test_telemetry_lands_in_the_log(module: Callable[[str], str], tmp_path: Path) -> None:
    name = module(GOOD)
    result = run(scenario(f"controller={{law: '{name}:Law', parameters: {{force: 2.5}}}}"), tmp_path)
    assert result.status is Status.PASS, result.reason
    with (result.directory / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        metadata = next(iter(reader.iter_metadata())).metadata
        rows = [(c, m) for _, c, _, m in reader.iter_decoded_messages(topics=["uuv/3/control", "uuv/3/command"])]
    control = [(c, m) for c, m in rows if c.topic == "uuv/3/control"]
    assert [m.count for _, m in control] == list(range(1, 51))
    assert json.loads(control[0][0].metadata["units"]) == {
        "count": ["1", "samples so far"],
        "drawn": ["m", "two draws"],
    }
    assert {tuple(m.tau) for c, m in rows if c.topic == "uuv/3/command"} == {(2.5, 0.0, 0.0)}
    assert metadata["resumable"] == "yes"
    assert metadata[f"law {name}:Law"].startswith("sha256 ")
    assert len({tuple(m.drawn) for _, m in control}) == 50


def test_without_state_the_log_says_so(module: Callable[[str], str], tmp_path: Path) -> None:
    name = module(failing(10**9, "pass"))
    result = run(scenario(f"per_vehicle.2.controller={name}:Law"), tmp_path)
    with (result.directory / "run.mcap").open("rb") as file:
        metadata = next(iter(make_reader(file).iter_metadata())).metadata
    assert metadata["resumable"] == f"no: {name}:Law has no state() and restore()"


def test_chance_is_a_function_of_seed_vehicle_and_tick(module: Callable[[str], str]) -> None:
    """What a law draws does not depend on its history, and differs between vehicles and seeds."""
    law = Law(f"{module(GOOD)}:Law")

    def drawn(i: int, ticks: list[int], seed: int = 1) -> tuple[float, ...]:
        agent = Agent(replace(agent_config(i), controller=law, seed=seed))
        for tick in ticks:
            nav = SimpleNamespace(tick=tick, eta=(0.0,) * 5, nu=(0.1, 0.0, 0.0, 0.0, 0.0))
            telemetry = agent.decide(nav, []).telemetry
        return telemetry[agent.layout.where("drawn")]  # type: ignore[index]

    assert drawn(1, [7]) == drawn(1, [1, 2, 3, 7])
    assert len({drawn(1, [7]), drawn(2, [7]), drawn(1, [8]), drawn(1, [7], seed=2)}) == 4


def test_state_goes_on_in_a_fresh_agent(module: Callable[[str], str]) -> None:
    config = replace(agent_config(1), controller=Law(f"{module(GOOD)}:Law"))
    navs = [SimpleNamespace(tick=k, eta=(0.0,) * 5, nu=(0.1, 0.0, 0.0, 0.0, 0.0)) for k in range(20)]
    one, other = make_agent(config), make_agent(config)
    for nav in navs[:10]:
        one.step(nav, [])
    other.restore(one.state())
    assert [other.step(nav, []) for nav in navs[10:]] == [one.step(nav, []) for nav in navs[10:]]


FAILURES = {
    "raises": ("1 / 0", "Law raised ZeroDivisionError: division by zero", 10),
    "nan": ("return (float('nan'), 0.0, 0.0), {'a': 0.0}", "(nan, 0.0, 0.0): every number must be finite", 8),
    "two numbers": ("return (1.0, 2.0), {'a': 0.0}", "(1.0, 2.0): expected three numbers", 8),
    "no tuple": ("return None", "returned None: expected ((tau1, tau2, tau3), telemetry)", 8),
    "text": ("return 'abc', {'a': 0.0}", "'abc': expected three numbers", 8),
    "missing": ("return (1.0, 0.0, 0.0), {}", "returned telemetry that lacks a", 8),
    "unknown": ("return (1.0, 0.0, 0.0), {'a': 0.0, 'b': 1.0}", "returned telemetry that adds b", 8),
    "bad telemetry": ("return (1.0, 0.0, 0.0), {'a': (1.0, 2.0)}", "returned a (1.0, 2.0): expected a number", 8),
    "infinite telemetry": ("return (1.0, 0.0, 0.0), {'a': 1e999}", "returned a inf: every number must be finite", 8),
}


@pytest.mark.parametrize("kind", FAILURES)
def test_failures_name_vehicle_tick_and_line(
    kind: str, module: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    line, words, number = FAILURES[kind]
    name = module(failing(20, line))
    aborted = run(scenario(f"controller={name}:Law"), tmp_path)
    assert aborted.status is Status.BROKEN
    assert aborted.reason.startswith("agent 2, tick 20: ")
    assert words in aborted.reason
    assert aborted.reason.endswith(f"({name}.py:{number})")
    coasting = run(scenario(f"controller={name}:Law", "on_controller_error=coast"), tmp_path)
    assert coasting.status is Status.PASS
    (note,) = coasting.values["notes"]
    assert note.startswith("t = 0.20 s (tick 20) agent 2: ")
    assert words in note
    assert "the vehicle coasts" in note
    with (coasting.directory / "run.mcap").open("rb") as file:
        messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["uuv/2/command"])
        tau = [m.tau[0] for *_, m in messages]
    assert tau == [1.0] * 20 + [0.0] * 30


@pytest.mark.parametrize("policy", ["abort", "coast"])
def test_failures_in_processes(policy: str, module: Callable[[str], str], tmp_path: Path) -> None:
    """Distributed as in one process: the same message, and with coast the same bytes."""
    s = scenario(f"controller={module(failing(20, '1 / 0'))}:Law", f"on_controller_error={policy}")
    result = run(s, tmp_path, in_process=False)
    said = "\n".join([result.reason, *result.lines, *result.values["notes"]])
    assert "agent 2" in said
    assert "Law raised ZeroDivisionError" in said
    assert ".py:10" in said
    if policy == "abort":
        assert result.status is Status.BROKEN
    else:
        alone = run(s, tmp_path)
        assert (result.directory / "run.mcap").read_bytes() == (alone.directory / "run.mcap").read_bytes()


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


@pytest.mark.parametrize("line", ["time.sleep(30)", "while True: pass"])
def test_a_law_over_its_budget(line: str, module: Callable[[str], str], tmp_path: Path) -> None:
    """Also one that would never return: the message has the line at which it was."""
    s = scenario(f"controller={module(failing(20, line))}:Law", "controller_budget=200 ms")
    for in_process in (True, False):
        result = run(s, tmp_path, in_process=in_process)
        said = "\n".join([result.reason, *result.lines])
        assert result.status is Status.BROKEN
        assert "agent 2, tick 20: Law took longer than its budget of 200 ms" in said
        assert ".py:10" in said


def test_a_law_that_cannot_be_made(module: Callable[[str], str], tmp_path: Path) -> None:
    code = GOOD.replace("self.force, self.count = force, 0", "raise ValueError('no such sea')")
    name = module(code)
    alone = run(scenario(f"controller={name}:Law"), tmp_path)
    assert "Law raised ValueError: no such sea" in alone.reason
    result = run(scenario(f"controller={name}:Law"), tmp_path, in_process=False)
    assert "no such sea" in "\n".join([result.reason, *result.lines])


# --- the other kinds -------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_templates_run(kind: str, tmp_path: Path) -> None:
    """What `fleet new` writes runs as it is, does what its check asks, and is resumable."""
    name = f"my_{kind}_law"
    arguments = ["new", "controller", name, "--kind", kind, "--dir", str(tmp_path / "laws")]
    assert CliRunner().invoke(cli, arguments, catch_exceptions=False).exit_code == 0
    again = CliRunner().invoke(cli, arguments)
    assert again.exit_code == 2
    assert "is there already" in again.output
    s = load_scenario(str(tmp_path / "laws" / f"{name}.yaml"), ["log.every=100 ticks"])
    result = run(s, tmp_path)
    assert result.status is Status.PASS, (result.reason, result.verdicts)
    with (result.directory / "run.mcap").open("rb") as file:
        assert next(iter(make_reader(file).iter_metadata())).metadata["resumable"] == "yes"


def test_a_whole_agent_sends_what_it_likes(tmp_path: Path) -> None:
    """Its payload is its own: twelve bytes here, which our codec would refuse. Distributed as in one process."""
    arguments = ["new", "controller", "whole_agent", "--kind", "agent", "--dir", str(tmp_path)]
    assert CliRunner().invoke(cli, arguments, catch_exceptions=False).exit_code == 0
    s = load_scenario(str(tmp_path / "whole_agent.yaml"), ["duration=1 s", "checks={}"])
    alone, result = run(s, tmp_path), run(s, tmp_path, in_process=False)
    assert (result.directory / "run.mcap").read_bytes() == (alone.directory / "run.mcap").read_bytes()
    with (alone.directory / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert {len(m.payload) for *_, m in reader.iter_decoded_messages(["link/1-2"])} == {12}
        topics = {channel.topic for channel in reader.get_summary().channels.values()}  # type: ignore[union-attr]
    assert "uuv/1/control" in topics
    assert "uuv/1/guidance" not in topics


@pytest.mark.parametrize(
    ("body", "words"),
    [("return ['text']", "expected a list of bytes"), ("return [b'x' * 50_000]", "at most 40000 fit into a round")],
)
def test_a_whole_agent_with_bad_payloads(body: str, words: str, module: Callable[[str], str], tmp_path: Path) -> None:
    name = module(f"""\
        class Law:
            signals = ()
            def __init__(self, config): pass
            def transmit(self, nav): {body}
            def decide(self, nav, deliveries): return (0.0, 0.0, 0.0), {{}}
    """)
    result = run(scenario(f"agent={name}:Law"), tmp_path)
    assert words in result.reason
    assert result.reason.startswith("agent 1, tick 0: Law returned ")


@pytest.mark.parametrize("name", ["3d", "a-b", "class", "", "ü"])
def test_a_template_needs_a_module_name(name: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["new", "controller", name, "--dir", str(tmp_path)])
    assert result.exit_code == 2
    assert "cannot name a Python module" in result.output
    assert not os.listdir(tmp_path)


# --- the worked example ----------------------------------------------------


def test_the_worked_example_against_nboc(tmp_path: Path) -> None:
    """The table in docs/plugins.md."""
    example = str(ROOT / "docs" / "examples" / "leader_follower.yaml")
    rows = {}
    for label, choice in (("leader-follower", []), ("NBOC", ["controller=nboc"])):
        result = run(load_scenario(example, [*choice, "log.every=5 ticks"]), tmp_path)
        assert result.status is Status.PASS, result.verdicts
        rows[label] = list(result.values["vehicles"].values())
    page = (ROOT / "docs" / "plugins.md").read_text("utf-8")
    for label, vehicles in rows.items():
        (line,) = [text for text in page.splitlines() if text.startswith(f"| {label} |")]
        settle, rms, effort = ([float(x) for x in cell.split()] for cell in line.split("|")[2:5])
        assert [row["settle_10pct_s"] for row in vehicles] == pytest.approx(settle, abs=0.11)
        assert [row["e_rms_m"] for row in vehicles] == pytest.approx(rms, abs=0.001)
        assert [row["effort_Ns"] for row in vehicles] == pytest.approx(effort, abs=1.0)
    assert all(a["e_rms_m"] > b["e_rms_m"] for a, b in zip(*rows.values(), strict=True))


def test_the_worked_example_is_short() -> None:
    """The page promises some thirty lines."""
    plugins.load("controller", Law("leader_follower:LeaderFollower"))
    import leader_follower

    source = inspect.getsource(leader_follower.LeaderFollower.step)
    assert len([line for line in source.splitlines() if line.strip() and not line.strip().startswith("#")]) <= 30
