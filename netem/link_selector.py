"""The text form of link selectors: each names a set of directed links.

An arrow points in the direction of the payload:

    *        every link          1->*  all that vehicle 1 sends
    1->2     1's payloads to 2   *->2  all that vehicle 2 receives   1<->2   1->2 and 2->1
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from netem.condition import Link
from netem.errors import SelectorError, TextError
from netem.parsing import quoted


@dataclass(frozen=True, slots=True)
class Selector:
    """A set of directed links: from `src` to `dst` (None: any vehicle), and back if `both`."""

    src: int | None
    dst: int | None
    both: bool = False

    def __str__(self) -> str:
        if self.src is None and self.dst is None:
            return "*"
        side = ["*" if end is None else str(end) for end in (self.src, self.dst)]
        return side[0] + ("<->" if self.both else "->") + side[1]

    def matches(self, link: Link) -> bool:
        """Whether a link is in the set."""
        return self._one_way(link) or (self.both and self._one_way((link[1], link[0])))

    def _one_way(self, link: Link) -> bool:
        return self.src in (None, link[0]) and self.dst in (None, link[1])


class NoLink(SelectorError):
    """A text that names no link."""

    def __init__(self, got: str) -> None:
        super().__init__(self._expected(got, "1", "2"))
        self.got = got

    def _in_names(self, names: Sequence[str]) -> str:
        return self._expected(self.got, *names[:2])

    @staticmethod
    def _expected(got: str, a: str, b: str) -> str:
        return f'{quoted(got)} is no link: write "*", "{a}->{b}", "{a}<->{b}", "{a}->*" or "*->{b}"'


_SELECTOR = re.compile(r"\s*(\*|\d{1,9})\s*(<?->)\s*(\*|\d{1,9})\s*", re.ASCII)


def parse_selector(text: str) -> Selector:
    """The links that `text` names. Raises TextError: the text is no selector."""
    if text.strip() == "*":
        return Selector(None, None)
    match = _SELECTOR.fullmatch(text)
    if match is None:
        raise NoLink(text)
    src, arrow, dst = match.groups()
    if src == dst and src != "*":
        raise TextError(f"vehicle {src} has no link to itself")
    ends = [None if side == "*" else int(side) for side in (src, dst)]
    return Selector(ends[0], ends[1], arrow == "<->" and ends != [None, None])


def select(selector: Selector, links: Sequence[Link]) -> tuple[Link, ...]:
    """Those of `links` that the selector names, in the order given."""
    return tuple(link for link in links if selector.matches(link))
