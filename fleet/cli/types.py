"""Options that several commands take, and the types of their values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])
OVERRIDES = click.option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    multiple=True,
    help="Override one scenario key, e.g. network.period='200 ms'.",
)


def _trust(context: click.Context, option: click.Parameter, value: bool) -> None:
    """What --trust allows holds until the command ends."""
    if value:
        from world.plugins.trust import Trust, trusting

        say = Trust(everything=True, notify=lambda text: click.echo(f"fleet: {text}", err=True))
        context.with_resource(trusting(say))


TRUST = click.option(
    "--trust", is_flag=True, expose_value=False, callback=_trust,
    help="Also run laws, plants and checks that are neither installed nor your own.",
)  # fmt: skip
FORCE = click.option("--force", is_flag=True, help="Replace what is there.")


def _hush(context: click.Context, option: click.Parameter, value: bool) -> None:
    if value:
        from fleet.terminal.status_line import hushed

        context.with_resource(hushed())


NO_PROGRESS = click.option(
    "-q", "--quiet", is_flag=True, expose_value=False, callback=_hush, help="No progress."
)  # fmt: skip


def is_given(name: str) -> bool:
    """Whether an option was given on the command line, so that its value is no default."""
    return click.get_current_context().get_parameter_source(name) is not click.core.ParameterSource.DEFAULT


def _override(context: click.Context, option: click.Parameter, values: tuple[str, ...]) -> tuple[Any, ...]:
    """The overrides that an option asks for; nothing is imported without any."""
    if not values:
        return ()
    from fleet.scenario.text.overrides import Override

    return tuple(Override(option.opts[0], value) for value in values)


def key_options(**given: Any) -> list[Any]:
    """Options that are short for --set of a key of their name, as overrides; None: not given."""
    from fleet.scenario.text.overrides import SET, Override

    return [Override(SET, f"{key}={value}", f"--{key} {value}") for key, value in given.items() if value is not None]


def disturbances(command: F) -> F:
    """Add --fault and --net, which change a scenario in the words of `fleet inject`."""
    command = click.option(
        "--net",
        metavar="'LINKS CONDITION'",
        multiple=True,
        callback=_override,
        help="Impair links from the start, e.g. '1->2 loss 30%'; repeatable; the last one for a link wins.",
    )(command)
    return click.option(
        "--fault",
        metavar="'at TIME ...'",
        multiple=True,
        callback=_override,
        help="Add a fault in the words of fleet inject, e.g. 'at 20s for 10s partition halves'; repeatable.",
    )(command)


class Whole(click.IntRange):
    """A whole number within limits."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            least, most = self.min, self.max
            limits = f" from {least} to {most}" if most is not None else "" if least is None else f", {least} or more"
            self.fail(f"expected a whole number{limits}, got {value!r}", param, ctx)


class Duration(click.ParamType[int]):
    """A time with a unit, in whole ns; the limits are in s."""

    name = "time"

    def __init__(self, least_s: int = 0, most_s: int | None = None) -> None:
        self._least_s, self._most_s = least_s, most_s

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        from fleet.quantities import QuantityError, time_ns

        try:
            ns = value if isinstance(value, int) else time_ns(value)
        except QuantityError as error:
            self.fail(f"{error.message}{f': {error.hint}' if error.hint else ''}", param, ctx)
        if self._most_s is not None and not self._least_s * 10**9 <= ns <= self._most_s * 10**9:
            self.fail(f"expected {self._least_s} s to {self._most_s} s, got {value!r}", param, ctx)
        if ns < 0:
            self.fail(f"expected a time of 0 or more, got {value!r}", param, ctx)
        return ns


class Budget(click.ParamType[tuple[float, float]]):
    """A number of runs, or a wall time with a unit: the most runs, and the most seconds; one of them is inf."""

    name = "runs|time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        from fleet.quantities import QuantityError, time_ns

        if isinstance(value, tuple):
            return value
        text = str(value).strip()
        try:
            found = (int(text), inf) if text.isascii() and text.isdigit() else (inf, time_ns(text) / 1e9)
        except (QuantityError, ValueError):
            found = 0, 0
        if min(found) <= 0:
            self.fail(f"expected a number of runs such as 200, or a time such as '10 min', got {value!r}", param, ctx)
        return found


class Speed(click.ParamType[float | None]):
    """A factor of real time from a millionth to a million, or max."""

    name = "x|max"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | None:
        if value is None or value == "max":
            return None
        try:
            speed = float(str(value).removesuffix("x"))
        except ValueError:
            speed = 0.0
        if not 1e-6 <= speed <= 1e6:
            expected = "expected a factor of real time such as 1 or 2.5, from 1e-6 to 1e6, or max"
            self.fail(f"{expected}, got {value!r}", param, ctx)
        return speed


