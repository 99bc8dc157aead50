"""What the command line changes in a scenario: `--set`, `--net`, `--fault`, and options that are short for `--set`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import click

from fleet.option import Option


def key_options(**given: Any) -> list[Any]:
    """Options that are short for --set of a key of their name, as overrides; None: not given."""
    from fleet.scenario.text.overrides import SET, Override

    return [Override(SET, f"{key}={value}", f"--{key} {value}") for key, value in given.items() if value is not None]


class _Disturbance(click.ParamType[Any]):
    """A change of a scenario in the words of `fleet inject`; `flag`: the option that has it."""

    name = "text"

    def __init__(self, flag: str) -> None:
        self._flag = flag

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from fleet.scenario.text.overrides import Override

        return Override(self._flag, value)


Overrides = Annotated[
    tuple[str, ...], Option("Override one scenario key, e.g. network.period='200 ms'.", "KEY=VALUE", "--set")
]


@dataclass(frozen=True, slots=True)
class Changes:
    """What the command line changes in a scenario."""

    overrides: Overrides = ()
    fault: Annotated[tuple[Annotated[Any, _Disturbance("--fault")], ...], Option(
        "Add a fault in the words of fleet inject, e.g. 'at 20s for 10s partition halves'; repeatable.",
        "'at TIME ...'")] = ()  # fmt: skip
    net: Annotated[tuple[Annotated[Any, _Disturbance("--net")], ...], Option(
        "Impair links from the start, e.g. '1->2 loss 30%'; repeatable; the last one for a link wins.",
        "'LINKS CONDITION'")] = ()  # fmt: skip

    def __iter__(self) -> Iterator[Any]:
        """All of them, in the order in which they act."""
        return iter((*self.overrides, *self.net, *self.fault))
