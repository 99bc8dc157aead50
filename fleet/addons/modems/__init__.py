"""Acoustic modems that programs of others open: one core, and a translator for each language."""
