"""Notes: a run's reports in words, each with its time."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence

from fleet.errors import printable
from netem.errors import MalformedMessage
from netem.wire.codec import expect
from netem.wire.credentials import WORLD
from netem.wire.keys import vehicle_of
from netem.wire.messages import Ended, Note
from netem.wire.queues import Quota

MOST_NOTES = 1000
MOST_NAMES = 8  # of programs or nodes in one line
_ALIKE = " (so did agent"  # begins what `fold_notes` adds
_AGENT = re.compile(r"\bagent (\d+)\b")


def tick_text(tick: int, tick_ns: int) -> str:
    """A tick in words: `t = 1.20 s (tick 120)`."""
    return f"t = {max(0, tick) * tick_ns / 1e9:.2f} s (tick {max(0, tick)})"


def note_text(tick: int, tick_ns: int, who: str, text: str) -> str:
    return f"{tick_text(tick, tick_ns)} {who}: {text}"


def some(names: Sequence[str]) -> str:
    """The first names of some, and how many there are beside them."""
    return ", ".join(names[:MOST_NAMES]) + (f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else "")


def nothing_came(nodes: Sequence[str]) -> str:
    """The note on nodes that sent nothing: no loss or delay can have been seen to matter to them."""
    return f"nothing came from {some(nodes)}, and no packet of theirs was delayed or lost"


def text_without_agent(note: str) -> str:
    """The note without the number of its agent: the same text for agents that report the same, and when folded."""
    return _AGENT.sub("agent", note.partition(_ALIKE)[0])


def fold_notes(notes: Iterable[str]) -> list[str]:
    """Each note once: of agents that report the same, the first note stands, and the others are named behind it."""
    alike: dict[str, list[str]] = {}
    for note in notes:
        alike.setdefault(text_without_agent(note), []).append(note)
    lines = []
    for first, *others in alike.values():
        numbers = sorted({int(found[1]) for note in others if (found := _AGENT.search(note))})
        named = ", ".join(map(str, numbers))
        lines.append(f"{first}{_ALIKE}{'s' if len(numbers) > 1 else ''} {named})" if numbers else first)
    return lines


class Notes:
    """The notes of one distributed run, from the console and from its processes. A flood costs bounded memory: at most
    `MOST_NOTES` per role wait, and at most as many are kept.
    """

    def __init__(self, tick_ns: int) -> None:
        self.lines: list[str] = []
        self._tick_ns = tick_ns
        self._queued = Quota(MOST_NOTES)  # by role
        self._rejected: Counter[str] = Counter()  # by role: malformed, or too many

    @property
    def rejected(self) -> dict[str, int]:
        """By key, how many notes were not kept."""
        return {f"note/{role}": count for role, count in sorted(self._rejected.items())}

    def admit(self, role: str) -> bool:
        """Whether a note that arrived on the key of a role may wait for `receive`; on any thread."""
        if self._queued.admit(role):
            return True
        self._rejected[role] += 1
        return False

    def receive(self, role: str, data: bytes, tick: int) -> Ended | None:
        """Take a note of a role at a tick; `admit` has let it in. Returns the report of a host that one of its agents
        has ended. None: it was a note, or was rejected.
        """
        self._queued.release(role)
        try:
            note = _read(role, data)
        except MalformedMessage as error:
            self._rejected[role] += 1
            if self._rejected[role] == 1:
                self.lines.append(f"{tick_text(tick, self._tick_ns)} rejected from {role}: {printable(str(error))}")
            return None
        if isinstance(note, Ended):
            return note
        if len(self.lines) >= MOST_NOTES:
            self._rejected[role] += 1
            return None
        who = f"{'vehicle' if role == WORLD else 'agent'} {note.subject}" if note.subject else role
        self.add(note.tick, who, printable(note.text))
        return None

    def add(self, tick: int, who: str, text: str) -> None:
        self.lines.append(note_text(tick, self._tick_ns, who, text))


def _read(role: str, data: bytes) -> Note | Ended:
    if role.startswith("host-"):
        ended = expect(data, Ended)
        assert isinstance(ended, Ended)
        return ended
    note = expect(data, Note)
    assert isinstance(note, Note)
    own = {0, vehicle_of(role.replace("agent-", "/"))} if role.startswith("agent-") else {note.subject}
    if note.role != role or note.subject not in own:
        raise MalformedMessage("note", f"{role} speaks as {note.role!r:.40} about {note.subject}")
    return note
