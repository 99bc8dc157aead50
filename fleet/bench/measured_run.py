"""One run that something measures."""

from __future__ import annotations

from fleet.errors import FleetError
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Result, Status
from fleet.scenario.scenario import Scenario


def measured_run(scenario: Scenario, options: Options, *, checked: bool = True) -> Result:
    """Run a scenario to its end.

    Args:
        checked: whether its checks must pass as well.

    Raises:
        FleetError: the run broke, was interrupted, or did not pass its checks.
    """
    result = execute(scenario, options)
    which = f"the run with {scenario.vehicles} vehicles"
    if result.status in (Status.INTERRUPTED, Status.HUNG_UP):
        raise FleetError(f"{which} was ended: {result.reason}", status=result.status.exit)
    if result.status is Status.BROKEN:
        raise FleetError(f"{which} broke: {result.reason}", status=3)
    if checked and result.status is not Status.PASS:
        failed = ", ".join(verdict.check for verdict in result.verdicts if not verdict.passed)
        raise FleetError(f"{which} did not pass its checks: {failed}", status=3)
    return result
