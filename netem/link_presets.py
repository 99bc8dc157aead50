"""Presets of links: conditions of radios and satellites with published sources, in `link_presets.toml`."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib import resources

from msgspec import Struct, convert

from netem.condition import Condition
from netem.grammar import parse_condition


class LinkPreset(Struct, frozen=True, forbid_unknown_fields=True):
    """The condition of a link one way, in words, and where each word comes from."""

    title: str
    condition: str
    sources: dict[str, str]  # where each number is from, by the word of the condition

    def parse(self) -> Condition:
        """The condition."""
        return parse_condition(self.condition)


@cache
def link_presets() -> dict[str, LinkPreset]:
    """The presets that come with the package, by name."""
    text = (resources.files("netem") / "link_presets.toml").read_text("utf-8")
    return convert(tomllib.loads(text), dict[str, LinkPreset])
