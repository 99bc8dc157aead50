"""The text of link conditions and selectors: what prints reads back, and what is wrong is pointed at."""

from __future__ import annotations

import pytest
from any_condition import conditions
from hypothesis import given
from hypothesis import strategies as st
from refusals import check_refusals

from netem.condition import Condition, FourState, GilbertElliott
from netem.errors import NetemError, TextError
from netem.grammar import REFUSED, parse_condition, print_condition, with_word
from netem.link_selector import Selector, parse_selector, select
from netem.parsing import exact_number


@given(conditions())
def test_what_prints_reads_back(condition: Condition) -> None:
    """parse(print(c)) == c for every condition, odd nanoseconds and denormal losses included."""
    assert parse_condition(print_condition(condition)) == condition


@given(conditions())
def test_printing_is_canonical(condition: Condition) -> None:
    text = print_condition(condition)
    assert print_condition(parse_condition(text)) == text


@pytest.mark.parametrize(
    ("text", "condition"),
    [
        ("delay 200ms", Condition(delay_ns=200_000_000)),
        ("delay 200ms 50ms loss 30%", Condition(200_000_000, 50_000_000, 0.3)),
        ("loss random 0.5%", Condition(loss=0.005)),
        ("  loss 30 %   delay 1.5 s 250 us ", Condition(1_500_000_000, 250_000, 0.3)),
        ("down", Condition(up=False)),
        ("down delay 1us", Condition(delay_ns=1_000, up=False)),
        ("delay 0.001us", Condition(delay_ns=1)),
        ("delay 0ms", Condition()),
        ("delay 200msec 250usecs 5%", Condition(200_000_000, 250_000, delay_correlation=0.05)),
        ("delay 1sec", Condition(delay_ns=1_000_000_000)),
        ("loss 100%", Condition(loss=1.0)),
        ("delay 200ms 50ms 25%", Condition(200_000_000, 50_000_000, delay_correlation=0.25)),
        ("delay 1ms 2ms distribution pareto", Condition(1_000_000, 2_000_000, distribution="pareto")),
        ("loss 1% 25%", Condition(loss=0.01, loss_correlation=0.25)),
        ("loss gemodel 1%", Condition(loss_model=GilbertElliott(0.01, 0.99))),
        ("loss gemodel 1% 10% 70% 0.1%", Condition(loss_model=GilbertElliott(0.01, 0.1, 0.7, 0.001))),
        ("loss state 1%", Condition(loss_model=FourState(0.01, 0.99))),
        ("loss state 1% 50% 10% 30% 2%", Condition(loss_model=FourState(0.01, 0.5, 0.1, 0.3, 0.02))),
        ("duplicate 1% 5% corrupt 0.1%", Condition(duplicate=0.01, duplicate_correlation=0.05, corrupt=0.001)),
        ("delay 10ms reorder 25% 50%", Condition(10_000_000, reorder=0.25, reorder_correlation=0.5, gap=1)),
        ("reorder 25% gap 5 delay 10ms", Condition(10_000_000, reorder=0.25, gap=5)),
        ("rate 1kbit", Condition(rate_bit_s=1000)),
        ("rate 10kbps 4 limit 3", Condition(rate_bit_s=80_000, rate_overhead=4, limit=3)),
        ("rate 1Mbit seed 7", Condition(rate_bit_s=1_000_000, seed=7)),
    ],
)
def test_reads_tc_netem(text: str, condition: Condition) -> None:
    assert parse_condition(text) == condition


def test_points_at_what_is_wrong() -> None:
    assert issubclass(TextError, NetemError)
    check_refusals("netem/conditions", parse_condition)
    check_refusals("netem/selectors", parse_selector)
    check_refusals("netem/changed words", lambda word, value: with_word("delay 200ms loss 30%", word, value))
    with pytest.raises(TextError, match="expected a delay"):
        parse_condition("delay " + "9" * 5000 + "ms")
    with pytest.raises(TextError) as caught:
        parse_condition("delay 1ms losss 3%")
    assert caught.value.hint == 'did you mean "loss"?'


@pytest.mark.parametrize("word", REFUSED)
def test_the_rest_of_tc_netem_is_refused_by_name(word: str) -> None:
    with pytest.raises(TextError, match="of tc-netem is not supported") as caught:
        parse_condition(f"{word} 5%")
    assert caught.value.hint


@given(st.one_of(st.text(), st.text("delayosmu %0123456789.-+e rn", max_size=30)))
def test_any_text_is_a_condition_or_a_grammar_error(text: str) -> None:
    try:
        condition = parse_condition(text)
    except TextError as error:
        assert 0 <= error.column <= len(text)  # noqa: PT017 - most texts are errors, all must be ours
    else:
        assert parse_condition(print_condition(condition)) == condition


LINKS = ((2, 1), (1, 2), (3, 2), (2, 3))


@pytest.mark.parametrize(
    ("text", "links"),
    [
        ("*", LINKS),
        ("1->2", ((1, 2),)),
        (" 2 <-> 1 ", ((2, 1), (1, 2))),
        ("2->*", ((2, 1), (2, 3))),
        ("*->2", ((1, 2), (3, 2))),
        ("*<->3", ((3, 2), (2, 3))),
        ("*->*", LINKS),
        ("1->3", ()),
    ],
)
def test_selectors_name_links(text: str, links: tuple[tuple[int, int], ...]) -> None:
    assert select(parse_selector(text), LINKS) == links


@given(st.one_of(st.none(), st.integers(1, 10**6)), st.one_of(st.none(), st.integers(1, 10**6)), st.booleans())
def test_selectors_read_back(src: int | None, dst: int | None, both: bool) -> None:
    if src == dst and src is not None:
        return
    selector = Selector(src, dst, both and (src, dst) != (None, None))
    assert parse_selector(str(selector)) == selector


@pytest.mark.parametrize("text", ["", "1e1000", "1e999999999", "1" * 41, "0x10", "1_000", "nan", "inf", "１"])
def test_exact_numbers_are_short_decimals(text: str) -> None:
    """Whatever the text, exact arithmetic on it stays cheap."""
    assert exact_number(text) is None


def test_one_word_of_a_condition_is_changed() -> None:
    assert with_word("delay 200ms 50ms  loss 30% seed 7", "loss", "5 %") == "delay 200ms 50ms loss 5 % seed 7"
    assert with_word("delay 200ms 50ms", "delay", "1s") == "delay 1s"
    assert with_word("down", "loss", "gemodel 1% 10%") == "down loss gemodel 1% 10%"
    assert with_word("", "rate", "80 bit") == "rate 80 bit"


@given(conditions(), st.integers(0, 10_000))
def test_the_other_words_of_a_condition_stay(condition: Condition, hundredths: int) -> None:
    percent = f"{hundredths / 100}%"
    found = parse_condition(with_word(print_condition(condition), "duplicate", percent))
    without = {name: getattr(condition, name) for name in condition.__slots__ if not name.startswith("duplicate")}
    assert found == Condition(**without, duplicate=parse_condition(f"duplicate {percent}").duplicate)
