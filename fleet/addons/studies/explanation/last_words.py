"""What programs had printed when a check failed, of all vehicles in one order."""

from __future__ import annotations

import re
from heapq import nlargest
from typing import Annotated

from msgspec import Meta, Struct

from fleet.errors import printable
from fleet.logs.open_log import Log
from fleet.logs.schemas import said_schema

MOST_LINES = 20
SAID = "said/*"
_SAID = re.compile(r"said/(\d{1,9})", re.ASCII)


class SaidThen(Struct, frozen=True):
    """A line that an agent had said."""

    at_s: float
    vehicle: int
    stream: Annotated[str, Meta(description="out, err; end or failed: how its program ended.")]
    text: str

    def words(self, name: str) -> str:
        """The line behind the time and the name of who said it; on which stream, unless it is stdout."""
        stream = "" if self.stream == "out" else f" ({self.stream})"
        return f"{self.at_s:.3f} s  {name}{stream}: {printable(self.text)}"


def said_before(log: Log, at_s: float) -> list[SaidThen]:
    """The last lines that were said up to a time [s]."""
    lines = []
    for name in log:
        found = _SAID.fullmatch(name)
        if found is None or not len(topic := log[name]) or topic.schema != said_schema().name:
            continue
        times = topic.publish_ns.tolist()
        places = [(at_ns, int(found[1]), k) for k, at_ns in enumerate(times) if at_ns <= round(at_s * 1e9)]
        lines += [(place, topic) for place in nlargest(MOST_LINES, places)]
    lines = nlargest(MOST_LINES, lines, key=lambda line: line[0])[::-1]
    return [SaidThen(ns / 1e9, i, str(topic["file"][k]), str(topic["message"][k])) for (ns, i, k), topic in lines]
