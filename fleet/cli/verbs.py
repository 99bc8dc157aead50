"""The commands of `fleet`: the group of each in the help, and the module that holds it.

`fleet --help` is written from this table, so it imports no command, and a command imports no other one.
"""

from __future__ import annotations

from typing import NamedTuple


class Verb(NamedTuple):
    """One command."""

    module: str
    help: str  # its line in `fleet --help`


GROUPS: dict[str, dict[str, Verb]] = {
    "Start": {
        "list": Verb("fleet.cli.runs", "List the scenarios and studies that ship (runs: ls)."),
        "new": Verb("fleet.addons.templates.verb", "Write a scenario, law, protocol, check or vehicle."),
        "check": Verb("fleet.cli.check", "Check a scenario without running it, or judge a log."),
        "run": Verb("fleet.cli.run", "Run a scenario and judge it."),
        "netem": Verb("fleet.cli.run", "Put the network between programs of your own."),
        "reproduce": Verb("fleet.addons.paper.verb", "Run the paper's simulations again and judge its claims."),
    },
    "Live runs": {
        "status": Verb("fleet.cli.live", "Show how a run is doing, and its faults."),
        "view": Verb("fleet.addons.page.verbs.view", "Show a live run or a log in the browser."),
        "inject": Verb("fleet.cli.live", "Inject a fault."),
        "heal": Verb("fleet.cli.live", "End a fault, or all of them."),
        "clock": Verb("fleet.cli.live", "Pause, step or pace a run."),
        "stop": Verb("fleet.cli.live", "Stop a run; its log stays."),
    },
    "After a run": {
        "ls": Verb("fleet.cli.runs", "List the live runs, and the runs below a directory."),
        "info": Verb("fleet.cli.logs", "Summarise a log."),
        "plot": Verb("fleet.cli.logs", "Draw pictures of logs or of a study."),
        "report": Verb("fleet.cli.logs", "Write one HTML page about logs or a study."),
        "movie": Verb("fleet.cli.logs", "Make a GIF or an MP4 of a log."),
        "export": Verb("fleet.cli.logs", "Write a log as tables, or as a scenario."),
        "fit": Verb("fleet.cli.logs", "Fit link states to a trace of a link."),
    },
    "Prove and change": {
        "verify": Verb("fleet.cli.verify", "Run a log's scenario again and compare every byte."),
        "diff": Verb("fleet.cli.verify", "Compare two logs."),
        "why": Verb("fleet.cli.verify", "Explain why a check failed."),
        "whatif": Verb("fleet.cli.verify", "Compare another agent's commands with the log's."),
        "replay": Verb("fleet.cli.replay", "Publish a log on zenoh again."),
        "recover": Verb("fleet.cli.verify", "Save what is left of a damaged log."),
    },
    "Many runs": {
        "sweep": Verb("fleet.addons.studies.verbs.sweep", "Run a scenario at many values and seeds."),
        "boundary": Verb("fleet.addons.studies.verbs.boundary", "Find where a scenario begins to fail."),
        "search": Verb("fleet.addons.studies.verbs.search", "Try random faults until a check fails."),
        "regress": Verb("fleet.addons.studies.verbs.search", "Repeat the failures that a search has kept."),
        "rare": Verb("fleet.addons.studies.verbs.search", "Estimate how often a check fails, if it is rare."),
        "shrink": Verb("fleet.addons.studies.verbs.search", "Make a failing run as small as possible."),
    },
    "Other hosts and programs": {
        "agent": Verb("fleet.addons.hosts.verbs.protocol", "Run an external vehicle's agent in this terminal."),
        "hosts": Verb("fleet.addons.hosts.verbs.hosts", "Prepare a run over several hosts: certificates, a router."),
        "protocol": Verb("fleet.addons.hosts.verbs.protocol", "Print the wire protocol, or check an agent."),
        "record": Verb("fleet.cli.replay", "Record zenoh traffic to an MCAP file."),
        "ros2": Verb("fleet.addons.robots.verbs.ros2", "Show a live run or a log to ROS 2."),
    },
    "This tool": {
        "about": Verb("fleet.cli.about", "Print everything that a bug report needs."),
        "completion": Verb("fleet.cli.completion", "Print the script for completion in your shell."),
    },
}
# What commands of earlier versions became.
FORMER = {
    "ps": "fleet ls",
    "prune": "fleet ls --prune",
    "check-log": "fleet check LOG",
    "script": "fleet export LOG --scenario",
    "schema": "fleet about --schemas",
    "acl": "fleet hosts acl",
    "certs": "fleet hosts certs",
}
# What users expect of a command that has no such option, by command and option.
OTHER_OPTIONS = {
    ("run", "--dry-run"): "fleet check SCENARIO judges a scenario without a run; --show-config prints it",
    ("run", "--seeds"): "fleet sweep SCENARIO --seeds 20 makes a run with each seed",
    ("run", "--vary"): "fleet sweep SCENARIO --vary 'KEY=VALUES' makes a run with each value",
}
VERBS: dict[str, Verb] = {name: verb for group in GROUPS.values() for name, verb in group.items()}
# What users of other tools type, and what it is called here.
ELSEWHERE = {
    **dict.fromkeys(("rm", "remove", "delete", "clean"), "fleet ls --prune"),
    **dict.fromkeys(("logs", "runs", "history"), "fleet ls (all runs) or fleet info (what one log holds)"),
    **dict.fromkeys(("init", "create"), "fleet new"),
    "faults": "fleet status (those that are active; --all: every one)",
    "compare": "fleet diff (two logs), or fleet report (a page about several)",
    "play": "fleet view (a log on a screen), or fleet replay (a log on zenoh)",
    "resume": "fleet clock resume (a run that is held), or fleet run --from RUN@TIME (a new run from there)",
    **dict.fromkeys(("gui", "dashboard", "ui", "show"), "fleet view"),
    **dict.fromkeys(("start", "up", "launch"), "fleet run"),
    **dict.fromkeys(("kill", "down", "abort"), "fleet stop (a run), or fleet inject kill 3 (an agent)"),
    "pause": "fleet clock pause (a run), or fleet inject pause 3 (an agent)",
    "validate": "fleet check",
    **dict.fromkeys(("bug", "doctor", "env", "version"), "fleet about (versions, machine and a run, for a bug report)"),
    "bench": "python -m benchmarks (in a checkout of uuv-fleet)",
    "scenarios": "fleet list",
    "test": "fleet run (a scenario and its checks)",
}
