"""A wheel with compiled cores: the same bytes as plain Python, and what a user may do with his laws stays possible."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import venv
import zipfile
from pathlib import Path

import pytest
import spawned
from repository import ROOT
from shared import alone

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.scenario.loading import load_scenario

pytestmark = pytest.mark.timeout(900)
COPIED = (".packaging", "agents", "fleet", "netem", "world", "pyproject.toml", "README.md", "LICENSE", "NOTICE")
# Tests of modules that are not compiled: they say the same there as on the sources.
PLAIN = (
    "agents/test_own_samples.py", "agents/test_trust.py", "netem/test_acoustic.py", "netem/test_correlation.py",
    "netem/test_fading.py", "netem/test_grammar.py", "netem/test_private_file.py", "netem/test_propagation.py",
    "netem/wire/test_refusals.py", "netem/wire/test_certificate_router.py", "netem/wire/test_messages.py",
    "world/navigation/test_leaks.py", "world/plants/test_bluerov2.py", "world/plants/test_remus100.py",
)  # fmt: skip
# A law that fails at a tick, so that the line of its file has to be told.
FAILING = """\
class Failing:
    signals = ()

    def __init__(self, config):
        pass

    def step(self, sample):
        if sample.tick == 20:
            raise RuntimeError("enough")
        return (1.0, 0.0, 0.0), {}
"""


# A law as one writes it who does not think of types: numpy arrays and lists where we have tuples, and a subclass.
LOOSE = """\
import numpy as np
from agents.api import Signal, earth_velocity, wrap


class Base:
    signals = (Signal("speed", "m/s", "speed over ground"),)

    def __init__(self, config, gain=1):
        self.config, self.gain = config, gain


class Loose(Base):
    def step(self, sample):
        velocity = np.array(earth_velocity(np.array(sample.eta), list(sample.nu)))
        assert np.array_equal(velocity, sample.velocity)
        e = np.array(sample.desired.position) - sample.eta[:3]
        turn = wrap(np.arctan2(e[1], e[0]) - sample.eta[4])
        return np.array([self.gain, 0, turn]), {"speed": np.linalg.norm(velocity)}
"""
DEBUGGED = """\
class Debugged:
    signals = ()

    def __init__(self, config):
        self.config = config

    def step(self, sample):
        if (self.config.id, sample.tick) == (2, 7):
            breakpoint()
        return (1.0, 0.0, 0.0), {}
"""


def build(tmp_path: Path, python: Path, modules: str = "", **environment: str) -> tuple[Path, str]:
    """A folder with the content of a wheel that was built from a copy of the sources, and what was said meanwhile.

    Args:
        python: whose pip builds it.
        modules: that are compiled in place of all that should be.
    """
    sources = tmp_path / "sources"
    sources.mkdir(parents=True)
    for name in COPIED:
        place = ROOT / name
        if place.is_dir():
            shutil.copytree(place, sources / name, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
        else:
            shutil.copy(place, sources)
    if modules:
        backend = sources / ".packaging" / "build_backend.py"
        text, found = re.subn(
            r"^MODULES = \(.*?^\)", f"MODULES = ({modules!r},)", backend.read_text(), flags=re.M | re.S
        )
        assert found == 1
        backend.write_text(text)
    ours = {key: value for key, value in os.environ.items() if key != "UUV_FLEET_COMPILE"}
    done = subprocess.run(
        [python, "-m", "pip", "wheel", "-v", "--no-deps", "-w", str(tmp_path), str(sources)],
        env=ours | {"PIP_NO_COMPILE": "1"} | environment,
        check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=850,
    )  # fmt: skip
    assert sorted(path.name for path in sources.iterdir() if path.suffix != ".egg-info") == sorted(COPIED)
    (wheel,) = tmp_path.glob("*.whl")
    part, unpacked = tmp_path / "part", tmp_path / "unpacked"
    with zipfile.ZipFile(wheel) as file:
        file.extractall(part)
    return part.rename(unpacked), done.stdout


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a new environment, as a user has one: where msgspec is installed already, mypy would see it during a build."""
    with alone(tmp_path_factory, "bare") as bare:
        if not bare.is_dir():
            venv.create(bare, with_pip=True)
    return bare / "bin" / "python"


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory, python: Path) -> Path:
    """Built as an ordinary install builds it."""
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    with alone(tmp_path_factory, "compiled") as made:
        return made / "unpacked" if (made / "unpacked").is_dir() else build(made, python)[0]


