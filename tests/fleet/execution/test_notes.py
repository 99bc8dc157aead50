"""Notes: bounded, and each agent speaks for itself."""

from __future__ import annotations

from fleet.execution.notes import MOST_NOTES, Notes, tick_text
from netem.wire.codec import encode
from netem.wire.messages import Note


def test_a_tick_in_words() -> None:
    assert tick_text(120, 10_000_000) == "t = 1.20 s (tick 120)"
    assert tick_text(-1, 10_000_000) == "t = 0.00 s (tick 0)"


def note(role: str, subject: int, text: str = "too late") -> bytes:
    return encode(Note(role, subject, 3, text))


def test_who_speaks_for_whom() -> None:
    notes = Notes(10_000_000)
    for role, data in (
        ("agent-2", note("agent-2", 2)),
        ("world", note("world", 4, "a\x1b[31m")),
        ("netem", note("netem", 0)),
        ("agent-2", note("agent-2", 3)),  # about another
        ("agent-2", note("agent-3", 3)),  # as another
        ("agent-2", b"\xff"),
    ):
        assert notes.admit(role)
        notes.receive(role, data, 7)
    assert notes.lines[:3] == [
        "t = 0.03 s (tick 3) agent 2: too late",
        "t = 0.03 s (tick 3) vehicle 4: a\ufffd[31m",
        "t = 0.03 s (tick 3) netem: too late",
    ]
    assert notes.lines[3].startswith("t = 0.07 s (tick 7) rejected from agent-2: ")
    assert (len(notes.lines), notes.rejected) == (4, {"note/agent-2": 3})


def test_a_flood_takes_no_memory() -> None:
    notes = Notes(10_000_000)
    admitted = sum(notes.admit("agent-1") for _ in range(MOST_NOTES + 5))
    assert admitted == MOST_NOTES
    assert notes.admit("agent-2")  # the others have room
    for _ in range(MOST_NOTES):
        notes.receive("agent-1", note("agent-1", 1), 0)
    notes.receive("agent-2", note("agent-2", 2), 0)
    assert len(notes.lines) == MOST_NOTES
    assert notes.rejected == {"note/agent-1": 5, "note/agent-2": 1}
