"""The command `fleet about`: everything that a bug report needs, and what `--json` prints."""

from __future__ import annotations

from pathlib import Path

import click

from fleet.cli.completion import RUNS


@click.command()
@click.argument(
    "words", nargs=-1, metavar="[RUN]",
    help="A run directory; by default the newest run below runs, if there is one. With --schemas: a command.",
)  # fmt: skip
@click.option("--schemas", is_flag=True,
              help="Print what --json prints: a page about all commands, or the JSON Schema of one.")  # fmt: skip
def about(words: tuple[str, ...], schemas: bool) -> None:
    """Print everything that a bug report needs: versions, the machine, its limits, and the result of RUN.

    It prints names of environment variables without their values, and `~` for your home directory. Read it before you
    send it: it contains names of folders and scenarios.

    \b
    Examples:
      fleet about
      fleet about runs/latest > report.txt
      fleet about --schemas run > run.schema.json
    """
    if schemas:
        _schemas(" ".join(words))  # "check LOG" is one of two words
        return
    from fleet.bench.about import about as report
    from fleet.execution.directory import newest_run

    if len(words) > 1 or not all(Path(word).is_dir() for word in words):
        raise click.BadParameter(f"{' '.join(words)!r} is no run directory", param_hint="RUN")
    click.echo(report(Path(words[0]) if words else newest_run(RUNS) if RUNS.is_dir() else None))


def _schemas(command: str) -> None:
    from fleet.cli.documents.page import DOCUMENTS, page, schema

    if not command:
        click.echo(page(), nl=False)
        return
    if command not in DOCUMENTS:
        raise click.UsageError(f"{command} has no --json; there are {', '.join(sorted(DOCUMENTS))}")
    import json

    click.echo(json.dumps(schema(command), indent=2))


COMMANDS = (about,)
