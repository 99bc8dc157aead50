"""The message that made the difference: what a vehicle missed, or else what it received last."""

from __future__ import annotations

import dataclasses

import pytest
from fed_checks import begins, fate, fed
from msgspec.structs import replace
from small_scenario import small

from agents.message import pack
from agents.payload import StateMessage, encode
from fleet.checks.own_checks import LastMessages, OwnChecks
from fleet.checks.values import LoggedValues
from fleet.result.verdict import LastMessage

LINKS = [(1, 2), (2, 1), (2, 3), (3, 2)]
MINE = ["control.leads"]


def test_a_link_whose_last_packet_was_lost_is_named_before_one_that_works() -> None:
    last = LastMessages(LINKS, 10_000_000)
    assert last.of([2], MINE) is None
    for sent in (0, 10, 20):
        last.settle(fate(3, 2, sent))
    for sent in (0, 10):
        last.settle(fate(1, 2, sent))
    last.settle(fate(1, 2, 20, "partition", final=20))
    found = last.of([2], MINE)
    assert found is not None
    assert (found.src, found.dst, found.sent_s, found.fate, found.heard_s) == (1, 2, 0.2, "partition", 0.1)
    assert (
        found.words()
        == "the last message that vehicle 2 missed: 1->2, sent at 0.2 s, partition; it had the last before from 0.1 s"
    )
    last.settle(fate(1, 2, 30))
    again = last.of([2], MINE)
    assert again is not None and again.fate == "delivered" and (again.src, again.sent_s) == (1, 0.3)
    assert last.of([3], MINE) is None


def test_of_several_links_the_one_that_is_silent_for_longest() -> None:
    last = LastMessages(LINKS, 10_000_000)
    last.settle(fate(3, 2, 0))
    last.settle(fate(3, 2, 10, "loss", final=10))
    last.settle(fate(1, 2, 10, "down", final=10))
    found = last.of([1, 2], MINE)
    assert found is not None and (found.src, found.heard_s) == (1, None)
    assert found.words().endswith("down; it had nothing before")


@pytest.mark.parametrize("lost", ["delivered", "loss"])
def test_the_silence_of_a_sender_that_is_gone_comes_before_a_packet_that_was_lost_since(lost: str) -> None:
    """The last random loss of another link was named, and not the node that had been killed."""
    last = LastMessages(LINKS, 10_000_000)
    last.settle(fate(1, 2, 0))
    last.settle(fate(1, 2, 10, lost))
    for sent in range(0, 100, 10):
        last.settle(fate(3, 2, sent))
    last.settle(fate(3, 2, 100, "loss"))
    found = last.of([2], MINE, silent=[1])
    assert found is not None and (found.src, found.silent) == (1, True)
    heard = "0.1" if lost == "delivered" else "0"
    assert (
        found.words() == f"vehicle 1 sends no more, and the last that vehicle 2 has of it is what it sent at {heard} s"
    )
    last = LastMessages(LINKS, 10_000_000)
    last.settle(fate(1, 2, 10, "loss"))
    never = last.of([2], MINE, silent=[1])
    assert never is not None and never.words().endswith("has of it is nothing")


@pytest.mark.parametrize("kind", ["kill", "pause", "diverged"])
def test_who_is_gone_or_paused_at_the_time_of_the_failure_is_silent(kind: str) -> None:
    """And no longer when that is over."""
    scenario = small("duration=4 s", "checks={signal: {topic: error.e_norm, below: 8 m, after: 1 s}}")
    for over in (False, True):
        own = OwnChecks.from_scenario(scenario)
        assert own is not None
        own.settle(replace(fate(1, 2, 10), payload=STATE))
        own.event(begins("f", 20, f"{kind} 1"))
        if over:
            own.event(dataclasses.replace(begins("f", 50, f"{kind} 1"), action="ends"))
        own.take(LoggedValues(100, {(i, "error"): (0.0, 0.0, 0.0, 9.0, *([0.0] * 4)) for i in (1, 2, 3)}))
        (verdict,) = own.verdicts(over=False)
        assert verdict.moment is not None and verdict.moment.message is not None
        assert verdict.moment.message.silent is not over
        assert ("vehicle 1 sends no more" in verdict.found) is not over


