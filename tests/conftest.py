"""What holds for all tests."""

import gc
import os
import signal
import sys
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings
from repository import ROOT

# The package `benchmarks`. At the end, since an installed `fleet` comes first, which may be compiled.
sys.path.append(str(ROOT))

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


def pytest_collection_finish() -> None:
    """Thousands of tests live to the end, so the garbage collector need not visit them again and again."""
    gc.freeze()
    gc.set_threshold(200_000)  # as in `fleet`


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that may take longer than others begin first, or several workers would wait for one at the end."""
    items.sort(key=lambda item: item.get_closest_marker("timeout") is None)


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Several workers (`-n`) get whole stretches of the tests, so that those of a module share what they set up."""
    if getattr(config.option, "numprocesses", None) and config.option.dist in ("no", "load"):
        config.option.dist = "worksteal"
