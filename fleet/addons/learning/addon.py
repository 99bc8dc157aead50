"""What this add-on offers."""

from __future__ import annotations

from fleet.addon import AddOn

ADDON = AddOn(names={"parallel_env": "fleet.addons.learning.parallel_env"})
