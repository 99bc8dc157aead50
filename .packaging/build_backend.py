"""How the package is built: by setuptools, and on request with the hot modules compiled by mypyc.

The sources are the same, and so are the bytes that a run writes; compiled, the cores are faster. The environment
variable UUV_FLEET_COMPILE says whether: `no` (the default), `auto` (plain Python if it fails) or `yes` (it must work).
An editable install is never compiled, since what one changes there has to count.
"""

from __future__ import annotations

import os
import shutil
import sys
import sysconfig
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import setuptools
from setuptools import build_meta
from setuptools.build_meta import (  # noqa: F401  the hooks that stay as they are
    build_editable,
    build_sdist,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

MYPYC = "mypy>=1.18,<3"
SWITCH = "UUV_FLEET_COMPILE"
# The cores: what every tick and every packet passes. Left out is what was not faster (the recorder packs bytes by
# calls of C already), what msgspec or pickle make by its annotations, which are coarser in compiled classes
# (netem/network.py, netem/ledger.py, netem/lives.py), and what has subclasses that are not compiled (agents/loop.py).
MODULES = (
    "world/dynamics.py", "world/frames.py", "world/lockstep.py", "world/run_state.py", "world/sea.py",
    "world/tumble.py", "world/vectors.py",
    "agents/agent.py", "agents/brain.py", "agents/compact.py", "agents/neighbours.py", "agents/payload.py",
    "agents/plugged_agent.py",
    "agents/laws/backstepping.py", "agents/laws/consensus.py", "agents/laws/filters.py", "agents/laws/gain_qp.py",
    "agents/laws/guidance.py", "agents/laws/kinematics.py", "agents/laws/shunting.py",
    "agents/laws/velocity_command.py",
    "netem/ages.py", "netem/histogram.py", "netem/impairment.py", "netem/rounds.py",
)  # fmt: skip
# Fused multiply-add and reordered sums would change the last bits of a result.
FLAGS = ("-O2", "-ffp-contract=off", "-fno-fast-math", "-w")


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """What has to be there to build a wheel."""
    return [*build_meta.get_requires_for_build_wheel(config_settings), *([MYPYC] if _wanted() else [])]


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """Build a wheel; returns its name."""
    build = partial(build_meta.build_wheel, wheel_directory, config_settings, metadata_directory)
    if not _wanted():
        return build()
    plain = setuptools.setup
    try:
        Path("build").mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir="build") as folder:  # setuptools takes no absolute path of a source
            setuptools.setup = partial(plain, ext_modules=_extensions(folder))
            return build()
    except (Exception, SystemExit) as error:  # of mypyc, of the C compiler: whatever it is, plain Python runs
        if _asked() == "yes":
            raise
        sys.stderr.write(f"uuv-fleet: not compiled, the cores run as plain Python: {error!r:.300}\n")
    finally:
        setuptools.setup = plain
    shutil.rmtree("build", ignore_errors=True)  # what was compiled before it failed
    return build()


def _asked() -> str:
    asked = os.environ.get(SWITCH, "no")
    if asked not in ("auto", "yes", "no"):
        raise SystemExit(f"{SWITCH}: expected auto, yes or no, got {asked!r}")
    return asked


def _wanted() -> bool:
    asked = _asked()
    if asked == "auto":
        compiler = (sysconfig.get_config_var("CC") or "cc").split()[0]
        header = Path(sysconfig.get_paths()["include"]) / "Python.h"
        return shutil.which(compiler) is not None and header.is_file()
    return asked == "yes"


def _extensions(folder: str) -> Any:
    """The modules as C, with everything that is written meanwhile in a folder."""
    from mypyc.build import mypycify

    settings = Path(folder) / "mypy.ini"
    # The dependencies are not there when a wheel is built: what comes from them is Any.
    settings.write_text("[mypy]\nfollow_imports = silent\nignore_missing_imports = True\n", "utf-8")
    extensions = mypycify([f"--config-file={settings}", f"--cache-dir={folder}/cache", *MODULES],
                          target_dir=folder, opt_level="2", strip_asserts=False)  # fmt: skip
    for extension in extensions:
        extension.extra_compile_args = [*(extension.extra_compile_args or []), *FLAGS]
    return extensions
