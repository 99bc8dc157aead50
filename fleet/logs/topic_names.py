"""Topics with numbers in their names: `link/1-2` has the packets from vehicle 1 to vehicle 2."""

from __future__ import annotations

import re

from netem.condition import Link

_LINK = re.compile(r"link/(\d{1,9})-(\d{1,9})", re.ASCII)
_BELIEVER = re.compile(r"uuv/(\d{1,9})/belief", re.ASCII)
BELIEFS = "uuv/*/belief"  # of all vehicles


def link_topic(link: Link) -> str:
    """The topic of a link's packets."""
    return f"link/{link[0]}-{link[1]}"


def link_of(topic: str) -> Link | None:
    """The link of a topic; None: it is another topic."""
    found = _LINK.fullmatch(topic)
    return None if found is None else (int(found[1]), int(found[2]))


def believer_of(topic: str) -> int | None:
    """The vehicle that holds the beliefs in a topic; None: it is another topic."""
    found = _BELIEVER.fullmatch(topic)
    return None if found is None else int(found[1])
