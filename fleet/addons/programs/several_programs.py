"""Several programs of one host: a program of ours that starts them, and ends as they do.

It runs under the library as they do, and reads nothing of theirs: they print to the agent's lines.

    python -m fleet.addons.programs.several_programs PROGRAMS

PROGRAMS are JSON: a list of `[name, words of its command line, variables of its environment, ends]`. `ends` says
whether it may end by itself: "no" not before the run does, "yes" with status 0, "any" in any way.
"""

from __future__ import annotations

import json
import os
import signal
import sys


def main(text: str) -> int:
    """Start all, and wait for them. Returns 0 when all have ended as they may, and 1 as soon as one has not."""
    running: dict[int, tuple[str, str]] = {}
    for name, words, variables, ends in json.loads(text):
        running[os.posix_spawnp(words[0], words, os.environ | variables)] = name, ends
    while running:
        process, status = os.wait()
        name, ends = running.pop(process)
        code = os.waitstatus_to_exitcode(status)
        how = f"exit status {code}" if code >= 0 else f"ended by signal {-code}"
        if ends == "any" or (ends == "yes" and code == 0):
            continue
        print(f"{name}: {how}" if code else f"{name} ended by itself", file=sys.stderr, flush=True)
        for other in running:  # the agent has failed, and what is left would go on unseen
            os.kill(other, signal.SIGKILL)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
