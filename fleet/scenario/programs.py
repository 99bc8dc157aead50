"""Who may start the programs of a stack, and of gateways: nobody but a user who has asked for it."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

from fleet.errors import FleetError, printable
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.trust import Policy
from world.errors import UntrustedError


def admit_programs(spec: ScenarioSpec, policy: Policy) -> None:
    """Let the programs of a specification be started if the user asked for it.

    Args:
        spec: whose folders of programs are absolute, as in a scenario.
        policy: says where the text comes from.

    Raises:
        FleetError: one may not run.
    """
    try:
        _admit(spec, policy)
    except UntrustedError as error:
        raise FleetError(printable(str(error))) from None


def _admit(spec: ScenarioSpec, policy: Policy) -> None:
    for key, section in (spec.programs or {}).items():
        policy.admit_program(key, " ".join(map(quote, section.run)), section.folder or "")
    gateways = {"gateway": spec.gateway} | {
        f"per_vehicle.{i}.gateway": each.gateway for i, each in spec.per_vehicle.items()
    }
    for where, gateway in gateways.items():
        if gateway is not None:  # it opens ports, and may start a program
            command = " ".join(map(quote, gateway.run or ["fleet", "agent"]))
            policy.admit_program(where, command, str(Path().resolve()))
    if spec.compose is not None:
        policy.admit_program("compose", f"docker compose -f {quote(spec.compose)} up", str(Path(spec.compose).parent))
