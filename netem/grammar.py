"""The text form of link conditions and of link selectors.

Conditions are written in the grammar of Linux tc-netem (tc-netem(8)), of which this much is understood:

    CONDITION := { delay TIME [ JITTER ] | loss [ random ] PERCENT | down } ...
    TIME      := number followed by us, ms or s        PERCENT := number followed by %

tc reads a TIME without a unit as microseconds; here the unit is required, since 200 for "200 ms" is a slip
that would otherwise pass. The rest of tc-netem is refused by name.

Selectors say which directed links are meant; an arrow points the way the payload travels:

    *        every link          1->*  all that vehicle 1 sends
    1->2     1's payloads to 2   *->2  all that vehicle 2 hears      1<->2   1->2 and 2->1
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from difflib import get_close_matches
from fractions import Fraction

from netem.config import Condition, Link
from netem.errors import NetemError

_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d{1,3})?", re.ASCII)
_VALUE = re.compile(rf"({_NUMBER.pattern})\s*([^\W\d_]+|%)?(?=\s|$)", re.ASCII)
_WORD = re.compile(r"\S+")
_TIME_NS = {"us": 10**3, "ms": 10**6, "s": 10**9}
_LONGEST_NUMBER = 40  # characters: keeps exact arithmetic cheap whatever the text
_LONGEST_TIME_NS = 10**9 * 86_400

WORDS = ("delay", "loss", "down")
LATER = ("limit", "reorder", "rate", "duplicate", "corrupt", "slot", "distribution", "ecn", "gap", "seed")


class GrammarError(NetemError):
    """Text that is no condition or selector; `column` counts from 0 within the text."""

    def __init__(self, message: str, column: int = 0, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.column = column
        self.hint = hint


def exact_number(text: str) -> Fraction | None:
    """The decimal number that `text` is, exactly, or None: no text, however long, takes long."""
    if len(text) > _LONGEST_NUMBER or not _NUMBER.fullmatch(text):
        return None
    return Fraction(Decimal(text))


def nearest(word: str, known: Iterable[str]) -> str:
    """`did you mean "delay"?` when one of the known words is near, else nothing."""
    lower = {name.lower(): name for name in known}
    found = get_close_matches(word.lower()[:60], lower, n=1, cutoff=0.6)
    return f'did you mean "{lower[found[0]]}"?' if found else ""


class _Reader:
    """A cursor over the words and values of one condition."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self._skip()

    def _skip(self) -> None:
        while self.at < len(self.text) and self.text[self.at].isspace():
            self.at += 1

    def done(self) -> bool:
        return self.at >= len(self.text)

    def peek(self) -> str:
        match = _WORD.match(self.text, self.at)
        return match.group() if match else ""

    def word(self) -> str:
        word = self.peek()
        self.at += len(word)
        self._skip()
        return word

    def value(self) -> tuple[Fraction, str, int] | None:
        """The next (number, unit, column), or None if the next thing is not a number."""
        match = _VALUE.match(self.text, self.at)
        number = exact_number(match.group(1)) if match else None
        if match is None or number is None:
            return None
        unit, column, self.at = match.group(2) or "", self.at, match.end()
        if unit in WORDS + LATER:  # "delay 200 loss 30%": what follows the number is the next condition
            unit, self.at = "", match.end(1)
        self._skip()
        return number, unit, column


def parse_condition(text: str) -> Condition:
    """The condition that `text` describes; what it does not mention is perfect.

    Raises:
        GrammarError: unknown or unsupported words, wrong units, a jitter above its delay.
    """
    reader = _Reader(text)
    if reader.done():
        raise GrammarError('expected a link condition such as "delay 200ms 50ms loss 30%", got nothing')
    seen: dict[str, int] = {}
    delay = jitter = 0
    loss = 0.0
    while not reader.done():
        column, word = reader.at, reader.word()
        if word in seen:
            raise GrammarError(f'"{word}" is given twice', column)
        seen[word] = column
        if word == "delay":
            delay, jitter = _delay(reader)
        elif word == "loss":
            loss = _loss(reader)
        elif word != "down":
            raise _unknown(word, column)
    return Condition(delay_ns=delay, jitter_ns=jitter, loss=loss, up="down" not in seen)


def _delay(reader: _Reader) -> tuple[int, int]:
    delay = _time(reader, "delay", "200ms")
    if _VALUE.match(reader.text, reader.at) is None:
        return delay, 0
    column = reader.at
    jitter = _time(reader, "jitter", "50ms")
    if jitter > delay:
        raise GrammarError(
            f"the jitter {_print_time(jitter)} is above the delay {_print_time(delay)}: "
            "a packet cannot arrive before it is sent",
            column,
        )
    _no_correlation(reader)
    return delay, jitter