def fleet(packages: Path, *arguments: str, folder: Path, typed: str = "") -> subprocess.CompletedProcess[str]:
    paths = {"PYTHONPATH": f"{packages}{os.pathsep}{folder}"}
    return spawned.fleet(*arguments, input=typed, environment=paths, cwd=folder)


def test_it_says_that_it_is_compiled(compiled: Path, tmp_path: Path) -> None:
    assert fleet(compiled, "--version", folder=tmp_path).stdout.endswith("cores: compiled\n")
    assert list(compiled.glob("world/dynamics.*.so")) and (compiled / "world" / "dynamics.py").is_file()


def test_it_brings_what_programs_of_others_need(compiled: Path) -> None:
    folder = compiled / "fleet/addons/programs/preload"
    assert (folder / "libfleet_preload.so").is_file() and (folder / "fleet_launch").is_file()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, ["--in-process"]) for name in ("paper", "rough-sea", "nemesis", "acoustic-80bps", "kill-restart")),
        ("rough-sea", []),  # distributed
        ("nemesis", []),
    ],
)
def test_the_same_bytes_as_plain_python(name: str, options: list[str], compiled: Path, tmp_path: Path) -> None:
    changes = ["duration=20 s", "checks={}"]
    sets = [word for change in changes for word in ("--set", change)]
    result = fleet(compiled, "run", name, *sets, *options, "-q", "--out", str(tmp_path / "c"), folder=tmp_path)
    assert result.returncode == 0, result.stderr
    plain = execute(load_scenario(name, changes), Options(tmp_path / "p", in_process=True, quiet=True))
    directory = Path(result.stdout.strip())
    assert (directory / "run.mcap").read_bytes() == (plain.directory / "run.mcap").read_bytes()
    assert '"cores": "compiled"' in (directory / "result.json").read_text()


