"""The modules that the fork server imports once, so that a hundred processes share them.

It opens no session and starts no thread.
"""

from __future__ import annotations

import gc
import importlib
import os

from fleet.processes.child_start import CONSOLE_PID_VARIABLE, PRELOAD_VARIABLE, die_with_parent

if CONSOLE_PID_VARIABLE in os.environ:
    die_with_parent(int(os.environ.pop(CONSOLE_PID_VARIABLE)))  # or processes that a law starts would see it

gc.disable()  # what is imported stays: one collection at the end is enough
# After the tie to the parent, because it takes a while. The last is where each child begins.
asked = os.environ.pop(PRELOAD_VARIABLE, "agents.main netem.main world.main")
for name in (*asked.split(), "fleet.processes.children"):
    importlib.import_module(name)

FORKSERVER_PID = os.getpid()

# Objects made so far live as long as the process: keep the collector from touching, and so copying, their pages.
gc.collect()
gc.freeze()
gc.enable()
