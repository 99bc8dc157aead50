"""The text form of link conditions, which are written in the grammar of Linux tc-netem (tc-netem(8)):

    CONDITION    := { limit PACKETS | DELAY | LOSS | DUPLICATE | CORRUPT | REORDER | RATE | seed N | down } ...
    DELAY        := delay TIME [ JITTER [ CORRELATION ] ] [ distribution uniform|normal|pareto|paretonormal ]
    LOSS         := loss [ random ] PERCENT [ CORRELATION ]
                  | loss state P13 [ P31 [ P32 [ P23 [ P14 ] ] ] ]
                  | loss gemodel P [ R [ 1-H [ 1-K ] ] ]
    DUPLICATE    := duplicate PERCENT [ CORRELATION ]
    CORRUPT      := corrupt PERCENT [ CORRELATION ]
    REORDER      := reorder PERCENT [ CORRELATION ] [ gap DISTANCE ]       (needs a delay)
    RATE         := rate RATE [ PACKETOVERHEAD ]
    TIME         := number followed by us, ms, s (tc: usec, msec, sec)    PERCENT, CORRELATION := number followed by %
    RATE         := number followed by bit, kbit, mbit, gbit (bits per second), or bps, kbps, mbps, gbps (bytes!)

Here units are required. tc reads a TIME without a unit as microseconds and a PERCENT without a sign as percent. If you
write 200 instead of "200 ms", tc gives no message. `down` is not part of tc-netem. `slot` and `ecn` of tc-netem are
refused by name.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from typing import Any

from netem.condition import DEFAULT_LIMIT, Condition, FourState, GilbertElliott
from netem.errors import TextError
from netem.parsing import LONGEST_NUMBER, NUMBER, exact_number, nearest, quoted

_VALUE = re.compile(rf"({NUMBER.pattern})\s*([^\W\d_]+|%)?(?=\s|$)", re.ASCII)
_WORD = re.compile(r"\S+")
_TIME_NS = {"us": 10**3, "ms": 10**6, "s": 10**9}
_TIME_NS |= {f"{unit}{more}": ns for unit, ns in [*_TIME_NS.items()] for more in ("ec", "ecs")}  # tc's long names
RATE_UNITS = {"bit": 1, "kbit": 10**3, "mbit": 10**6, "gbit": 10**9, "bps": 8, "kbps": 8000, "mbps": 8 * 10**6,
             "gbps": 8 * 10**9, "kibit": 1024, "mibit": 1024**2, "gibit": 1024**3}  # fmt: skip
_LONGEST_TIME_NS = 10**9 * 86_400
_MOST_PACKETS = 10**6

WORDS = ("limit", "delay", "loss", "duplicate", "corrupt", "reorder", "rate", "seed", "down")
REFUSED = {
    "slot": "time slots belong to an acoustic channel: network.acoustic with mac: tdma",
    "ecn": "payloads here carry no congestion marks",
}
_INNER = ("distribution", "random", "state", "gemodel", "gap")


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

    def value_follows(self) -> bool:
        return _VALUE.match(self.text, self.at) is not None

    def value(self) -> tuple[Fraction, str, int] | None:
        """The next (number, unit, column), or None if the next thing is not a number."""
        match = _VALUE.match(self.text, self.at)
        number = exact_number(match.group(1)) if match else None
        if match is None or number is None:
            return None
        unit, column, self.at = match.group(2) or "", self.at, match.end()
        if unit in (*WORDS, *_INNER, *REFUSED):  # "delay 200 loss 30%": what follows the number is the next condition
            unit, self.at = "", match.end(1)
        self._skip()
        return number, unit, column


def parse_condition(text: str) -> Condition:
    """The condition that `text` describes; what it does not mention is perfect. Raises TextError: unknown or
    unsupported words, wrong units, values out of range or without effect."""
    found, places = _read(text)
    if found.get("reorder") and not found.get("delay_ns"):
        raise TextError("reorder sends some packets at once, so the others need a delay", places["reorder"].start)
    return Condition(**found)


def with_word(text: str, word: str, value: str) -> str:
    """Change one word of a condition: `with_word("delay 2s loss 1%", "loss", "30%")` returns `delay 2s loss 30%`.

    Args:
        text: the present condition. Empty: a perfect link.
        word: a word with values. If the condition lacks it, it is added at the end.
        value: all new values of the word.

    Raises:
        TextError: the condition is not valid, the word is unknown or takes no value, or the value does not fit the
            word. If the value is wrong, `column` is the place in `value`. Otherwise it is 0.
    """
    if word not in _PARSERS or word == "down":
        valued = ", ".join(name for name in WORDS if name != "down")
        hint = nearest(word, WORDS) if word != "down" else "--net takes whole conditions"
        raise TextError(f'a link condition has no value "{word[:40]}"; it has {valued}', 0, hint)
    try:
        _, added = _read(f"{word} {value}")
    except TextError as error:
        raise TextError(error.message, max(0, error.column - len(word) - 1), error.hint) from None
    if len(added) > 1:
        other = next(name for name in added if name != word)
        raise TextError(f'"{other}" is another word of the condition', max(0, added[other].start - len(word) - 1))
    places = _read(text)[1] if text else {}
    terms = {name: text[place.start : place.stop].strip() for name, place in places.items()}
    return " ".join((terms | {word: f"{word} {value.strip()}"}).values())


def _read(text: str) -> tuple[dict[str, Any], dict[str, slice]]:
    reader = _Reader(text)
    if reader.done():
        raise TextError('expected a link condition such as "delay 200ms 50ms loss 30%", got nothing')
    places: dict[str, slice] = {}
    found: dict[str, Any] = {}
    while not reader.done():
        column, word = reader.at, reader.word()
        if word in places:
            raise TextError(f'"{word}" is given twice', column)
        if word not in _PARSERS:
            raise _unknown(word, column)
        found |= _PARSERS[word](reader)
        places[word] = slice(column, reader.at)
    return found, places


def _delay(reader: _Reader) -> dict[str, Any]:
    found: dict[str, Any] = {"delay_ns": _time(reader, "delay", "200ms")}
    jitter_column = reader.at
    if reader.value_follows():
        found["jitter_ns"] = _time(reader, "jitter", "50ms")
        if reader.value_follows():
            found["delay_correlation"] = _percent(reader, "correlation")
    if reader.peek() == "distribution":
        column = reader.at
        reader.word()
        name_column, name = reader.at, reader.word()
        if name not in _DISTRIBUTIONS:
            hint = nearest(name, _DISTRIBUTIONS) or f"known: {', '.join(_DISTRIBUTIONS)}"
            raise TextError(f"no distribution is called {quoted(name)}", name_column, hint)
        if not found.get("jitter_ns"):
            raise TextError("a distribution has no effect without a jitter", column, "write delay 200ms 50ms ...")
        found["distribution"] = name
    delay, jitter = found["delay_ns"], found.get("jitter_ns", 0)
    if jitter > delay and found.get("distribution", "uniform") == "uniform":
        raise TextError(
            f"the jitter {_print_time(jitter)} is above the delay {_print_time(delay)}: "
            "a packet cannot arrive before it is sent",
            jitter_column,
        )
    if found.get("delay_correlation") and not jitter:
        raise TextError("a correlation has no effect without a jitter", jitter_column)
    return found


def _loss(reader: _Reader) -> dict[str, Any]:
    match reader.peek():
        case "state":
            reader.word()
            p13 = _percent(reader, "p13")
            p = _percents(reader, ("p31", "p32", "p23", "p14"))
            model = FourState(p13, p.get("p31", 1.0 - p13), p.get("p32", 0.0), p.get("p23", 1.0), p.get("p14", 0.0))
            for first, second in (("p13", "p14"), ("p31", "p32")):
                if getattr(model, first) + getattr(model, second) > 1.0 + 1e-12:
                    raise TextError(f"{first} and {second} leave the same state: together at most 100%", reader.at)
            return {"loss_model": model}
        case "gemodel":
            reader.word()
            p_bad = _percent(reader, "p")
            p = _percents(reader, ("r", "1-h", "1-k"))
            return {"loss_model": GilbertElliott(p_bad, p.get("r", 1.0 - p_bad), p.get("1-h", 1.0), p.get("1-k", 0.0))}
        case "random":  # tc's optional word for independent loss
            reader.word()
    return _chance(reader, "loss")


def _chance(reader: _Reader, name: str) -> dict[str, Any]:
    """PERCENT [ CORRELATION ]."""
    found = {name: _percent(reader, name)}
    if reader.value_follows():
        found[f"{name}_correlation"] = _percent(reader, "correlation")
    return found


def _reorder(reader: _Reader) -> dict[str, Any]:
    found = _chance(reader, "reorder")
    gap = 1
    if reader.peek() == "gap":
        reader.word()
        gap = _whole(reader, "gap", "5", 1)
    return found | ({"gap": gap} if found["reorder"] else {})


def _rate(reader: _Reader) -> dict[str, Any]:
    got = reader.peek()
    number, unit, column = _number(reader, "rate", "1kbit")
    if unit.lower() not in RATE_UNITS:
        text = "has no unit" if not unit else f'takes bit, kbit, mbit (bits) or bps, kbps, mbps (bytes), got "{unit}"'
        raise TextError(f'the rate "{got}" {text}', column, nearest(unit, RATE_UNITS) if unit else "write 1kbit")
    bits_per_s = number * RATE_UNITS[unit.lower()]
    if bits_per_s.denominator != 1 or not 0 <= bits_per_s <= 10**12:
        expected = "expected a whole number of bits per second from 0 to 1000 gbit"
        raise TextError(f'the rate "{got}" is out of range: {expected}', column)
    found = {"rate_bit_s": bits_per_s.numerator}
    if reader.value_follows():
        column = reader.at
        found["rate_overhead"] = _whole(reader, "packet overhead (bytes)", "20", 0)
        if found["rate_overhead"] and not found["rate_bit_s"]:
            raise TextError("a packet overhead has no effect without a rate", column)
    return found


def _down(_: _Reader) -> dict[str, Any]:
    return {"up": False}


_DISTRIBUTIONS = ("uniform", "normal", "pareto", "paretonormal")
_PARSERS: dict[str, Callable[[_Reader], dict[str, Any]]] = {
    "limit": lambda reader: {"limit": _whole(reader, "limit", "20", 1)},
    "delay": _delay,
    "loss": _loss,
    "duplicate": lambda reader: _chance(reader, "duplicate"),
    "corrupt": lambda reader: _chance(reader, "corrupt"),
    "reorder": _reorder,
    "rate": _rate,
    "seed": lambda reader: {"seed": _whole(reader, "seed", "7", 0, 2**63 - 1)},
    "down": _down,
}


def _number(reader: _Reader, what: str, example: str) -> tuple[Fraction, str, int]:
    column, got = reader.at, reader.peek()
    value = reader.value()
    if value is None:
        raise TextError(f'expected a {what} such as "{example}", got {quoted(got)}', column)
    return value


def _whole(reader: _Reader, what: str, example: str, least: int, most: int = _MOST_PACKETS) -> int:
    column = reader.at
    got = reader.peek()
    value = reader.value()
    if value is None or value[1] or value[0].denominator != 1 or not least <= value[0] <= most:
        raise TextError(
            f'the {what} takes a whole number from {least} to {most} such as "{example}", got {quoted(got)}', column
        )
    return value[0].numerator


def _percents(reader: _Reader, names: tuple[str, ...]) -> dict[str, float]:
    found: dict[str, float] = {}
    for name in names:
        if not reader.value_follows():
            break
        found[name] = _percent(reader, name)
    return found


def _percent(reader: _Reader, what: str) -> float:
    got = reader.peek()
    number, unit, column = _number(reader, what, "30%")
    if unit != "%":
        raise TextError(f'the {what} takes a percentage such as "30%", got {quoted(got)}', column)
    if not 0 <= number <= 100:
        raise TextError(f'the {what} must be between 0% and 100%, got "{got}"', column)
    return float(number / 100)


def _time(reader: _Reader, what: str, example: str) -> int:
    got = reader.peek()
    number, unit, column = _number(reader, what, example)
    if not unit:
        raise TextError(
            f'the {what} "{got}" has no unit', column, f'write "{got}ms", or "{got}us", which is how tc reads it'
        )
    if unit not in _TIME_NS:
        raise TextError(f'the {what} takes us, ms or s, got "{unit}"', column, nearest(unit, ("us", "ms", "s")))
    ns = number * _TIME_NS[unit]
    if ns < 0 or ns > _LONGEST_TIME_NS:
        raise TextError(f'the {what} must be between 0 and one day, got "{got}"', column)
    if ns.denominator != 1:
        raise TextError(f'the {what} "{got}" is not a whole number of nanoseconds', column)
    return ns.numerator


def _unknown(word: str, column: int) -> TextError:
    if word in REFUSED:
        return TextError(f'"{word}" of tc-netem is not supported', column, REFUSED[word])
    if word in _INNER:
        return TextError(f'"{word}" belongs behind another word of tc-netem', column, f"first: {', '.join(WORDS)}")
    hint = nearest(word, WORDS) or f"known: {', '.join(WORDS)}"
    return TextError(f'unknown link condition "{word[:40]}"', column, hint)


def print_condition(condition: Condition) -> str:
    """The canonical text: `parse_condition(print_condition(c)) == c`."""
    c = condition
    words = []
    if c.limit != DEFAULT_LIMIT:
        words.append(f"limit {c.limit}")
    if c.delay_ns or c.jitter_ns:
        words.append(f"delay {_print_time(c.delay_ns)}")
        if c.jitter_ns:
            words.append(_print_time(c.jitter_ns))
            words += [_print_percent(c.delay_correlation)] if c.delay_correlation else []
            words += [f"distribution {c.distribution}"] if c.distribution != "uniform" else []
    match c.loss_model:
        case FourState(p13, p31, p32, p23, p14):
            words.append("loss state " + " ".join(map(_print_percent, (p13, p31, p32, p23, p14))))
        case GilbertElliott(p, r, bad, good):
            words.append("loss gemodel " + " ".join(map(_print_percent, (p, r, bad, good))))
        case _:
            words += _print_chance("loss", c.loss, c.loss_correlation)
    words += _print_chance("duplicate", c.duplicate, c.duplicate_correlation)
    words += _print_chance("corrupt", c.corrupt, c.corrupt_correlation)
    words += _print_chance("reorder", c.reorder, c.reorder_correlation)
    if c.reorder and c.gap > 1:
        words.append(f"gap {c.gap}")
    if c.rate_bit_s:
        words.append(f"rate {_print_rate(c.rate_bit_s)}")
        words += [str(c.rate_overhead)] if c.rate_overhead else []
    if c.seed is not None:
        words.append(f"seed {c.seed}")
    if not c.up:
        words.append("down")
    return " ".join(words) or "delay 0ms"


def _print_chance(name: str, probability: float, correlation: float) -> list[str]:
    if not probability and not correlation:
        return []
    return [f"{name} {_print_percent(probability)}", *([_print_percent(correlation)] if correlation else [])]


def _print_percent(value: float) -> str:
    return f"{_plain(Decimal(repr(value)) * 100)}%"


def _print_rate(bits_per_s: int) -> str:
    for unit in ("gbit", "mbit", "kbit"):
        if bits_per_s % RATE_UNITS[unit] == 0:
            return f"{bits_per_s // RATE_UNITS[unit]}{unit}"
    return f"{bits_per_s}bit"


def _print_time(ns: int) -> str:
    unit = "s" if ns and ns % 10**9 == 0 else "ms" if ns >= 10**6 or ns == 0 else "us"
    return f"{_plain(Decimal(ns) / _TIME_NS[unit])}{unit}"


def _plain(number: Decimal) -> str:
    text = f"{number.normalize():f}"
    return text if len(text) < LONGEST_NUMBER else str(number.normalize())
