"""A scenario as text: the merged values, with units, in the order of the schema.

Values that the profile supplies stand as comments under their section. Written as keys they would silence a
later `--set profile=...`, because an explicit value wins over the profile.
"""

from __future__ import annotations

import json
import re
from typing import Any

from agents.config import GuidanceParams, TrackingParams
from fleet.schema import ScenarioSpec
from fleet.tuning import guidance_section, tracking_section
from fleet.yaml_marks import resolve

# Plain scalars: nothing that could begin or end a YAML construct. Anything else is quoted.
_PLAIN = re.compile(r"(?:[A-Za-z0-9]|-?[0-9.])(?:[A-Za-z0-9 ._/%^<>+-]*[A-Za-z0-9._/%^])?")


def scenario_yaml(spec: ScenarioSpec, guidance: GuidanceParams, tracking: TrackingParams) -> str:
    """The text of a scenario, whose resolved parameters are given to be shown as comments."""
    values = spec.model_dump(exclude_none=True)
    supplied = {
        "guidance": guidance_section(guidance, spec.tick).model_dump(),
        "tracking": tracking_section(tracking).model_dump(),
    }
    lines: list[str] = []
    for key, value in values.items():
        lines += _entry(key, value, 0) if value != {} else [f"{key}:"]
        rest = {k: v for k, v in supplied.get(key, {}).items() if k not in value}
        if rest:
            lines.append(f"  # from profile {spec.profile}:")
            lines += [f"  # {k}: {_scalar(v)}" for k, v in rest.items()]
    return "\n".join(lines) + "\n"


def _entry(key: str, value: Any, depth: int) -> list[str]:
    indent = "  " * depth
    head = f"{indent}{_scalar(key)}:"
    if isinstance(value, dict) and value:
        lines = [head]
        for inner_key, inner in value.items():
            lines += _entry(inner_key, inner, depth + 1)
        return lines
    if isinstance(value, list) and value:
        return [head, *(f"{indent}  - {_inline(item)}" for item in value)]
    return [f"{head} {_inline(value)}"]


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_scalar(k)}: {_inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_inline(item) for item in value) + "]"
    return _scalar(value)


def _scalar(value: Any) -> str:
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
