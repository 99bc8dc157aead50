"""Agents: what each vehicle measures and hears becomes what it does and sends; laws plug in through agents.api."""
