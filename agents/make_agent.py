"""Which core an agent gets: ours, or a user's. Not compiled, so that another can be put in its place."""

from __future__ import annotations

from agents.agent import Agent
from agents.config import AgentConfig
from agents.plugged_agent import PluggedAgent


def make_agent(config: AgentConfig) -> Agent | PluggedAgent:
    """Make the core of an agent: ours, or a user's whole agent where the configuration names one. Raises PluginError if
    one of its laws cannot be used; ControllerError if one of its laws cannot be made.
    """
    return Agent(config) if config.agent is None else PluggedAgent(config, config.agent)
