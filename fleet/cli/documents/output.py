"""The option `--json`, and what it prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from fleet.errors import harmless
from fleet.terminal.width import say

if TYPE_CHECKING:
    import msgspec

_ASKED = "fleet.json"  # in the meta of a context, which all contexts of one call share


def _remember(context: click.Context, option: click.Parameter, value: bool) -> bool:
    context.meta[_ASKED] = value
    return value


# Read before the other options: a mistake in one of them is printed as JSON, too.
JSON = click.Option(["--json", "as_json"], is_flag=True, is_eager=True, expose_value=False, callback=_remember,
                    help="Print one JSON document on stdout.")  # fmt: skip


def json_is_asked() -> bool:
    """Whether the command that was called has `--json`, and was given it."""
    return bool(click.get_current_context().meta.get(_ASKED))


def print_document(document: msgspec.Struct) -> None:
    """Print a document as JSON."""
    from fleet.result.json_text import json_text

    text = harmless(json_text(document), json=True)
    try:
        click.echo(text)
    except UnicodeEncodeError:  # stdout has another encoding; json writes with escapes what it does not have
        import json

        click.echo(json.dumps(json.loads(text), indent=2))


def print_result(document: msgspec.Struct, *words: str) -> None:
    """Print a result: as JSON if that was asked for, else in words, a line or several each."""
    if json_is_asked():
        print_document(document)
    else:
        say("\n".join(words))
