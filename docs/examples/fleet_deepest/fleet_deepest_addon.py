"""What the add-on offers. It is a module of its own, because each start of `fleet` reads it."""

from fleet.addon import AddOn, Verb

ADDON = AddOn(
    verbs={"After a run": {"deepest": Verb("fleet_deepest:deepest", "Say how deep each vehicle was.")}},
    exporters=("fleet_deepest:Svg",),
)
