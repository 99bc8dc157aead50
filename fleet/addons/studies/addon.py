"""What this add-on offers."""

from __future__ import annotations

from fleet.addon import AddOn, Verb

_AT = "fleet.addons.studies"
ADDON = AddOn(
    verbs={
        "Prove and change": {
            "why": Verb(f"{_AT}.verbs.explain:why", "Explain why a check failed."),
            "whatif": Verb(f"{_AT}.verbs.explain:whatif", "Compare another agent's commands with the log's."),
        },
        "Many runs": {
            "sweep": Verb(f"{_AT}.verbs.sweep:sweep", "Run a scenario at many values and seeds."),
            "boundary": Verb(f"{_AT}.verbs.boundary:boundary", "Find where a scenario begins to fail."),
            "search": Verb(f"{_AT}.verbs.search:search", "Try random faults until a check fails."),
            "regress": Verb(f"{_AT}.verbs.search:regress", "Repeat the failures that a search has kept."),
            "rare": Verb(f"{_AT}.verbs.search:rare", "Estimate how often a check fails, if it is rare."),
            "shrink": Verb(f"{_AT}.verbs.search:shrink", "Make a failing run as small as possible."),
        },
    },
    names=dict.fromkeys(("Boundary", "Study", "boundary", "open_study", "sweep"), f"{_AT}.study"),
    readers=(f"{_AT}.reader:StudyData",),
    listings=(f"{_AT}.listing:Studies",),
    other_options={
        ("run", "--seeds"): "fleet sweep SCENARIO --seeds 20 makes a run with each seed",
        ("run", "--vary"): "fleet sweep SCENARIO --vary 'KEY=VALUES' makes a run with each value",
        ("sweep", "--runs"): "--seeds 20 makes 20 runs of each point",
        ("boundary", "--runs"): "--seeds 100 makes 100 runs at most",
        ("search", "--runs"): "--budget 100 tries 100 seeds at most",
        ("shrink", "--runs"): "--budget 100 makes 100 runs at most",
    },
)