def test_a_run_of_one_goes_on_in_the_other(compiled: Path, tmp_path: Path) -> None:
    changes = ["duration=10 s", "checks={}"]
    whole = execute(load_scenario("rough-sea", changes), Options(tmp_path / "p", in_process=True, quiet=True))
    result = fleet(compiled, "verify", str(whole.directory), folder=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    begin = f"{whole.directory}@5s"
    result = fleet(compiled, "run", "--from", begin, "-q", "--out", str(tmp_path / "c"), folder=tmp_path)
    assert result.returncode == 0, result.stderr
    result = fleet(compiled, "diff", str(whole.directory), result.stdout.strip(), folder=tmp_path)
    assert result.returncode == 0 and "the same bit for bit" in result.stdout


def test_a_law_of_the_user_runs_and_its_failure_names_the_line(compiled: Path, tmp_path: Path) -> None:
    made = fleet(compiled, "new", "controller", "mine", folder=tmp_path)
    assert made.returncode == 0, made.stderr
    result = fleet(compiled, "run", "mine.yaml", "--in-process", "-q", "--trust", folder=tmp_path)
    assert result.returncode == 0, result.stderr
    (tmp_path / "failing.py").write_text(FAILING)
    options = ["--set", "controller=failing:Failing", "--in-process", "-q", "--trust"]
    result = fleet(compiled, "run", "paper", *options, folder=tmp_path)
    assert result.returncode == 3 and "Traceback" not in result.stderr
    assert re.search(r"failing\.py[^\n]*(line |:)9", result.stderr), result.stderr


def test_an_agent_of_the_user_runs(compiled: Path, tmp_path: Path) -> None:
    made = fleet(compiled, "new", "controller", "whole", "--kind", "agent", folder=tmp_path)
    assert made.returncode == 0, made.stderr
    result = fleet(compiled, "run", "whole.yaml", "--in-process", "-q", "--trust", folder=tmp_path)
    assert result.returncode == 0, result.stderr


def test_a_law_may_use_and_return_any_sequence(compiled: Path, tmp_path: Path) -> None:
    """Compiled code checks types; what a user's code gives to the interface is not held to them."""
    (tmp_path / "loose.py").write_text(LOOSE)
    law = "controller={law: 'loose:Loose', parameters: {gain: 2}}"
    options = ["--set", law, "--set", "duration=1 s", "--set", "checks={}", "--in-process", "-q", "--trust"]
    result = fleet(compiled, "run", "paper", *options, folder=tmp_path)
    assert result.returncode == 0, result.stderr
    result = fleet(compiled, "verify", result.stdout.strip(), "--trust", folder=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr


def test_a_law_can_be_debugged(compiled: Path, tmp_path: Path) -> None:
    (tmp_path / "debugged.py").write_text(DEBUGGED)
    options = ["--set", "controller=debugged:Debugged", "--in-process", "--quiet", "--trust"]
    result = fleet(compiled, "run", "paper", *options, folder=tmp_path, typed="p sample.tick, sample.eta[0]\nw\nq\n")
    said = result.stderr  # stdout is for the run's directory alone
    assert re.search(r"\(7, -0\.99\d+\)", said) and re.search(r"debugged\.py\((9|10)\)step\(\)", said), said
    assert "Traceback" not in said


def test_a_traceback_of_compiled_code_names_file_and_line(compiled: Path, tmp_path: Path) -> None:
    code = "from world.sea import World; World(None)"
    result = spawned.python("-c", code, environment={"PYTHONPATH": str(compiled)}, cwd=tmp_path)
    place = re.search(r'File "world/sea\.py", line (\d+), in __init__', result.stderr)
    assert place is not None, result.stderr
    assert (compiled / "world" / "sea.py").read_text().splitlines()[int(place[1]) - 1].strip()


def test_what_cannot_be_loaded_here_is_told_in_a_line(compiled: Path, tmp_path: Path) -> None:
    """As a wheel that was built with a newer C library."""
    other = tmp_path / "other"
    shutil.copytree(compiled, other)
    (library,) = other.glob("*__mypyc.*.so")
    library.write_bytes(b"of another machine")
    result = fleet(other, "check", "paper", folder=tmp_path)
    assert (result.returncode, len(result.stderr.splitlines())) == (3, 1), result.stderr
    assert result.stderr.startswith(f"fleet: the compiled cores cannot be loaded: {library}: ")
    assert "install uuv-fleet here, or with UUV_FLEET_COMPILE=no" in result.stderr


def test_the_tests_of_the_cores_pass(compiled: Path, tmp_path: Path) -> None:
    """The same tests on compiled modules, which must be found there and not in the sources.

    Laws get fewer examples: what is asked here is whether compiled code does the same, not whether the laws hold.
    """
    for name in ("tests", "docs", "pyproject.toml"):
        place = ROOT / name
        if place.is_dir():
            shutil.copytree(place, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__", "_build"))
        else:
            shutil.copy(place, tmp_path)
    for room in ("agents", "fleet", "netem", "world"):
        (tmp_path / room).symlink_to(compiled / room)
    rooms = ["tests/agents", "tests/netem", "tests/world", *(f"--ignore=tests/{name}" for name in PLAIN)]
    # The builds of PIQP are not ours: a hundred thousand problems for each are enough once.
    rooms += ["--deselect=tests/agents/test_gain_qp.py::test_every_build_of_the_solver_agrees_with_the_formula"]
    assert all((tmp_path / "tests" / name).is_file() for name in PLAIN)
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--hypothesis-profile=few", *rooms]
    result = spawned.python(*words, environment={"PYTHONPATH": str(compiled)}, cwd=tmp_path, timeout=850)
    assert result.returncode == 0, result.stdout[-3000:]


@pytest.mark.parametrize(
    ("environment", "said"),
    [
        ({"UUV_FLEET_COMPILE": "no"}, "UUV_FLEET_COMPILE=no"),
        ({"CC": "no-such-compiler"}, "there is no C compiler (no-such-compiler)"),
        ({"CC": "false"}, "'false'"),
    ],
)
def test_without_a_compiler_it_is_plain_python(
    environment: dict[str, str], said: str, python: Path, tmp_path: Path
) -> None:
    """Or without the wish for it; one line says so. One that fails does so at the first module: one is enough."""
    unpacked, output = build(tmp_path, python, "netem/draws.py", **environment)
    lines = [line for line in output.splitlines() if "the cores are not compiled and run as plain Python" in line]
    assert len(lines) == 1 and said in lines[0], output
    assert not list(unpacked.rglob("*.so"))
    told = fleet(unpacked, "--version", folder=tmp_path).stdout
    assert re.search(r"cores: plain Python \(at the installation: .*\)\n$", told) and said in told
