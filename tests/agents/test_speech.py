"""What an agent says leaves in order and in bounded parts, and how its program ended is never late."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import pytest
from failing_laws import module as module
from hypothesis import given
from hypothesis import strategies as st
from talking import talking

from agents.api import Said
from agents.errors import ControllerError
from agents.make_agent import make_agent
from agents.plugged_agent import PluggedAgent
from agents.speech import LONGEST, MOST_BYTES, MOST_LINES, MOST_WAITING, Speech
from netem.wire.codec import decode, encode
from netem.wire.messages import Command
from netem.wire.parts import PART_BYTES


def lines(*texts: str, stream: str = "out") -> list[Said]:
    return [Said(k, stream, text) for k, text in enumerate(texts)]


def told(speech: Speech) -> list[tuple[Said, ...]]:
    parts = []
    while part := speech.take():
        parts.append(part)
    return parts


@given(st.lists(st.lists(st.text(max_size=2 * LONGEST), max_size=30), max_size=12))
def test_nothing_is_lost_or_reordered_and_each_part_fits(ticks: Sequence[Sequence[str]]) -> None:
    """As long as no more waits than may; a command with such a part is one that the world takes."""
    speech, parts = Speech(), []
    for texts in ticks:
        speech.put(lines(*texts))
        parts.append(speech.take())
    parts += told(speech)
    said = [line.text for part in parts for line in part]
    given_ = [text.encode("utf-8", "replace").decode() for texts in ticks for text in texts]
    assert [text[: LONGEST - 1] for text in said] == [text[: LONGEST - 1] for text in given_]
    for part in parts:
        data = encode(Command(0, 0, (0.0, 0.0, 0.0), (), part))
        assert len(data) < PART_BYTES
        assert decode(data).said == part  # type: ignore[union-attr]


def test_of_a_flood_the_newest_lines_remain_and_the_others_are_counted_once() -> None:
    speech = Speech()
    speech.put(lines(*map(str, range(1_000_000))))
    parts = told(speech)
    first, *others = (line for part in parts for line in part)
    assert first.text == f"({1_000_000 - MOST_WAITING} lines are left out here: there are too many)"
    assert [line.text for line in others] == [*map(str, range(1_000_000 - MOST_WAITING, 1_000_000))]
    assert max(map(len, parts)) == MOST_LINES


@pytest.mark.parametrize("text", ["x", "ä" * LONGEST])
def test_how_it_ended_waits_for_nothing(text: str) -> None:
    """The run may be over with the next tick. What was said just before it comes with it; later lines do not count."""
    speech = Speech()
    speech.put(lines(*[text] * 3_000))
    speech.put([Said(7, "err", "ValueError"), Said(8, "failed", "exit status 1"), Said(9, "out", "a ghost")])
    part = speech.take()
    assert [(line.stream, line.text) for line in part[-2:]] == [("err", "ValueError"), ("failed", "exit status 1")]
    assert sum(len(line.text.encode()) for line in part) <= MOST_BYTES + 100
    assert part[0].text.endswith("there are too many)")
    speech.put(lines("more"))
    assert speech.take() == ()


def test_a_line_is_cut_and_made_text() -> None:
    speech = Speech()
    speech.put(lines("x" * 5_000, "caf\udce9"))
    long, strange = speech.take()
    assert long.text == "x" * (LONGEST - 1) + "…"
    assert strange.text == "caf?"


# --- agents ----------------------------------------------------------------


def nav(tick: int) -> Any:
    return SimpleNamespace(tick=tick, eta=(0.0,) * 5, nu=(0.1, 0.0, 0.0, 0.0, 0.0), roll=(), clock_ns=None, belief=())


def test_an_agent_hands_over_what_it_says(module: Callable[[str], str]) -> None:
    agent = make_agent(talking(module, floods=300).agent_config(2))
    said = [agent.decide(nav(tick), []).said for tick in range(6)]
    assert [len(part) for part in said] == [0, 0, 2, 200, 100, 0]
    assert said[2] == (Said(20_000_002, "out", "tick 2"), Said(20_000_002, "err", "caf? \x1b[31m"))


LAW = """
    from agents.api import Said

    class Law:
        signals = ()
        def __init__(self, config): pass
        def transmit(self, nav): return ()
        def decide(self, nav, deliveries): {decides}
        def take_said(self): {says}
"""


@pytest.mark.parametrize(
    ("says", "problem"),
    [
        ("return None", "returned None: expected a list of Said"),
        ("return ['hello']", "expected a list of Said"),
        ("return [Said(-1, 'out', '')]", "expected a list of Said"),
        ("return [Said(1, 'loud', '')]", "expected a list of Said"),
        ("return [Said(1, 'out', b'')]", "expected a list of Said"),
        ("return [Said(1.0, 'out', '')]", "expected a list of Said"),
        ("raise KeyError('said')", "raised KeyError"),
    ],
)
def test_what_cannot_be_said(says: str, problem: str, module: Callable[[str], str]) -> None:
    law = module(LAW.format(decides="return (0, 0, 0), {}", says=says))
    scenario = talking(module, f"agent={{law: '{law}:Law'}}")
    with pytest.raises(ControllerError, match=problem.replace("(", "\\(")):
        make_agent(scenario.agent_config(1)).decide(nav(0), [])


def test_an_agent_that_fails_may_say_why_before_it_coasts(module: Callable[[str], str]) -> None:
    law = module(LAW.format(decides="raise KeyError", says="return [Said(1, 'err', 'last words')]"))
    scenario = talking(module, f"agent={{law: '{law}:Law'}}", "on_controller_error=coast")
    agent = make_agent(scenario.agent_config(1))
    assert isinstance(agent, PluggedAgent)
    assert [line.text for line in agent.decide(nav(0), []).said] == ["last words"]
    assert agent.decide(nav(1), []).said == ()
