"""Cooperative localisation: where a vehicle is by its own navigator and by ranges to others that say where they are."""
