"""What this add-on offers."""

from __future__ import annotations

from fleet.addon import AddOn, Verb

ADDON = AddOn(
    verbs={
        "Start": {
            "reproduce": Verb(
                "fleet.addons.paper.verb:reproduce", "Run the paper's simulations again and judge its claims."
            )
        }
    },
)
