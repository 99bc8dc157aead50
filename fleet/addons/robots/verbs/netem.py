"""The command `fleet netem`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import click

from fleet.cli.changes import Changes, key_options
from fleet.cli.companion import Companions
from fleet.cli.declare import command
from fleet.cli.junit import Junit
from fleet.cli.run import SEED, execute_and_print
from fleet.cli.types import Trust
from fleet.execution.options import OnlyDirectory, Options, RunsFolder
from fleet.execution.wiring import USUAL, Wiring
from fleet.option import Option
from fleet.terminal.status_line import stderr
from fleet.terminal.width import say
from netem.clock import Clock


@command(
    epilog="Exit status: 0 pass, 1 a check failed, 2 usage or bad file, 3 the run broke.",
    document="fleet.result.result.Result",
)
def netem(
    stack: Path,
    *,
    out: RunsFolder = Path("runs"),
    seed: Annotated[int | None, SEED, Option("Override the file's seed.")] = None,
    duration: Annotated[str | None, Option(
        "End after this time, e.g. '5 min'; else with Ctrl-C or fleet stop.", "TIME")] = None,
    clock: Annotated[Literal["real", "simulated"] | None, Option(
        "simulated: its programs run in simulated time, as agents do: the same each time, and mostly faster.")] = None,
    changes: Changes,
    trust: Trust = False,
    show_config: Annotated[bool, Option("Print the merged file and stop.")] = False,
    companions: Companions,
    junit: Junit = None,
    quiet: OnlyDirectory = False,
) -> None:  # fmt: skip
    """Put the network of the file STACK between robots whose programs are yours, and judge what it carried.

    Each node is a robot: its programs connect to an address of ours, or we join a router of theirs. What the section
    `programs` names is started with the run, judged and stopped with it. Time is the wall clock. Ctrl-C ends the run,
    prints the verdict and the table of links, and leaves a log.

    \b
    Examples:
      fleet netem stack.yaml
      fleet netem stack.yaml --net '* delay 300ms 50ms loss 20%' --duration '2 min'
      fleet inject partition 'auv1 / auv2,shore' --for 30s
      fleet netem stack.yaml --view
      fleet netem stack.yaml --clock simulated
    """
    from fleet.addons.robots.relay_run import RelayRun
    from fleet.analysis import command_lines, robot_addresses
    from fleet.processes.child_start import die_with_study
    from fleet.processes.children import start_forkserver
    from fleet.scenario.loading import load_scenario
    from fleet.scenario.programs import admit_programs
    from fleet.scenario.text.simulated_nodes import SIMULATED

    die_with_study()
    if not show_config and clock != SIMULATED:
        start_forkserver("netem.relay_process")  # no vehicles: neither numpy nor their laws
    scenario = load_scenario(stack, [*changes, *key_options(seed=seed, duration=duration, clock=clock)])
    is_simulated = scenario.spec.names is not None
    if not scenario.nodes and not is_simulated:
        raise click.UsageError(f"{stack} has no nodes: fleet run {stack} runs it with agents of its own")
    if show_config:
        click.echo(scenario.to_yaml(), nl=False)
        return
    beside = [each for each in companions if each.asked]
    wiring = USUAL
    if is_simulated:
        asked = Options(out, in_process=not beside, quiet=quiet)
    else:
        asked = Options(out, clock=Clock.REAL, quiet=quiet)
        wiring = Wiring(relay=RelayRun)
        admit_programs(scenario.spec, scenario.reading.policy)
        if not quiet:
            for text in (*command_lines.warnings(scenario), *robot_addresses.warnings(scenario)):
                say(f"warning: {text}", err=True)
    for companion in beside:
        asked, wiring = companion.prepare(scenario, asked, ""), companion.wire(scenario, wiring, "")
    execute_and_print(scenario, asked, beside, stderr(), junit, wiring)