class Share(click.ParamType[float]):
    """A share from 0 to 1, or in percent."""

    name = "share"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        text = str(value)
        try:
            share = float(text[:-1]) / 100 if text.endswith("%") else float(text)
        except ValueError:
            share = -1.0
        if not 0.0 <= share <= 1.0:
            self.fail(f"expected a share such as 1% or 0.01, got {value!r}", param, ctx)
        return share


class Words(click.ParamType[tuple[str, ...]]):
    """Some of the given words, with commas between them; `all`, where it is allowed, means every one.

    Args:
        parts: words for parts of what others mean, which `all` does not name again.
    """

    name = "list"

    def __init__(self, words: Sequence[str], everything: str = "", parts: Sequence[str] = ()) -> None:
        self._words, self._everything, self._parts = tuple(words), everything, tuple(parts)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        asked = [word.strip() for word in str(value).split(",")]
        if self._everything and self._everything in asked:
            return self._words
        for word in asked:
            if word not in self._words and word not in self._parts and not self.allows(word):
                from netem.parsing import nearest

                hint = nearest(word, self.words) or f"there are {', '.join(self.words)}{self.others}"
                self.fail(f"{word!r} is unknown; {hint}", param, ctx)
        return tuple(dict.fromkeys(asked))

    @property
    def words(self) -> tuple[str, ...]:
        """Every word that is known."""
        return (*self._words, *self._parts, *filter(None, [self._everything]))

    others = ""  # what else is allowed, in words

    def allows(self, word: str) -> bool:
        """Whether a word is allowed that is none of the given ones."""
        return False


class PictureWords(Words):
    """Some of the given words, or signals such as `control.leads`; whether a log has such a signal is not known yet."""

    others = ", and signals such as control.leads"

    def allows(self, word: str) -> bool:
        """Whether it has the form of a signal's name."""
        from fleet.scenario.sections.signals import parse_name

        return parse_name(word) is not None


class Window(click.ParamType[tuple[float, float]]):
    """Two times, as in 20s..40s; a pair in s."""

    name = "a..b"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        if isinstance(value, tuple):
            return value
        from fleet.quantities import QuantityError, time_ns

        first, dots, last = str(value).partition("..")
        try:
            begin, end = time_ns(first), time_ns(last)
        except QuantityError as error:
            self.fail(f"expected two times such as 20s..40s, got {value!r}: {error}", param, ctx)
        if not dots or not 0 <= begin < end:
            self.fail(f"expected two times such as 20s..40s, the earlier first, got {value!r}", param, ctx)
        return begin / 1e9, end / 1e9


class Vehicles(click.ParamType[tuple[int, ...]]):
    """Vehicle numbers, as in 1,3-5."""

    name = "i,j-k"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        if isinstance(value, tuple):
            return value
        from fleet.quantities import QuantityError, vehicle_numbers

        try:
            return tuple(vehicle_numbers(str(value)))
        except QuantityError as error:
            self.fail(str(error), param, ctx)


class AgeText(click.ParamType[float]):
    """An age with a unit, in s."""

    name = "age"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        from fleet.quantities import AGE, QuantityError, parse

        try:
            age = value if isinstance(value, float) else float(parse(value, AGE)[0])
        except (QuantityError, OverflowError) as error:
            self.fail(str(error), param, ctx)
        if age < 0:
            self.fail(f"expected an age of 0 or more, got {value!r}", param, ctx)
        return age


class EndpointText(click.ParamType[str]):
    """A zenoh endpoint."""

    name = "endpoint"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        protocol, slash, address = str(value).partition("/")
        if not slash or not protocol or not address:
            self.fail(f"expected an endpoint such as tcp/127.0.0.1:7447, got {value!r}", param, ctx)
        return str(value)


class Numbers(click.ParamType[list[float]]):
    """Numbers with commas between, each within limits."""

    def __init__(self, least: float, most: float, example: str, *, whole: bool = False) -> None:
        self.name = "n,n,..."
        self._least, self._most, self._example, self._whole = least, most, example, whole

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list[float]:
        try:
            numbers = [int(part) if self._whole else float(part) for part in str(value).split(",")]
        except ValueError:
            numbers = []
        if not numbers or not all(self._least <= n <= self._most for n in numbers):
            limits = f"from {self._least:g} to {self._most:g}"
            self.fail(f"expected numbers {limits} such as {self._example}, got {value!r}", param, ctx)
        return numbers
