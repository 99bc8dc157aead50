"""Agents: they turn measurements and messages into commands and messages; laws plug in through agents.api."""
