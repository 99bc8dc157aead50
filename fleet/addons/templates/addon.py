"""What this add-on offers."""

from __future__ import annotations

from fleet.addon import AddOn, Verb

ADDON = AddOn(
    verbs={
        "Start": {
            "new": Verb(
                "fleet.addons.templates.verb:new", "Write a scenario, law, protocol, program, check or vehicle."
            )
        }
    },
    hints=dict.fromkeys(("init", "create"), "fleet new"),
)
