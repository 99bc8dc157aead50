"""The agents whose program failed or ended, as they said it themselves."""

from __future__ import annotations

import re
from typing import NamedTuple

from netem.wire.messages import END, ERR, FAILED, Frame

MOST_KEPT = 100
_REASON = re.compile(r"(?:Uncaught )?[\w.$]*(?:Error|Exception)\b")  # how a line begins that says why a program ended


class ProgramFailure(NamedTuple):
    vehicle: int
    at_ns: int
    text: str  # how it ended
    last: str  # what it had printed last on its standard error; empty: nothing

    @property
    def words(self) -> str:
        """When and how it failed."""
        return f"at {self.at_ns / 1e9:.2f} s: {self.text}{f': {self.last:.120}' if self.last else ''}"


class ProgramFailures:
    """Collects them from frames."""

    def __init__(self) -> None:
        self.first: list[ProgramFailure] = []  # in order, MOST_KEPT of them
        self.count = 0
        self.spoke = False  # whether any program has printed a line
        self.ended: dict[int, int] = {}  # by vehicle whose program has ended, well or not: when [ns]
        self._printed: dict[int, str] = {}  # by vehicle, the last line on its standard error

    def frame(self, frame: Frame) -> None:
        for life in frame.lives if self._printed or self.ended else ():
            if life.begins:
                self._printed.pop(life.vehicle, None)  # another agent has printed that
                self.ended.pop(life.vehicle, None)
        for i, said in ((line.vehicle, line.said) for line in frame.said):
            self.spoke = self.spoke or said.stream not in (END, FAILED)
            if said.stream in (END, FAILED):
                self.ended[i] = said.at_ns
            if said.stream == ERR and said.text.strip():
                # A trace of node.js ends with its version, and has the reason above.
                if _REASON.match(said.text) or not _REASON.match(self._printed.get(i, "")):
                    self._printed[i] = said.text
            elif said.stream == FAILED:
                self.count += 1
                if len(self.first) < MOST_KEPT:
                    self.first.append(ProgramFailure(i, said.at_ns, said.text, self._printed.get(i, "")))
