"""The sections of a scenario: their keys, units and defaults."""
