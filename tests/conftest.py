"""What holds for all tests."""

import gc
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from kinds import FAST, NIGHTLY, NOT_FAST, ONCE, extra_of, without_packages
from repository import ROOT
from samples import take_all
from stretches import dealt

# The package `benchmarks`. At the end, since an installed `fleet` comes first, which may be compiled.
sys.path.append(str(ROOT))

LEFT_OUT = without_packages()
pytest_plugins = ["in_process_runs", "coarse_pictures"]

# Some containers set it: each of the hundreds of processes, and pytest itself, would compile everything again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# As in `fleet` itself: each worker's numpy would have a thread per core, and these spin while others compute. It counts
# for the numpy that is imported after it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell starts a command in the background with interrupts ignored, and the tests interrupt what they start.
signal.signal(signal.SIGINT, signal.default_int_handler)
# `nohup` has hang-ups ignored. With a handler they still do nothing here, and what the tests start begins without it.
if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda *_: None)

# Property tests are about laws, not about how fast the machine is that checks them.
settings.register_profile(
    "laws", deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True, max_examples=25
)
settings.register_profile("many", settings.get_profile("laws"), max_examples=200)
settings.register_profile("few", settings.get_profile("laws"), max_examples=15)  # --hypothesis-profile=few


def pytest_configure(config: pytest.Config) -> None:
    """Draw the same examples in each run, and 200 per law with `-m ''`; `--hypothesis-seed` draws new ones."""
    take_all(not config.option.markexpr)
    profile = config.option.hypothesis_profile or ("laws" if config.option.markexpr else "many")
    settings.register_profile("drawn", settings.get_profile(profile), derandomize=config.option.hypothesis_seed is None)
    settings.load_profile("drawn")


@pytest.fixture(scope="session", autouse=True)
def own_registry(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Runs of tests are registered and remembered in a place of their own: the user's are not seen, nor added to."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """Thousands of tests live to the end, so the garbage collector visits them neither while they are made nor ever."""
    from fleet.__main__ import COLLECT_EVERY  # not at the top: the number of numpy's threads is set there

    gc.disable()
    chosen = session.config.getoption("ignore") or session.config.getoption("ignore_glob")
    if not chosen:  # pytest takes a file that is named, even if it is to be ignored
        session.config.args = rotated(session.config.args)
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.set_threshold(COLLECT_EVERY)
        gc.enable()


def rotated(places: list[str]) -> list[str]:
    """The files of all tests, from another one on for each worker.

    In a clean checkout they are compiled, which takes longer than all else before the first test. So each worker
    compiles its share.
    """
    if places != ["tests"] or "PYTEST_XDIST_WORKER" not in os.environ:
        return places
    files = sorted(str(file) for file in Path("tests").rglob("test_*.py") if extra_of(file.as_posix()) not in LEFT_OUT)
    worker = int(os.environ["PYTEST_XDIST_WORKER"].removeprefix("gw"))
    first = len(files) * worker // int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    return files[first:] + files[:first]


def place_of(path: Path) -> str:
    """A file's place in the repository."""
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else ""


def pytest_runtest_setup() -> None:
    """A pool of processes sets this variable for its children. Programs that a later test starts would not find what
    lies in their own folder."""
    os.environ.pop("PYTHONSAFEPATH", None)


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave out the tests of an extra that is not installed; the summary names it."""
    return True if extra_of(place_of(collection_path)) in LEFT_OUT else None


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say which extras were not tested."""
    for name, package in LEFT_OUT.items():
        terminalreporter.write_line(f"NOT TESTED: the extra [{name}], since {package} is not installed: '.[test-all]'")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> Iterator[None]:
    """Give each test the mark of its file, and each worker its share of those that may take longer."""
    items.sort(key=lambda item: item.path.parts)  # as pytest orders them, wherever this worker began
    for item in items:
        place = place_of(item.path)
        if place.startswith(ONCE):
            item.add_marker("once")
        elif place.startswith(NIGHTLY):
            item.add_marker("slow")
        elif extra_of(place):
            item.add_marker("extra")
        elif place.startswith(FAST) and place not in NOT_FAST and not [*item.iter_markers("slow")]:
            item.add_marker("fast")
    yield  # some are left out
    items.sort(key=limit, reverse=True)
    items[:] = dealt(items, group, int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))


def limit(item: pytest.Item) -> float:
    """The time limit that a test has of its own [s]; 0: none. Who has a longer one is expected to take longer."""
    mark = item.get_closest_marker("timeout")
    return mark.args[0] if mark else 0.0


def group(item: pytest.Item) -> object:
    """What a test with a limit stays with: itself, or its file if the limit is that of the file; None: no limit."""
    if not limit(item):
        return None
    return item if any(mark.name == "timeout" for mark in item.own_markers) else item.path


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Several workers (`-n`) get whole stretches of the tests, so that those of a module share what they set up."""
    if getattr(config.option, "numprocesses", None) and config.option.dist in ("no", "load"):
        config.option.dist = "worksteal"
