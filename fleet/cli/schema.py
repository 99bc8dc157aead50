"""The command `fleet schema`: what `--json` prints."""

from __future__ import annotations

import click


@click.command()
@click.argument("command", nargs=-1, metavar="[COMMAND]")
def schema(command: tuple[str, ...]) -> None:
    """Print the JSON Schema of COMMAND's --json output; without COMMAND, a page about all of them (Markdown).

    \b
    Examples:
      fleet schema run > run.schema.json
      fleet schema | less
    """
    from fleet.cli.documents.index import DOCUMENTS
    from fleet.cli.documents.page import page
    from fleet.cli.documents.page import schema as schema_of

    if not command:
        click.echo(page(), nl=False)
        return
    name = " ".join(command)  # "bench real" is one of two words
    if name not in DOCUMENTS:
        raise click.UsageError(f"{name} has no --json; there are {', '.join(sorted(DOCUMENTS))}")
    import json

    click.echo(json.dumps(schema_of(name), indent=2))


COMMANDS = (schema,)
