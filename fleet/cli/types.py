"""Options that several commands take, and the types of their values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import click

from fleet.option import Option

T = TypeVar("T")
PATH = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)  # the metavar of an option is the name of its type


class Folder(click.Path):
    """A directory, which need not be there yet."""

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return "DIR"


FOLDER = Folder(path_type=Path, file_okay=False)


class Effect(NamedTuple):
    """An action of a flag that lasts until the command ends. The function of the command gets the flag, too."""

    act: Callable[[click.Context], None]


class Fallback(NamedTuple):
    """Finds a value that was not given, once all others are read."""

    find: Callable[[], Any]


def _trust(context: click.Context) -> None:
    from world.plugins.trust import Trust, trusting

    say = Trust(everything=True, notify=lambda text: click.echo(f"fleet: {text}", err=True))
    context.with_resource(trusting(say))


def _hush(context: click.Context) -> None:
    from fleet.terminal.status_line import hush_progress

    context.with_resource(hush_progress())


Trust = Annotated[
    bool, Option("Also run laws, plants, checks and programs that are neither installed nor your own."), Effect(_trust)
]
NoProgress = Annotated[bool, Option("No progress.", flag="-q --quiet"), Effect(_hush)]
Distribution = Literal["humble", "jazzy", "kilted"]  # releases of ROS 2
Force = Annotated[bool, Option("Replace what is there.")]


def is_given(name: str) -> bool:
    """Whether an option was given on the command line, so that its value is no default."""
    return click.get_current_context().get_parameter_source(name) is not click.core.ParameterSource.DEFAULT


class Whole(click.IntRange):
    """A whole number within limits."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            least, most = self.min, self.max
            limits = f" from {least} to {most}" if most is not None else "" if least is None else f", {least} or more"
            self.fail(f"expected a whole number{limits}, got {value!r}", param, ctx)


class Parsed(click.ParamType[T]):
    """What `read` makes of a text; its TextError or ValueError says what is wrong.

    `write` gives the text of a default; empty: it is not shown.
    """

    def __init__(self, name: str, read: Callable[[str], T], write: Callable[[Any], str] | None = None) -> None:
        self.name, self._read, self.write = name, read, write

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> T:
        from netem.errors import TextError

        try:
            return self._read(value)
        except TextError as error:
            self.fail(f"{error.message}{f': {error.hint}' if error.hint else ''}", param, ctx)
        except (ValueError, OverflowError) as error:
            self.fail(str(error), param, ctx)


def _time_ns(text: str) -> int:
    from fleet.quantities import time_ns

    if (ns := time_ns(text)) < 0:
        raise ValueError(f"expected a time of 0 or more, got {text!r}")
    return ns


def _time_text(ns: int | None) -> str:
    return "" if ns is None else f"{ns / 1e9:g} s"


TIME = Parsed("time", _time_ns, _time_text)  # with a unit, in whole ns
SECONDS = Parsed("time", lambda text: _time_ns(text) / 1e9, lambda s: _time_text(None if s is None else round(s * 1e9)))


def time_within(least_s: int, most_s: int) -> Parsed[int]:
    """Such a time within limits."""

    def read(text: str) -> int:
        if not least_s * 10**9 <= (ns := _time_ns(text)) <= most_s * 10**9:
            raise ValueError(f"expected {least_s} s to {most_s} s, got {text!r}")
        return ns

    return Parsed("time", read, _time_text)


def _budget(text: str) -> tuple[float, float]:
    from fleet.quantities import QuantityError, time_ns

    number = text.strip()
    try:
        found = (int(number), inf) if number.isascii() and number.isdigit() else (inf, time_ns(number) / 1e9)
    except (QuantityError, ValueError):
        found = 0, 0
    if min(found) <= 0:
        raise ValueError(f"expected a number of runs such as 200, or a time such as '10 min', got {text!r}")
    return found


# The most runs, and the most seconds of wall time; one of the two is inf.
BUDGET = Parsed("runs|time", _budget, lambda found: f"{found[0]:g}")


def _number(text: str, otherwise: float) -> float:
    try:
        return float(text)
    except ValueError:
        return otherwise


def _parse_speed(text: str) -> float | None:
    if text == "max":
        return None
    if not 1e-6 <= (speed := _number(text.removesuffix("x"), 0.0)) <= 1e6:
        expected = "expected a factor of real time such as 1 or 2.5, from 1e-6 to 1e6, or max"
        raise ValueError(f"{expected}, got {text!r}")
    return speed


