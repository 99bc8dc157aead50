"""Values of options that several commands take."""

from __future__ import annotations

from typing import Any

import click

from fleet.quantities import QuantityError, time_ns


class Duration(click.ParamType[int]):
    """A time with a unit, as whole ns, within limits in s."""

    name = "time"

    def __init__(self, least_s: int = 0, most_s: int | None = None) -> None:
        self._least_s, self._most_s = least_s, most_s

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        try:
            ns = value if isinstance(value, int) else time_ns(value)
        except QuantityError as error:
            self.fail(f"{error.message}{f': {error.hint}' if error.hint else ''}", param, ctx)
        if self._most_s is not None and not self._least_s * 10**9 <= ns <= self._most_s * 10**9:
            self.fail(f"expected {self._least_s} s to {self._most_s} s, got {value!r}", param, ctx)
        if ns < 0:
            self.fail(f"a time that is not negative is needed, got {value!r}", param, ctx)
        return ns
