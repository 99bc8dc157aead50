"""What strangers name does not run: logs, scenarios, runs, and what lies about in the current directory."""

from __future__ import annotations

import ast
import hashlib
import os
import random
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import dedent

import pytest
from marks import slow
from repository import MODULES, ROOT, tree
from spawned import python
from tool import invoke

import fleet
from agents.config import Law
from agents.join import _admit
from agents.join_file import JoinError
from agents.plugins import laws
from fleet.addons.studies.failures import FailureFolder, FoundFailure
from fleet.errors import ScenarioError
from fleet.scenario.loading import load_scenario
from world.errors import PluginError
from world.plugins import loading, trust
from world.plugins.trust import Permission, Trust

# A law of every kind; whoever imports it leaves a mark beside it.
LAWS = """
from pathlib import Path
from agents.api import Signal
Path(__file__).with_suffix(".mark").touch()

class Base:
    signals = (Signal("a", "1", "nothing"),)
    def __init__(self, config): pass
    def state(self): return None
    def restore(self, values): pass

class Main(Base):
    def step(self, sample): return (1.0, 0.0, 0.0), {"a": 0.0}

class Guide(Base):
    def step(self, sample): return (0.5, 0.0, 0.0), {"a": 0.0}

class Track(Base):
    def step(self, sample, command): return (1.0, 0.0, 0.0), {"a": 0.0}

class Whole(Base):
    def transmit(self, nav): return []
    def decide(self, nav, deliveries): return (1.0, 0.0, 0.0), {"a": 0.0}
"""
SCENARIO = """\
title: Laws of every kind
vehicles: 4
duration: 1 s
reference: {{start: 5 1 5 m, velocity: 0.7 0.1 0 m/s}}
initial: {{scatter: 1 m, surge: 0.1 m/s}}
formation: {{shape: grid, spacing: 10 m}}
graph: {{shape: path}}
network: {{period: 100 ms}}
log: {{snapshot: 500 ms}}
controller: {0}:Main
per_vehicle:
  "2": {{guidance: "{0}:Guide", tracking: neurodynamic, controller: nboc}}
  "3": {{tracking: "{0}:Track", guidance: optimal, controller: nboc}}
  "4": {{agent: "{0}:Whole"}}
"""


@contextmanager
def as_at_the_start() -> Iterator[pytest.MonkeyPatch]:
    """Nothing was allowed, and nothing of a user's was imported."""
    before = set(sys.modules)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", sys.path.copy())
        patch.setattr(trust, "_added", [])
        patch.setattr(trust, "_allowed", set())
        patch.setattr(trust, "_own", {})
        yield patch
    for name in set(sys.modules) - before:
        if name.startswith(("deploy_", "pack_")):
            del sys.modules[name]


@pytest.fixture(autouse=True)
def fresh() -> Iterator[None]:
    with as_at_the_start():
        yield


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A stranger's log, and the module that it names."""
    folder = tmp_path_factory.mktemp("stranger")
    name = write_laws(folder)
    (folder / "s.yaml").write_text(SCENARIO.format(name))
    with as_at_the_start() as patch:
        patch.chdir(folder)
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        ran = invoke("run", "s.yaml", "--in-process", "-q")
    assert ran.exit_code == 0, ran.output
    return (folder / "runs" / "latest").resolve() / "run.mcap", name


def write_laws(folder: Path, name: str = "") -> str:
    name = name or f"deploy_{random.getrandbits(40)}"
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.py").write_text(LAWS)
    return name


@pytest.fixture
def victim(recorded: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, Path, str]:
    """Log, mark and module of somebody in whose current directory a module has the name that the log says."""
    monkeypatch.chdir(tmp_path)
    log, name = recorded
    write_laws(tmp_path, name)
    return str(log), tmp_path / f"{name}.mark", name


def assert_refused(words: str, *arguments: object) -> None:
    found = invoke(*arguments)
    assert found.exit_code == 2 and words in found.stderr, found.output