# A factor of real time; None: as fast as possible.
SPEED = Parsed("x|max", _parse_speed, lambda speed: "max" if speed is None else f"{speed:g}")


class _Pace(click.types.FloatParamType):
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from fleet.replay.player import FASTEST, SLOWEST

        pace = super().convert(value, param, ctx)
        if pace and not SLOWEST <= pace <= FASTEST:
            self.fail(f"expected 0 or {SLOWEST:g} to {FASTEST:g}, got {pace:g}", param, ctx)
        return pace


PACE = _Pace()  # times the pace of a log; 0: as fast as possible


def _share(text: str) -> float:
    share = _number(text[:-1], -1.0) / 100 if text.endswith("%") else _number(text, -1.0)
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"expected a share such as 1% or 0.01, got {text!r}")
    return share


SHARE = Parsed("share", _share, lambda share: f"{100 * share:g}%")  # from 0 to 1, or in percent


class Words(click.ParamType[tuple[str, ...]]):
    """Some of the given words, with commas between them; `all`, where it is allowed, means every one.

    Args:
        parts: words for parts of what others mean, which `all` does not name again.
    """

    name = "list"

    def __init__(self, words: Sequence[str], everything: str = "", parts: Sequence[str] = ()) -> None:
        self._words, self._everything, self._parts = tuple(words), everything, tuple(parts)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        asked = [word.strip() for word in str(value).split(",")]
        if self._everything and self._everything in asked:
            return self._words
        for word in asked:
            if word not in self._words and word not in self._parts and not self.allows(word):
                from netem.parsing import nearest

                hint = nearest(word, self.words) or f"there are {', '.join(self.words)}{self.others}"
                self.fail(f"{word!r} is unknown; {hint}", param, ctx)
        return tuple(dict.fromkeys(asked))

    def write(self, value: tuple[str, ...] | None) -> str:
        """The text of a default."""
        return self._everything if self._everything and value == self._words else ",".join(value or ())

    @property
    def words(self) -> tuple[str, ...]:
        """Every word that is known."""
        return (*self._words, *self._parts, *filter(None, [self._everything]))

    others = ""  # what else is allowed, in words

    def allows(self, word: str) -> bool:
        """Whether a word is allowed that is none of the given ones."""
        return False


def _window(text: str) -> tuple[float, float]:
    from fleet.quantities import QuantityError, time_ns

    first, dots, last = text.partition("..")
    try:
        begin, end = time_ns(first), time_ns(last)
    except QuantityError as error:
        raise ValueError(f"expected two times such as 20s..40s, got {text!r}: {error}") from None
    if not dots or not 0 <= begin < end:
        raise ValueError(f"expected two times such as 20s..40s, the earlier first, got {text!r}")
    return begin / 1e9, end / 1e9


WINDOW = Parsed("a..b", _window)  # two times, as in 20s..40s; a pair in s


def _vehicles(text: str) -> tuple[int, ...]:
    from fleet.quantities import vehicle_numbers

    return tuple(vehicle_numbers(text))


VEHICLES = Parsed("list", _vehicles)  # numbers, as in 1,3-5


def _age(text: str) -> float:
    from fleet.quantities import AGE, parse

    if (age := float(parse(text, AGE)[0])) < 0:
        raise ValueError(f"expected an age of 0 or more, got {text!r}")
    return age


AGE = Parsed("age", _age)  # with a unit, in s


def _endpoint(text: str) -> str:
    if not all(text.partition("/")):
        raise ValueError(f"expected an endpoint such as tcp/127.0.0.1:7447, got {text!r}")
    return text


ENDPOINT = Parsed("endpoint", _endpoint)  # an endpoint of zenoh


def numbers(least: float, most: float, example: str, *, whole: bool = False) -> Parsed[list[float]]:
    """Numbers with commas between, each within limits."""

    def read(text: str) -> list[float]:
        try:
            found: list[float] = [int(part) if whole else float(part) for part in text.split(",")]
        except ValueError:
            found = []
        if not found or not all(least <= n <= most for n in found):
            raise ValueError(f"expected numbers from {least:g} to {most:g} such as {example}, got {text!r}")
        return found

    return Parsed("n,n,...", read)
