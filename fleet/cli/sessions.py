"""The end of a command that has zenoh sessions: it does not wait for a peer that takes nothing."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fleet.cli.group import report
from fleet.errors import FleetError
from fleet.processes.interrupts import ending_status
from netem.errors import NetemError

CLOSE_S = 2.0  # time to close a session, in which its last messages are sent


@contextmanager
def ending() -> Iterator[list[Any]]:
    """Close the sessions in the list at the end; after Ctrl-C or another signal exit with its status."""
    sessions: list[Any] = []
    try:
        yield sessions
    except KeyboardInterrupt as end:
        sys.exit(ending_status(end))
    finally:
        error = sys.exc_info()[1]
        for bus in sessions:
            # zenoh waits 10 s for a peer that is suspended, and the interpreter's normal exit would, too.
            closing = threading.Thread(target=bus.close, daemon=True)
            closing.start()
            closing.join(CLOSE_S)
            if closing.is_alive():
                status = report(error) if isinstance(error, (FleetError, NetemError)) else int(error is not None)
                if isinstance(error, SystemExit) and isinstance(error.code, int):
                    status = error.code
                sys.stderr.flush()
                os._exit(status)
