"""Plain values as YAML: mappings over lines, what is inside a list on one line."""

from __future__ import annotations

import json
import re
from typing import Any

from fleet.scenario.text.yaml_reader import resolve

# Plain scalars: nothing that could begin or end a YAML construct. Anything else is quoted.
_PLAIN = re.compile(r"(?:[A-Za-z0-9]|-?[0-9.])(?:[A-Za-z0-9 ._/%^<>+-]*[A-Za-z0-9._/%^])?")


def yaml_text(values: dict[str, Any]) -> str:
    """The text of plain values; what is inside a list stands on one line."""
    return "\n".join(line for key, value in values.items() for line in entry(key, value, 0)) + "\n"


def entry(key: str, value: Any, depth: int) -> list[str]:
    """The lines of one key of a mapping that is `depth` mappings deep."""
    indent = "  " * depth
    head = f"{indent}{scalar(key)}:"
    if isinstance(value, dict) and value:
        lines = [head]
        for inner_key, inner in value.items():
            lines += entry(inner_key, inner, depth + 1)
        return lines
    if isinstance(value, list) and value:
        return [head, *(f"{indent}  - {inline(item)}" for item in value)]
    return [f"{head} {inline(value)}"]


def inline(value: Any) -> str:
    """The text of a plain value on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{scalar(k)}: {inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(inline(item) for item in value) + "]"
    return scalar(value)


def scalar(value: Any) -> str:
    """The text of a value that is no list and no mapping, quoted if it would be read as something else."""
    if isinstance(value, bool) or value is None:
        return json.dumps(value)
    if isinstance(value, float):
        return repr(value).removesuffix(".0")
    if isinstance(value, int):
        return str(value)
    text = str(value)
    if _PLAIN.fullmatch(text) and isinstance(resolve(text), str):
        return text
    return json.dumps(text, ensure_ascii=False)