# --- reading -----------------------------------------------------------------

READING = (
    ["plot", "LOG", "--what", "formation,guidance.K", "-o", "plots"],
    ["report", "LOG", "-o", "page.html"],
    ["export", "LOG", "--scenario"],
    ["export", "LOG", "--csv", "tables"],
    ["info", "LOG"],
    ["diff", "LOG", "LOG"],
    ["recover", "LOG", "-o", "clean.mcap"],
)


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("where", ["here", *slow("installed")])
def test_reading_runs_nothing(where: str, victim: tuple[str, Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """All that a reader shows stands in the log, the signals of laws that it never sees, too."""
    log, mark, name = victim
    monkeypatch.setattr("fleet.addons.pictures.report.WHAT", {"formation": ()})  # `plot` draws more of the same
    if where == "installed":
        monkeypatch.syspath_prepend(str(mark.parent / "site"))
        write_laws(mark.parent / "site", name)
    for arguments in READING:
        found = invoke(*(argument.replace("LOG", log) for argument in arguments))
        assert found.exit_code == 0, found.output
        assert not list(mark.parent.rglob("*.mark")), arguments
        assert name not in sys.modules, arguments
        if "--scenario" in arguments:
            assert f'controller: "{name}:Main"' in found.stdout


def test_open_log_and_pictures_run_nothing(victim: tuple[str, Path, str]) -> None:
    from fleet.addons.pictures.runs import load

    log, mark, name = victim
    found = fleet.open_log(log)
    assert found.scenario.controls[0].controller == Law(f"{name}:Main")
    assert found["uuv/1/control"].a.shape == (100,)
    (run,) = load([Path(log)])
    assert run.scenario is not None and not run.notes  # limits and bounds are there without the law
    assert not mark.exists()


@pytest.mark.slow
def test_a_matplotlibrc_that_lies_about_does_not_count(victim: tuple[str, Path, str]) -> None:
    """It could have LaTeX run over the names in a log, and no picture would repeat."""
    log, mark, _ = victim
    (mark.parent / "matplotlibrc").write_text("text.usetex: True\n")
    drawn = python("-P", "-m", "fleet", "plot", log, "--what", "error", "-o", "plots")
    assert drawn.returncode == 0, drawn.stderr


def test_replay_knows_no_scenario() -> None:
    """It cannot import what a scenario names if it cannot read one; so do the commands that look at a running one."""
    code = (
        "import sys, fleet.cli.main, fleet.cli.replay, fleet.replay.playback, fleet.replay.player, "
        "fleet.replay.capture, fleet.logs.info, fleet.execution.connection, fleet.mcap.recover, fleet.logs.deviation; "
        "sys.exit('fleet.scenario.scenario' in sys.modules)"
    )
    assert python("-P", "-c", code).returncode == 0


def test_nothing_is_unpickled() -> None:
    """Wire messages are MessagePack, results and join files JSON, scenarios YAML events: plain values."""
    unsafe = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}
    found, run = set(), set()
    words = re.compile(rf"\b({'|'.join(unsafe)}|(eval|exec)\s*\()")  # only their modules take time
    for file in (file for file in MODULES if words.search(file.read_text("utf-8"))):
        for node in ast.walk(tree(file)):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                run |= {(str(file.relative_to(ROOT)), name) for name in ("eval", "exec") if node.func.id == name}
            found |= {(str(file.relative_to(ROOT)), name) for name in unsafe.intersection(names)}
    assert found == {
        # Its pipes join this process with its own children, and have no name that others could open.
        ("fleet/processes/workers.py", "pickle"),
        ("fleet/processes/apart.py", "pickle"),
    }
    assert run == set()


# --- running what a log names ----------------------------------------------

RUNNING = (["verify", "LOG"], ["whatif", "LOG", "--agent", "1"], ["run", "--from", "LOG@500ms", "-q", "--out", "again"])


def test_why_runs_no_module_of_mine_unasked(victim: tuple[str, Path, str]) -> None:
    log, mark, name = victim
    assert_refused(f"would run {name}.py, which is not installed, and a log names it", "why", log)
    assert not mark.exists()
    assert "no check failed" in " ".join(invoke("why", log, "--trust").stderr.split())


@pytest.mark.parametrize("arguments", RUNNING, ids=lambda arguments: " ".join(arguments[::2]))
def test_a_log_runs_no_module_of_mine_unasked(arguments: list[str], victim: tuple[str, Path, str]) -> None:
    log, mark, name = victim
    given = [argument.replace("LOG", str(log)) for argument in arguments]
    refused = invoke(*given)
    assert refused.exit_code == 2
    assert f"would run {name}.py, which is not installed, and a log names it" in refused.stderr
    assert "--trust runs it" in refused.stderr
    assert not mark.exists()
    trusted = invoke(given[0], "--trust", *given[1:])
    assert trusted.exit_code == 0, trusted.output
    assert f"runs {name}.py, as --trust allows" in trusted.stderr
    assert mark.exists()


def test_trust_ends_with_what_it_was_given_to(tmp_path: Path) -> None:
    """With the command, or with the block; and whoever trusts nothing changes nothing."""
    names = [write_laws(tmp_path) for _ in range(3)]
    permission = Permission(elsewhere=(tmp_path,))
    with trust.trusting(True), trust.trusting(False):
        loading.admit("controller", f"{names[0]}:Main", permission)
    with pytest.raises(PluginError, match="would run"):
        loading.admit("controller", f"{names[1]}:Main", permission)
    with pytest.raises(PluginError, match="would run"), trust.trusting(True), trust.trusting(Trust()):
        loading.admit("controller", f"{names[2]}:Main", permission)


def test_the_fingerprint_in_the_log_is_no_permission(victim: tuple[str, Path, str]) -> None:
    """It is that of the file here, to the last bit, but a stranger wrote it there."""
    log, mark, name = victim
    run = fleet.open_log(log).run
    assert run[f"law {name}:Main"] == f"sha256 {hashlib.sha256(mark.with_suffix('.py').read_bytes()).hexdigest()}"
    assert invoke("verify", log).exit_code == 2
    assert not mark.exists()


def test_what_does_not_run_needs_no_trust(victim: tuple[str, Path, str]) -> None:
    """Another law in place of the log's; and one of mine, which I name, lets in no other that lies beside it."""
    log, mark, _ = victim
    assert invoke("whatif", log, "--agent", "1", "--controller", "boc").exit_code == 0
    mine = write_laws(mark.parent)
    assert invoke("whatif", log, "--agent", "1", "--controller", f"{mine}:Main").exit_code == 0
    assert (mark.parent / f"{mine}.mark").exists()
    assert_refused("per_vehicle.2.guidance.law", "run", "--from", log, "--set", f"controller={mine}:Main", "-q")
    assert not mark.exists()


def test_installed_laws_run(victim: tuple[str, Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    log, mark, name = victim
    mark.with_suffix(".py").unlink()
    assert_refused(f"there is no module '{name}'", "verify", log)
    monkeypatch.syspath_prepend(str(mark.parent / "site"))
    write_laws(mark.parent / "site", name)
    assert invoke("verify", log).exit_code == 0


def test_a_folder_in_which_python_began_is_no_place_of_installed_modules(
    victim: tuple[str, Path, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`python -m fleet` finds modules there before all others; further behind, it is the user's word."""
    log, mark, _ = victim
    first, *others = sys.path
    monkeypatch.setattr(sys, "path", [str(mark.parent), first, *others])
    assert_refused("would run", "verify", log)
    assert not mark.exists()
    monkeypatch.setattr(sys, "path", [first, str(mark.parent), *others])
    assert invoke("verify", log).exit_code == 0
    assert mark.exists()


@pytest.mark.slow
def test_with_python_first_in_the_current_directory(victim: tuple[str, Path, str]) -> None:
    """The same of a process of its own."""
    log, mark, _ = victim
    refused = python("-m", "fleet", "verify", log)
    assert refused.returncode == 2 and "would run" in refused.stderr
    assert not mark.exists()


@pytest.mark.slow
def test_a_python_path_is_the_user_s_word(victim: tuple[str, Path, str]) -> None:
    log, mark, _ = victim
    ran = python("-P", "-m", "fleet", "verify", log, environment={"PYTHONPATH": str(mark.parent)})
    assert ran.returncode == 0, ran.stderr
    assert mark.exists()


# --- scenarios ---------------------------------------------------------------


def small(name: str) -> str:
    return SCENARIO.format(name).replace("1 s", "200 ms")


@pytest.mark.parametrize("folder", [".", "laws"])
def test_an_author_is_not_bothered(folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A scenario here, or in a folder below, with its laws beside it; a law here that I name."""
    monkeypatch.chdir(tmp_path)
    name = write_laws(tmp_path / folder)
    (tmp_path / folder / "mine.yaml").write_text(small(name))
    assert invoke("check", f"{folder}/mine.yaml").exit_code == 0
    assert invoke("run", f"{folder}/mine.yaml", "--in-process", "-q").exit_code == 0
    here = write_laws(tmp_path)
    typed = ["--set", f"controller={here}:Main", "--duration", "100 ms", "--set", "checks={}"]
    assert invoke("run", "paper", "--in-process", "-q", *typed).exit_code == 0


@pytest.mark.slow
def test_agents_get_what_was_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As processes of their own they find the same modules; from a stranger's folder with --trust, too."""
    monkeypatch.chdir(tmp_path)
    for folder, more in ((tmp_path / "laws", ["run"]), (tmp_path.parent / f"{tmp_path.name}-else", ["run", "--trust"])):
        name = write_laws(folder)
        (folder / "s.yaml").write_text(small(name))
        for start in (["-P", "-m"], ["-m"]):
            ran = python(*start, "fleet", *more, os.path.relpath(folder / "s.yaml"), "-q")
            assert ran.returncode == 0, ran.stderr


@pytest.mark.parametrize("where", ["beside it", "here"])
def test_a_scenario_from_elsewhere(where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It runs neither what it brings along nor what it finds here; `check` says what it has not checked."""
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
    monkeypatch.chdir(here)
    name = write_laws(there if where == "beside it" else here)
    (there / "s.yaml").write_text(small(name))
    for arguments in (["run", "-q"], ["protocol", "check", "--id", "1", "--scenario"]):
        words = "and the scenario that names it lies outside of the current directory"
        assert_refused(words, *arguments, "../there/s.yaml")
    checked = invoke("check", "../there/s.yaml")
    assert checked.exit_code == 0
    assert "valid as far as it was checked" in checked.stdout
    for key in ("controller", "per_vehicle.2.guidance", "per_vehicle.3.tracking", "per_vehicle.4.agent"):
        assert f": {key}.law: {name}:" in checked.stderr
    assert checked.stderr.count("warning: not checked: ") == 4
    assert invoke("run", "../there/s.yaml", "--show-config").exit_code == 0
    assert invoke("hosts", "acl", "../there/s.yaml", "--listen", "tcp/127.0.0.1:7447").exit_code == 0
    assert not list(tmp_path.rglob("*.mark"))
    assert invoke("check", "../there/s.yaml", "--trust").exit_code == 0
    assert list(tmp_path.rglob("*.mark"))


def test_a_scenario_below_may_name_what_lies_here_but_not_between(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the files of a folder of failures do."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a" / "b").mkdir(parents=True)
    for folder, runs in ((".", True), ("a", False)):
        name = write_laws(tmp_path / folder)
        (tmp_path / "a" / "b" / "s.yaml").write_text(small(name))
        assert (invoke("run", "a/b/s.yaml", "--in-process", "-q").exit_code == 0) == runs
        assert (tmp_path / folder / f"{name}.mark").exists() == runs


def test_a_folder_of_failures_names_laws_that_lie_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    name = write_laws(tmp_path)
    (tmp_path / "mine.yaml").write_text(small(name))
    scenario = load_scenario("mine.yaml")
    found = FoundFailure(file="mine.yaml", check="tumbled", seed=1, digest="", found="", from_seed=1, least=True,
                         version="", expected="pass")  # fmt: skip
    FailureFolder(tmp_path / "failures").add(found, scenario)
    kept = invoke("regress", "failures", "--workers", "1")
    assert kept.exit_code == 0, kept.output
    assert invoke("run", "failures/mine.yaml", "--in-process", "-q").exit_code == 0


def test_a_user_without_a_home_runs_own_laws_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container with a number for a user: nothing is remembered, so the log is nobody's."""

    def nobody(_: Path) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(Path, "expanduser", nobody)
    name = write_laws(tmp_path)
    (tmp_path / "mine.yaml").write_text(small(name))
    assert invoke("run", "mine.yaml", "--in-process", "-q").exit_code == 0
    monkeypatch.setattr(trust, "_allowed", set())
    monkeypatch.delitem(sys.modules, name)
    assert "a log names it" in invoke("verify", "runs/latest").stderr


def test_the_log_of_a_run_of_mine_is_mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Until it is with somebody else, or says something else."""
    monkeypatch.chdir(tmp_path)
    name = write_laws(tmp_path)
    (tmp_path / "mine.yaml").write_text(SCENARIO.format(name))
    assert invoke("run", "mine.yaml", "--in-process", "-q").exit_code == 0
    log = str((tmp_path / "runs" / "latest").resolve())
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for arguments in RUNNING:
        found = invoke(*(argument.replace("LOG", log) for argument in arguments))
        assert found.exit_code == 0, found.output
    assert "no check failed" in " ".join(invoke("why", log).stderr.split())
    (tmp_path / f"{name}.mark").unlink()
    monkeypatch.setattr(trust, "_allowed", set())
    monkeypatch.delitem(sys.modules, name)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "of somebody else"))
    assert "a log names it" in invoke("verify", log).stderr
    assert not (tmp_path / f"{name}.mark").exists()


def test_the_scenario_of_a_run_is_a_record(
    recorded: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever gets a run directory, with a module in it, has not written it."""
    log, name = recorded
    shutil.copytree(log.parent, tmp_path / "run")
    write_laws(tmp_path / "run", name)
    for gone in ("nothing", "run.mcap"):  # with log: none there is only the result
        (tmp_path / "run" / gone).unlink(missing_ok=True)
        for folder, file in ((tmp_path, "run/scenario.yaml"), (tmp_path / "run", "scenario.yaml")):
            monkeypatch.chdir(folder)
            assert_refused("is the record of a run", "run", file, "-q")
    assert not (tmp_path / "run" / f"{name}.mark").exists()


def test_a_folder_where_everybody_may_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In /tmp another user may have put the module."""
    monkeypatch.chdir(tmp_path)
    name = write_laws(tmp_path)
    (tmp_path / "s.yaml").write_text(small(name))
    tmp_path.chmod(0o1777)
    for arguments in (["s.yaml"], ["paper", "--set", f"controller={name}:Main"]):
        refused = invoke("check", *arguments)
        assert f"everybody may write into {tmp_path}" in refused.stderr
    assert not (tmp_path / f"{name}.mark").exists()


def test_what_new_prints_works_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    name = f"deploy_{random.getrandbits(40)}"
    told = invoke("new", "controller", name, "--dir", str(tmp_path / "my laws")).stdout
    assert told.rstrip().endswith(f"now: cd '{tmp_path}/my laws' && fleet run {name}.yaml")


# --- finding -----------------------------------------------------------------


@pytest.mark.parametrize("name", ["antigravity:Law", "this:Law", "ensurepip.__main__:Law", "pip.__main__:Law"])
def test_programs_and_python_itself_are_no_laws(name: str) -> None:
    """They are installed, and to import them does something."""
    module = name.partition(":")[0]
    with pytest.raises(PluginError, match="not a module with a plug-in"):
        laws.load("controller", Law(name))
    assert module not in sys.modules


def test_packages_are_found_without_running_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`importlib.util.find_spec("a.b")` would import `a`. A fingerprint must be of every file that runs."""
    monkeypatch.chdir(tmp_path)
    package = f"pack_{random.getrandbits(40)}"
    (tmp_path / package).mkdir()
    init = tmp_path / package / "__init__.py"
    init.write_text(dedent("from pathlib import Path; Path(__file__).with_suffix('.mark').touch()"))
    write_laws(tmp_path / package, "law")
    place = trust.find(f"{package}.law", [tmp_path])
    assert place == trust.ModulePlace(str(tmp_path), (str(init), str(tmp_path / package / "law.py")), False)
    sums = [hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in place.files]
    arguments = ("controller", f"{package}.law:Main")
    permission = Permission(elsewhere=(tmp_path,))
    with (
        pytest.raises(PluginError, match=f"would run {package}/__init__.py and {package}/law.py"),
        trust.trusting(Trust(fingerprints=frozenset(sums[1:]))),
    ):
        loading.admit(*arguments, permission)
    assert not list(tmp_path.rglob("*.mark"))
    with trust.trusting(Trust(fingerprints=frozenset(sums))):
        loading.admit(*arguments, permission)
    assert laws.load("controller", Law(f"{package}.law:Main")).__name__ == "Main"


def test_a_join_file_names_no_module_of_mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run somewhere else sends the agent its laws."""
    (tmp_path / "there").mkdir()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "there")
    name = write_laws(tmp_path / "there")
    (tmp_path / "there" / "s.yaml").write_text(small(name))
    config = load_scenario("s.yaml").agent_config(1)
    monkeypatch.setattr(trust, "_allowed", set())
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p != str(tmp_path / "there")])
    del sys.modules[name]
    monkeypatch.chdir(tmp_path / "here")
    write_laws(tmp_path / "here", name)
    with pytest.raises(JoinError, match=f"would run {name}.py, which is not installed, and the run names it"):
        _admit(config)
    assert not (tmp_path / "here" / f"{name}.mark").exists()
    with trust.trusting(True):
        _admit(config)
    assert laws.load("controller", Law(f"{name}:Main"))
    assert (tmp_path / "here" / f"{name}.mark").exists()


def test_the_children_take_nothing_from_the_current_directory(tmp_path: Path) -> None:
    """The forkserver is a `python -c`: it took any `selectors.py` that lay about for Python's own."""
    for name in ("selectors", "socket", "signal", "agents", "netem"):
        (tmp_path / f"{name}.py").write_text("from pathlib import Path; Path(__file__).with_suffix('.mark').touch()")
    ran = python(
        *["-P", "-m", "fleet", "run", "paper", "--set", "duration=200ms", "--set", "checks={}", "-q"], cwd=tmp_path
    )
    assert ran.returncode == 0, ran.stderr
    assert not list(tmp_path.glob("*.mark"))


def test_the_library_has_the_same_rules(tmp_path: Path) -> None:
    name = write_laws(tmp_path)
    (tmp_path / "s.yaml").write_text(small(name))
    with pytest.raises(ScenarioError, match="lies outside of the current directory"):
        load_scenario(tmp_path / "s.yaml")
    with pytest.raises(ScenarioError, match="lies outside of the current directory"):
        fleet.run(tmp_path / "s.yaml")
    assert fleet.run(tmp_path / "s.yaml", trust=True).passed
