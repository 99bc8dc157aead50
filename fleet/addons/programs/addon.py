"""What this add-on offers."""

from __future__ import annotations

from fleet.addon import AddOn

ADDON = AddOn(companions=("fleet.addons.programs.attach_option:Attach",))
