"""How agents are spread over processes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from fleet.scenario.schema.section import Section


class AgentsSection(Section):
    """Which agents share a process; in lockstep it changes no byte of a log."""

    per_process: Literal["auto"] | Annotated[int, Field(ge=1, le=1000)] = "auto"  # by the size of the fleet
