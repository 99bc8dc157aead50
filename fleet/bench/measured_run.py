"""One run of which something is measured."""

from __future__ import annotations

from fleet.bench.errors import BenchError
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Result, Status
from fleet.scenario.scenario import Scenario


def measured_run(scenario: Scenario, options: Options, *, checked: bool = True) -> Result:
    """Run a scenario to its end.

    Args:
        checked: whether its checks must pass as well.

    Raises:
        BenchError: the run broke, was interrupted, or did not pass its checks.
    """
    result = execute(scenario, options)
    which = f"the run with {scenario.vehicles} vehicles"
    if result.status in (Status.INTERRUPTED, Status.HUNG_UP):
        raise BenchError(f"{which} was ended: {result.reason}", result.status.exit)
    if result.status is Status.BROKEN:
        raise BenchError(f"{which} broke: {result.reason}")
    if checked and result.status is not Status.PASS:
        failed = ", ".join(verdict.check for verdict in result.verdicts if not verdict.passed)
        raise BenchError(f"{which} did not pass its checks: {failed}")
    return result