def test_a_message_of_the_tick_of_the_failure_counts() -> None:
    """It is used at that tick, and the log has it behind the values of the tick."""
    fates = [fate(1, 2, 0), fate(1, 2, 99), fate(1, 2, 104)]
    (verdict,) = fed(
        "signal: {topic: error.e_norm, below: 8 m}",
        lambda i, t: 9.0 if i == 2 and t >= 1.0 else 5.0,
        fates=[replace(one, payload=STATE) for one in fates],
        signal="error.e_norm",
    )
    assert verdict.moment is not None and verdict.moment.message is not None
    assert (verdict.moment.message.sent_s, verdict.moment.message.at_s) == (0.99, 1.0)
    assert "the last message that vehicle 2 received: 1->2, sent at 0.99 s, due at 1 s" in verdict.found
    assert verdict.signals == ("error.e_norm",)


STATE = encode(StateMessage(1, 0, (0.0, 0.0, 5.0), (0.0, 0.0, 0.0)))


def test_only_messages_of_the_protocol_that_is_judged_count() -> None:
    """A state that was lost later than the last vote made no difference to the vote."""
    last = LastMessages(LINKS, 10_000_000)
    last.settle(replace(fate(1, 2, 10), payload=STATE))
    found = last.of([2], MINE)
    assert found is not None and found.sent_s == 0.1  # the agent sends nothing but states
    last.settle(replace(fate(1, 2, 20), payload=pack("votes", [1])))
    last.settle(replace(fate(1, 2, 30, "loss", final=30), payload=STATE))
    found = last.of([2], MINE)
    assert found is not None and (found.sent_s, found.fate) == (0.2, "delivered")
    found = last.of([2], ["state.z", "|error.e|"])
    assert found is not None and (found.sent_s, found.fate, found.heard_s) == (0.3, "loss", 0.1)
    assert last.of([2], ["state.z", "nav.x", "command.tau_0"]) is None
    assert last.of([2], []) is None


def test_a_check_on_a_depth_names_no_message() -> None:
    depth = lambda i, t: 9.0 if i == 2 and t >= 1.0 else 5.0  # noqa: E731
    (verdict,) = fed("signal: {topic: nav.z, below: 8 m}", depth, fates=[fate(1, 2, 0)])
    assert verdict.moment is not None and verdict.moment.message is None
    assert "message" not in verdict.found


@pytest.mark.parametrize(
    ("checks", "lost", "words"),
    [
        ("{topic: error.e_norm, below: 8 m}", "", "9 m (south) at 1 s; no fault active; the last message that south "
         "received: north->south, sent at 0.99 s, due at 1 s"),
        ("{topic: error.e_norm, below: 8 m}", "loss", "9 m (south) at 1 s; no fault active; the last message that "
         "south missed: north->south, sent at 0.99 s, loss; it had nothing before"),
        ("{topic: error.e_norm, above: 5 m}", "", "5 m, 5 m, 5 m (north, south, shore) at 0 s; no fault active"),
        ("{topic: error.e_norm, spread_below: 4 m}", "", "4 m apart (north, south) at 1 s"),
        ("{topic: error.e_norm, eventually_within: 1 s, above: 9 m}", "", "not within 1 s after 0 s (north, south, "
         "shore)"),
        ("{topic: error.e_norm, below: 10 m}", "", "at most 9 m (south) at 1 s"),
    ],
)  # fmt: skip
def test_nodes_are_called_by_their_names_and_never_by_numbers(checks: str, lost: str, words: str) -> None:
    """Their names stood behind the word vehicle, as if there were numbers before them."""
    (verdict,) = fed(
        f"signal: {checks}",
        lambda i, t: 9.0 if i == 2 and t >= 1.0 else 5.0,
        fates=[replace(fate(1, 2, 99, *filter(None, [lost])), payload=STATE)],
        signal="error.e_norm",
        names="names=[north, south, shore]",
    )
    assert verdict.found.startswith(words), verdict.found
    assert "vehicle" not in verdict.found


@pytest.mark.parametrize("heard", [None, 0.1])
def test_a_sender_that_is_gone_is_called_by_its_name(heard: float | None) -> None:
    silent = LastMessage(1, 2, 0.2, 0.2, "down", heard, True)
    last = "nothing" if heard is None else "what it sent at 0.1 s"
    assert silent.words(["north", "south"]) == f"north sends no more, and the last that south has of it is {last}"
