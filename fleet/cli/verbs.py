"""The commands of `fleet`: those of the core and of the add-ons, under the headings of the help.

`fleet --help` is written from this table, so it imports no command, and a command imports no other one.
"""

from __future__ import annotations

from functools import cache

from fleet.addon import Verb, installed_addons, leave_out

_LAST = "This tool"  # the last heading
CORE: dict[str, dict[str, Verb]] = {
    "Start": {
        "list": Verb("fleet.cli.runs:list_", "List the scenarios and studies that ship (runs: ls)."),
        "check": Verb("fleet.cli.check:check", "Check a scenario without running it, or judge a log."),
        "run": Verb("fleet.cli.run:run", "Run a scenario and judge it."),
    },
    "Live runs": {
        "status": Verb("fleet.cli.live:status", "Show how a run is doing, and its faults."),
        "inject": Verb("fleet.cli.live:inject", "Inject a fault."),
        "heal": Verb("fleet.cli.live:heal", "End a fault, or all of them."),
        "clock": Verb("fleet.cli.live:clock", "Pause, step or pace a run."),
        "stop": Verb("fleet.cli.live:stop", "Stop a run; its log stays."),
    },
    "After a run": {
        "ls": Verb("fleet.cli.runs:ls", "List the live runs, and the runs below a directory."),
        "info": Verb("fleet.cli.info:info", "Summarise a log."),
        "export": Verb("fleet.cli.export:export", "Write a log as tables, or as a scenario."),
    },
    "Prove and change": {
        "verify": Verb("fleet.cli.verify:verify", "Run a log's scenario again and compare every byte."),
        "diff": Verb("fleet.cli.verify:diff", "Compare two logs."),
        "replay": Verb("fleet.cli.replay:replay", "Publish a log on zenoh again."),
        "recover": Verb("fleet.cli.verify:recover", "Save what is left of a damaged log."),
    },
    "Many runs": {},
    "Other hosts and programs": {},
    _LAST: {
        "about": Verb("fleet.cli.about:about", "Print everything that a bug report needs."),
        "completion": Verb("fleet.cli.completion:completion", "Print the script for completion in your shell."),
    },
}
# What users of other tools, or of earlier versions, type, and what it is called here.
HINTS = {
    "ps": "fleet ls",
    "prune": "fleet ls --prune",
    "check-log": "fleet check LOG",
    "script": "fleet export LOG --scenario",
    "schema": "fleet about --schemas",
    **dict.fromkeys(("rm", "remove", "delete", "clean"), "fleet ls --prune"),
    **dict.fromkeys(("logs", "runs", "history"), "fleet ls (all runs) or fleet info (what one log holds)"),
    "faults": "fleet status (those that are active; --all: every one)",
    "compare": "fleet diff",
    "play": "fleet replay",
    "resume": "fleet clock resume (a run that is held), or fleet run --from RUN@TIME (a new run from there)",
    **dict.fromkeys(("start", "up", "launch"), "fleet run"),
    **dict.fromkeys(("kill", "down", "abort"), "fleet stop (a run), or fleet inject kill 3 (an agent)"),
    "pause": "fleet clock pause (a run), or fleet inject pause 3 (an agent)",
    "validate": "fleet check",
    **dict.fromkeys(("bug", "doctor", "env", "version"), "fleet about (versions, machine and a run, for a bug report)"),
    "bench": "python -m benchmarks (in a checkout of uuv-fleet)",
    "scenarios": "fleet list",
    "test": "fleet run (a scenario and its checks)",
}
# What users expect of a command that has no such option, by command and option.
OTHER_OPTIONS = {
    ("run", "--dry-run"): "fleet check SCENARIO judges a scenario without a run; --show-config prints it",
}
_OF_THE_CORE = {name: verb for verbs in CORE.values() for name, verb in verbs.items()}


@cache
def headings() -> dict[str, dict[str, Verb]]:
    """The commands under each heading. No add-on replaces a command that is there already."""
    found = {title: dict(verbs) for title, verbs in CORE.items()}
    last = found.pop(_LAST)
    taken = set(_OF_THE_CORE)
    found_last = dict(last)
    for whose, addon in installed_addons().addons.items():
        for title, verbs in addon.verbs.items():
            for name in verbs.keys() & taken:
                leave_out(f"{whose}: fleet {name}", "there is a command of this name already")
            own = {name: verb for name, verb in verbs.items() if name not in taken}
            (found_last if title == _LAST else found.setdefault(title, {})).update(own)
            taken |= own.keys()
    return {title: verbs for title, verbs in found.items() if verbs} | {_LAST: found_last}


@cache
def every_verb() -> dict[str, Verb]:
    """All commands by name, in the order of the help."""
    return {name: verb for verbs in headings().values() for name, verb in verbs.items()}


def verb_of(name: str) -> Verb | None:
    """The command of a name; None: there is none. For one of the core no add-on is read."""
    return _OF_THE_CORE.get(name) or every_verb().get(name)


def hint_for(typed: str) -> str:
    """What a word is called here that is none of our commands; empty: it is not known."""
    said = [addon.hints.get(typed) for addon in installed_addons().addons.values()]
    return "; or ".join(dict.fromkeys(filter(None, [HINTS.get(typed), *said])))


def other_option(command: str, option: str) -> str:
    """What does what an option that there is not would do; empty: it is not known."""
    theirs = (addon.other_options.get((command, option)) for addon in installed_addons().addons.values())
    return OTHER_OPTIONS.get((command, option)) or next(filter(None, theirs), "")
