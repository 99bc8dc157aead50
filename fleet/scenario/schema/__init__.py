"""What a scenario may say: its sections, keys, units and defaults."""
