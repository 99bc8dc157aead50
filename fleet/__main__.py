"""`fleet` and `python -m fleet`."""

from __future__ import annotations

import signal
import sys
from types import FrameType

INTERRUPTED = 130


def main() -> None:
    """The console script: the command line, with Ctrl-C and SIGTERM as a clean end at any moment."""
    signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        import click

        from fleet.cli import cli

        try:
            status = cli(standalone_mode=False)
        except click.Abort:
            status = INTERRUPTED
        except click.ClickException as error:
            error.show()
            status = error.exit_code
        except BrokenPipeError:
            # The reader of our output, `head` for instance, has seen enough.
            sys.stderr.close()
            status = 0
        sys.exit(status if isinstance(status, int) else 0)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _interrupt(_: int, __: FrameType | None) -> None:
    # Once is enough: ending the processes takes a moment, and a second one would cut that short.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
