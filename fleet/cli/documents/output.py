"""The option `--json`, and what it prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    import msgspec

_ASKED = "fleet.json"  # in the meta of a context, which all contexts of one call share


def _remember(context: click.Context, option: click.Parameter, value: bool) -> bool:
    context.meta[_ASKED] = value
    return value


# Read before the other options: a mistake in one of them is printed as JSON, too.
json_option = click.option("--json", "as_json", is_flag=True, is_eager=True, callback=_remember,
                           help="Print one JSON document on stdout.")  # fmt: skip


def json_is_asked(context: click.Context) -> bool:
    """Whether the command that was called has `--json`, and was given it."""
    return bool(context.meta.get(_ASKED))


def as_document(document: msgspec.Struct) -> str:
    """A document as JSON: a number that is not finite becomes null, since JSON has none."""
    import msgspec

    return msgspec.json.format(msgspec.json.encode(document), indent=2).decode()


def print_document(document: msgspec.Struct) -> None:
    """Print a document as JSON."""
    import msgspec

    try:
        click.echo(as_document(document))
    except UnicodeEncodeError:  # the name of a file that is no text; json writes it with escapes
        import json

        values = json.loads(json.dumps(msgspec.to_builtins(document)), parse_constant=lambda _: None)
        click.echo(json.dumps(values, indent=2))
