"""The output of `fleet whatif --json`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from fleet.repeat.what_if import COMPONENTS, WhatIf


class Component(Struct):
    """How far one component of the commands is from the recorded one."""

    unit: Annotated[str, Meta(description="Unit of the numbers.")]
    max: Annotated[float | None, Meta(description="The most; null: it is not finite.")]
    at_s: Annotated[float, Meta(description="When that is [s].")]
    rms: Annotated[float | None, Meta(description="Root mean square; null: it is not finite.")]


class OtherCommands(Struct):
    """`fleet whatif --json`: the commands of another agent, compared with the recorded ones."""

    agent: Annotated[int, Meta(description="Number of the vehicle.")]
    samples: Annotated[int, Meta(description="Commands that were compared.")]
    messages: Annotated[int, Meta(description="Messages that the agent heard.")]
    identical: Annotated[bool, Meta(description="Whether every command is the recorded one, to the last bit.")]
    first_s: Annotated[float | None, Meta(description="Time of the first one that is not [s]; null: there is none.")]
    components: Annotated[dict[str, Component], Meta(description="By component; none without a command.")]
    notes: Annotated[list[str], Meta(description="What the agent told the operator.")]


def other_commands(found: WhatIf) -> OtherCommands:
    """The document of a comparison."""
    away = abs(found.found - found.recorded)
    components = {
        name: Component(
            unit,
            float(away[:, k].max()),
            float(found.t[away[:, k].argmax()]),
            float((away[:, k] ** 2).mean() ** 0.5),
        )
        for k, (name, unit) in enumerate(COMPONENTS if len(found.t) else ())
    }
    return OtherCommands(
        found.agent, len(found.t), found.heard, found.identical, found.first_s, components, found.notes
    )
