"""Turns keys and values of a scenario into words for the axes, legends and titles of a study's pictures."""

from __future__ import annotations

import re
from typing import Any

import yaml

_KEYS = {
    "vehicles": "number of vehicles",
    "network.period": "time between rounds",
    "network.acoustic": "acoustic channel",
    "neighbours.extrapolate": "extrapolation of neighbours",
    "neighbours.horizon": "horizon of the extrapolation",
}
_LINKS = re.compile(r"network\.links\.(?P<links>[^.]+)(?:\.states\.(?P<state>[^.]+))?\.(?P<what>\w+)")
_MAP = re.compile(r"\{[^{}]*\}")
_NUMBER = re.compile(r"[-+.]?\d")


def key_words(key: str) -> str:
    """A key in words: `network.links.*.loss` is `loss of every link`."""
    if key in _KEYS:
        return _KEYS[key]
    link = _LINKS.fullmatch(key)
    if link is not None:
        links = "every link" if link["links"] == "*" else f"link {link['links']}"
        state = f" in state {link['state']}" if link["state"] else ""
        return f"{link['what'].replace('_', ' ')}{state} of {links}"
    return key.replace(".", " ").replace("_", " ")


def short_words(key: str) -> str:
    """The last word of a key, for titles that have no room for more."""
    return key.rpartition(".")[2].replace("_", " ")


def value_words(value: Any) -> str:
    """A value in words: `{modem: fsk-80, slot: 3 s}` is `fsk-80, slot 3 s`; also within a difference."""
    return _MAP.sub(lambda found: _map_words(found[0]), str(value))


def _map_words(text: str) -> str:
    if "&" in text or len(text) > 1000:  # a study may come from anybody, and an anchor may stand for millions of words
        return text
    try:
        values = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return text
    if not isinstance(values, dict) or not values:
        return text
    return ", ".join(_pair(str(key).replace("_", " "), value) for key, value in values.items())


def _pair(key: str, value: Any) -> str:
    """A word stands for itself, a number needs its name."""
    if isinstance(value, bool):
        return key if value else f"no {key}"
    if isinstance(value, str) and not _NUMBER.match(value):
        return value
    return f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
