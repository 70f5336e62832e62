"""Controllers for the reaching environments, all behind stable-baselines3's `predict`."""

from mmc_gym.agents.base import Agent
from mmc_gym.agents.registry import (
    AGENTS,
    AgentEntry,
    agent_names,
    find_agent,
    is_policy_path,
    make_agent,
)

__all__ = [
    "AGENTS",
    "Agent",
    "AgentEntry",
    "agent_names",
    "find_agent",
    "is_policy_path",
    "make_agent",
]
