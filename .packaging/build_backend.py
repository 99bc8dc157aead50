"""How the package is built: by setuptools, with the hot modules compiled by mypyc where that is possible.

The sources are the same, and so are the bytes that a run writes; compiled, the cores are faster. The environment
variable UUV_FLEET_COMPILE says whether: `auto` (the default: where a C compiler and Python.h are, and plain Python if
that fails), `yes` (it must work) or `no`. An editable install is never compiled: what one changes there has to count.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
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
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py

MYPYC = "mypy>=1.18,<3"
SWITCH = "UUV_FLEET_COMPILE"
# The cores: what every tick and every packet passes. Left out is
# - what msgspec or pickle make by its annotations, which are coarser in compiled classes: configurations,
#   netem/network.py, netem/ledger.py, netem/lives.py, netem/transit.py, agents/trajectory.py;
# - what was not faster: the recorder packs bytes by calls of C already;
# - fleet/recorder/journal.py: mypyc makes a list of a generator, and one there never ends.
MODULES = (
    "world/disturbance.py", "world/dynamics.py", "world/frames.py", "world/run_state.py", "world/lockstep.py",
    "world/sea.py", "world/tumble.py", "world/vectors.py", "world/navigation/filter.py",
    "world/navigation/instruments.py", "world/navigation/navigator.py",
    "agents/agent.py", "agents/brain.py", "agents/codecs.py", "agents/compact.py", "agents/controllers.py",
    "agents/loop.py", "agents/neighbours.py", "agents/payload.py", "agents/plugged_agent.py",
    "agents/laws/angles.py", "agents/laws/backstepping.py", "agents/laws/gain_qp.py",
    "agents/laws/guidance.py", "agents/laws/kinematics.py", "agents/laws/velocity_command.py",
    "netem/ages.py", "netem/draws.py", "netem/histogram.py", "netem/impairment.py",
    "netem/rounds.py", "netem/wire/codec.py", "fleet/recorder/metrics.py",
    "fleet/execution/in_process.py",
)  # fmt: skip
# Fused multiply-add and reordered sums would change the last bits of a result.
FLAGS = ("-ffp-contract=off", "-fno-fast-math", "-w")
PRELOAD = "fleet/addons/programs/preload"
NOTE = "fleet/not_compiled.txt"  # the reason why a wheel has no compiled cores; `fleet --version` says it
LEVEL = "1"  # of optimisation: 2 takes twice the time for code that is not faster


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """What has to be there to build a wheel."""
    return [*build_meta.get_requires_for_build_wheel(config_settings), *([MYPYC] if _obstacle() is None else [])]


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """Build a wheel; returns its name."""
    build = partial(build_meta.build_wheel, wheel_directory, config_settings, metadata_directory)
    plain = setuptools.setup
    obstacle = _obstacle()
    # A folder of its own, since setuptools would also pack what an earlier build left in `build`: old compiled modules.
    # It takes no absolute path of a source.
    with tempfile.TemporaryDirectory(prefix=".build-", dir=".") as temporary:
        folder = os.path.relpath(temporary)
        try:
            if obstacle is None:
                options = {"build": {"build_base": f"{folder}/compiled"}}
                try:
                    commands = {"build_ext": _OnAllCores, "build_py": _WithPreload}
                    setuptools.setup = partial(
                        plain, ext_modules=_extensions(folder), options=options, cmdclass=commands
                    )
                    return build()
                except (Exception, SystemExit) as error:  # of mypyc, of the C compiler: plain Python runs all the same
                    if _asked() == "yes":
                        raise
                    obstacle = f"{error!r:.300}"
            sys.stderr.write(f"uuv-fleet: the cores are not compiled and run as plain Python: {obstacle}\n")
            options = {"build": {"build_base": f"{folder}/plain"}}
            setuptools.setup = partial(plain, options=options, cmdclass={"build_py": _with_note(obstacle)})
            return build()
        finally:
            setuptools.setup = plain


class _WithPreload(build_py):
    """The step that copies the modules, which also compiles what is preloaded into programs of others."""

    def run(self) -> None:
        super().run()
        if (platform.system(), platform.machine()) == ("Linux", "x86_64"):
            folder = Path(self.build_lib, PRELOAD)
            # Should it fail, it is tried again when the first program runs, and says then what is wrong.
            subprocess.run(["sh", str(folder / "compile.sh"), str(folder)], capture_output=True)


class _OnAllCores(build_ext):
    """The step that compiles: several C files of an extension at a time, where setuptools takes one after the other."""

    def build_extensions(self) -> None:
        one_by_one = self.compiler.compile

        def compile_all(sources: list[str], **options: Any) -> list[str]:
            with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
                largest_first = sorted(sources, key=os.path.getsize, reverse=True)
                made = pool.map(lambda source: one_by_one([source], **options), largest_first)
                return [path for paths in made for path in paths]

        self.compiler.compile = compile_all
        super().build_extensions()


def _asked() -> str:
    asked = os.environ.get(SWITCH, "auto")
    if asked not in ("auto", "yes", "no"):
        raise SystemExit(f"{SWITCH}: expected auto, yes or no, got {asked!r}")
    return asked


def _obstacle() -> str | None:
    """Why the cores are not to be compiled; None: they are."""
    asked = _asked()
    if asked == "no":
        return f"{SWITCH}=no"
    if asked == "yes":
        return None
    compiler = (os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc").split()[0]
    if shutil.which(compiler) is None:
        return f"there is no C compiler ({compiler})"
    header = Path(sysconfig.get_paths()["include"]) / "Python.h"
    return None if header.is_file() else f"there is no {header}"


def _with_note(obstacle: str) -> type[build_py]:
    """The step that copies the modules, which also writes why they are not compiled."""

    class Noted(build_py):
        def run(self) -> None:
            super().run()
            Path(self.build_lib, NOTE).write_text(f"{obstacle}\n", "utf-8")

    return Noted


def _extensions(folder: str) -> Any:
    """The modules as C, with everything that is written meanwhile in a folder."""
    from mypyc.build import mypycify

    settings = Path(folder) / "mypy.ini"
    # The dependencies are not there when a wheel is built: what comes from them is Any. So it is where they are
    # installed, too: the same C everywhere, and mypy does not read them, which took most of its time.
    settings.write_text(
        "[mypy]\nfollow_imports = silent\nignore_missing_imports = True\nno_site_packages = True\n", "utf-8"
    )
    extensions = mypycify([f"--config-file={settings}", f"--cache-dir={folder}/cache", *MODULES],
                          target_dir=folder, opt_level=LEVEL, debug_level="0", strip_asserts=False,
                          multi_file=True)  # fmt: skip
    for extension in extensions:
        extension.extra_compile_args = [*(extension.extra_compile_args or []), *FLAGS]
    return extensions
