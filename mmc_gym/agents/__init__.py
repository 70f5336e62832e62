"""Controllers for the reaching environments, all behind stable-baselines3's `predict`."""

from mmc_gym.agents.base import Agent, Predictor
from mmc_gym.agents.registry import AGENTS, AgentEntry, Knowledge
from mmc_gym.agents.resolver import ResolvedAgent, agent_names, make_agent, resolve, shipped_seeds

__all__ = [
    "AGENTS",
    "Agent",
    "AgentEntry",
    "Knowledge",
    "Predictor",
    "ResolvedAgent",
    "agent_names",
    "make_agent",
    "resolve",
    "shipped_seeds",
]