def _time(reader: _Reader, what: str, example: str) -> int:
    column = reader.at
    got = reader.peek()
    value = reader.value()
    if value is None:
        raise GrammarError(f'expected a {what} such as "{example}", got {_quoted(got)}', column)
    number, unit, column = value
    if not unit:
        raise GrammarError(
            f'the {what} "{got}" has no unit',
            column,
            f'write "{got}ms", or "{got}us", which is how tc reads it',
        )
    if unit not in _TIME_NS:
        raise GrammarError(f'the {what} takes us, ms or s, got "{unit}"', column, nearest(unit, _TIME_NS))
    ns = number * _TIME_NS[unit]
    if ns < 0 or ns > _LONGEST_TIME_NS:
        raise GrammarError(f"the {what} must be between 0 and one day", column)
    if ns.denominator != 1:
        raise GrammarError(f"the {what} is not a whole number of nanoseconds", column)
    return ns.numerator


def _loss(reader: _Reader) -> float:
    column = reader.at
    if reader.peek() in ("state", "gemodel"):
        raise GrammarError(f'"loss {reader.peek()}" is not supported yet', column, 'use "loss 30%"')
    if reader.peek() == "random":  # tc's optional word for the independent loss that this is
        reader.word()
        column = reader.at
    got = reader.peek()
    value = reader.value()
    if value is None:
        raise GrammarError(f'expected a loss such as "30%", got {_quoted(got)}', column)
    number, unit, column = value
    if unit != "%":
        raise GrammarError(f'the loss takes a percentage such as "30%", got {_quoted(got)}', column)
    if not 0 <= number <= 100:
        raise GrammarError(f'the loss must be between 0% and 100%, got "{got}"', column)
    _no_correlation(reader)
    return float(number / 100)


def _no_correlation(reader: _Reader) -> None:
    if _VALUE.match(reader.text, reader.at) is not None:
        raise GrammarError(f'correlation ("{reader.peek()}") is not supported yet', reader.at)


def _unknown(word: str, column: int) -> GrammarError:
    if word in LATER:
        return GrammarError(f'"{word}" of tc-netem is not supported yet', column, f"supported: {', '.join(WORDS)}")
    hint = nearest(word, (*WORDS, *LATER)) or f"supported: {', '.join(WORDS)}"
    return GrammarError(f'unknown link condition "{word[:40]}"', column, hint)


def _quoted(text: str) -> str:
    return f'"{text[:40]}"' if text else "nothing"


def print_condition(condition: Condition) -> str:
    """The canonical text: `parse_condition(print_condition(c)) == c`."""
    words = []
    if condition.delay_ns or condition.jitter_ns:
        words.append(f"delay {_print_time(condition.delay_ns)}")
        if condition.jitter_ns:
            words.append(_print_time(condition.jitter_ns))
    if condition.loss:
        words.append(f"loss {_plain(Decimal(repr(condition.loss)) * 100)}%")
    if not condition.up:
        words.append("down")
    return " ".join(words) or "delay 0ms"


def _print_time(ns: int) -> str:
    unit = "s" if ns and ns % 10**9 == 0 else "ms" if ns >= 10**6 or ns == 0 else "us"
    return f"{_plain(Decimal(ns) / _TIME_NS[unit])}{unit}"


def _plain(number: Decimal) -> str:
    text = f"{number.normalize():f}"
    return text if len(text) < _LONGEST_NUMBER else str(number.normalize())


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
        return self._one_way(link) or (self.both and self._one_way((link[1], link[0])))

    def _one_way(self, link: Link) -> bool:
        return self.src in (None, link[0]) and self.dst in (None, link[1])


_SELECTOR = re.compile(r"\s*(\*|\d{1,9})\s*(<?->)\s*(\*|\d{1,9})\s*", re.ASCII)


def parse_selector(text: str) -> Selector:
    """The links that `text` names.

    Raises:
        GrammarError: the text is no selector.
    """
    if text.strip() == "*":
        return Selector(None, None)
    match = _SELECTOR.fullmatch(text)
    if match is None:
        raise GrammarError(f'{_quoted(text)} is no link: write "*", "1->2", "1<->2", "1->*" or "*->2"')
    src, arrow, dst = match.groups()
    if src == dst and src != "*":
        raise GrammarError(f"vehicle {src} has no link to itself")
    ends = [None if side == "*" else int(side) for side in (src, dst)]
    return Selector(ends[0], ends[1], arrow == "<->" and ends != [None, None])


def select(selector: Selector, links: Sequence[Link]) -> tuple[Link, ...]:
    """Those of `links` that the selector names, in the order given."""
    return tuple(link for link in links if selector.matches(link))
