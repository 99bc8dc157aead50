"""`fleet` and `python -m fleet`."""

from __future__ import annotations


def main() -> None:
    """The console script."""
    from fleet.cli import cli

    cli()


if __name__ == "__main__":
    main()
