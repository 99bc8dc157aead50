"""Who may start the programs of a stack: nobody but a user who has asked for it."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.trust import Policy


def admit_programs(spec: ScenarioSpec, policy: Policy) -> None:
    """Let the programs of a specification be started if the user asked for it.

    Args:
        spec: whose folders of programs are absolute, as in a scenario.
        policy: says where the text comes from.

    Raises:
        UntrustedError: one may not run.
    """
    for key, section in (spec.programs or {}).items():
        policy.admit_program(key, " ".join(map(quote, section.run)), section.folder or "")
    if spec.compose is not None:
        policy.admit_program("compose", f"docker compose -f {quote(spec.compose)} up", str(Path(spec.compose).parent))
