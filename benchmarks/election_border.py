"""The same election twice: as five zenoh programs through `fleet netem`, and as five agents in lockstep.

    python benchmarks/election_border.py --seeds 40 --at-once 3

A run passes if each member knows a leader from 5 s to 20 s without a break. The table counts them for each loss. The
programs are docs/examples/election_stack/member.py and run on the wall clock; the agents are fleet.protocols.election.
A run whose host was late (`punctual` fails) is left out, and counted. The last lines give the loss at which half of the
runs fail. They do so for programs and for agents, with intervals.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import click
from stack import until_open  # the script beside this one

from fleet.addons.studies.psychometric import PsychometricCurve
from fleet.addons.studies.statistics import pass_rate
from fleet.processes.ports import free_port

EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "election_stack"
MEMBERS, LEASE_S, FROM_S, TO_S, READY_S = 5, 1.0, 5.0, 20.0, 4.0
LOSSES = (20, 30, 40, 50, 60)  # %


class Run(NamedTuple):
    passed: bool
    punctual: bool


def of_programs(loss: int, seed: int, folder: Path) -> Run:
    """One run of the programs."""
    ports = [free_port(None) for _ in range(MEMBERS)]
    sets = [f"nodes.m{i}.listen=tcp/127.0.0.1:{port}" for i, port in enumerate(ports, start=1)]
    words = [word for each in sets for word in ("--set", each)]
    words += ["--seed", str(seed), "--net", f"* delay 40ms 20ms loss {loss}%", "--out", str(folder), "--json", "-q"]
    words += ["--duration", f"{READY_S + TO_S + 3:g} s"]
    netem = subprocess.Popen(
        [sys.executable, "-m", "fleet", "netem", EXAMPLE / "stack.yaml", *words], stdout=subprocess.PIPE, text=True
    )
    until_open(ports)
    begin = time.monotonic() + READY_S - 1.0
    members = [
        subprocess.Popen(
            [sys.executable, EXAMPLE / "member.py", f"tcp/127.0.0.1:{port}", str(i), str(MEMBERS), str(LEASE_S),
             str(begin)],
            stdout=subprocess.PIPE, text=True,
        )
        for i, port in enumerate(ports, start=1)
    ]  # fmt: skip
    time.sleep(begin + TO_S - time.monotonic())
    for member in members:
        member.terminate()
    said = [member.communicate()[0] for member in members]
    found = json.loads(netem.communicate()[0])
    late = next(check for check in found["checks"] if check["check"] == "punctual")
    return Run(all(keeps_a_leader(text, begin) for text in said), late["passed"])


def keeps_a_leader(said: str, begin: float) -> bool:
    """Whether a member knew a leader all the time, by its lines."""
    changes = [(float(at) - begin, int(leader)) for at, leader in map(str.split, said.splitlines())]
    at_first = [leader for at, leader in changes if at <= FROM_S]
    later = [leader for at, leader in changes if FROM_S < at <= TO_S]
    return bool(at_first) and 0 not in [at_first[-1], *later]


def of_agents(loss: int, seeds: int, folder: Path) -> int:
    """How many runs of the agents pass."""
    words = ["sweep", EXAMPLE / "lockstep.yaml", "--vary", f"network.links.*.loss={loss} %", "--seeds", str(seeds)]
    done = subprocess.run(
        [sys.executable, "-m", "fleet", *map(str, words), "-o", str(folder / f"agents-{loss}"), "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True,
    )  # fmt: skip
    (point,) = json.loads(done.stdout)["points"]
    return round(point["passed"]["value"] * point["runs"])


def border(counts: dict[int, tuple[int, int]]) -> str:
    """Where half of the runs fail, with its interval."""
    curve = PsychometricCurve([loss / 100 for loss in LOSSES])
    made = [(LOSSES.index(loss), number < passed) for loss, (passed, runs) in counts.items() for number in range(runs)]
    found = curve.belief(curve.posterior(made))
    return f"{100 * found.border:.1f} % of loss ({100 * found.low:.1f} to {100 * found.high:.1f})"


@click.command()
@click.option("--seeds", default=40, show_default=True, help="Runs of each share, of programs and of agents.")
@click.option("--at-once", default=3, show_default=True, help="Runs of programs at the same time.")
def main(seeds: int, at_once: int) -> None:
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(at_once) as pool:
        folder, both = Path(name), {"programs": {}, "agents": {}}
        print("lost     programs                     late   agents", flush=True)
        for loss in LOSSES:
            runs = list(pool.map(lambda seed, loss=loss: of_programs(loss, seed, folder), range(1, seeds + 1)))
            counted = [run for run in runs if run.punctual]
            passed = sum(run.passed for run in counted)
            both["programs"][loss] = passed, len(counted)
            both["agents"][loss] = of_agents(loss, seeds, folder), seeds
            shown = [
                f"{share.value:6.0%} {share.low:4.0%}..{share.high:.0%} of {share.runs}"
                for share in (pass_rate(*both[kind][loss]) for kind in both)
            ]
            print(f"{loss:3} %  {shown[0]:28} {len(runs) - len(counted):4}   {shown[1]}", flush=True)
        for kind, counts in both.items():
            print(f"half of the runs of {kind} fail at {border(counts)}")


if __name__ == "__main__":
    main()
