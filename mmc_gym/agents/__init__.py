"""Controllers for the reaching environments, all behind stable-baselines3's `predict`."""

from mmc_gym.agents.base import Agent, Predictor
from mmc_gym.agents.registry import AGENTS, REFERENCE, AgentEntry, Knowledge
from mmc_gym.agents.resolved import ResolvedAgent
from mmc_gym.agents.resolver import make_agent, resolve, resolve_all

__all__ = [
    "AGENTS",
    "REFERENCE",
    "Agent",
    "AgentEntry",
    "Knowledge",
    "Predictor",
    "ResolvedAgent",
    "make_agent",
    "resolve",
    "resolve_all",
]
