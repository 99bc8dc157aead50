"""Topics with numbers in their names: `link/1-2` has the packets from vehicle 1 to vehicle 2."""

from __future__ import annotations

import re

from netem.condition import Link

_LINK = re.compile(r"link/(\d{1,9})-(\d{1,9})", re.ASCII)
_BELIEVER = re.compile(r"uuv/(\d{1,9})/(belief|located)", re.ASCII)
BELIEFS = ("uuv/*/belief", "uuv/*/located")  # what vehicles believe of their places, by navigator and by ranges


def link_topic(link: Link) -> str:
    """The topic of a link's packets."""
    return f"link/{link[0]}-{link[1]}"


def link_of(topic: str) -> Link | None:
    """The link of a topic; None: it is another topic."""
    found = _LINK.fullmatch(topic)
    return None if found is None else (int(found[1]), int(found[2]))


def believer_of(topic: str) -> tuple[int, str] | None:
    """The vehicle that holds the beliefs in a topic, and `belief` or `located`; None: it is another topic."""
    found = _BELIEVER.fullmatch(topic)
    return None if found is None else (int(found[1]), found[2])
