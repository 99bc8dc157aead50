"""The option `--json`, and what it prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    import msgspec

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout.")


def print_document(document: msgspec.Struct) -> None:
    """Print a document as JSON: a number that is not finite becomes null, since JSON has none."""
    import msgspec

    click.echo(msgspec.json.format(msgspec.json.encode(document), indent=2).decode())
