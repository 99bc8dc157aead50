"""JSON as files and `--json` have it."""

from __future__ import annotations

import json
from typing import Any

import msgspec


def json_text(document: Any) -> str:
    """A struct or plain values as JSON: a number that is not finite becomes null, since JSON has none."""
    try:
        return msgspec.json.format(msgspec.json.encode(document, enc_hook=str), indent=2).decode()
    except UnicodeEncodeError:  # the name of a file that is no text; json writes it with escapes
        plain = json.dumps(msgspec.to_builtins(document, enc_hook=str))
        return json.dumps(json.loads(plain, parse_constant=lambda _: None), indent=2)
