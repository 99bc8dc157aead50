"""The acoustic modems that ship, as data."""
