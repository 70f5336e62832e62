"""Residual reinforcement learning: a policy learns to correct another agent's actions.

Around any stable-baselines3 environment, `Residual` has the base agent act in it.  A policy sees
the observation and, behind it, the action that the base agent proposes; its own action is added
to that one (see `corrected`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from mmc_gym.agents.base import ReachInterface
from mmc_gym.agents.policy import BASE_AGENTS, corrected


class Residual(VecEnvWrapper):
    """An environment whose actions are corrections of a base agent's.

    Attributes:
        base_agent: which agent, a key of `BASE_AGENTS`.
    """

    def __init__(self, venv: VecEnv, base_agent: str = "mmc") -> None:
        """Wrap an environment with `Box` observations.

        Args:
            venv: of reaching environments.
            base_agent: a key of `BASE_AGENTS`.

        Raises:
            ValueError: if there is no such agent, or the observations are of another kind.
        """
        if base_agent not in BASE_AGENTS:
            raise ValueError(f"base_agent must be one of {list(BASE_AGENTS)}, got {base_agent!r}")
        space, action = venv.observation_space, venv.action_space
        if not isinstance(space, spaces.Box) or not isinstance(action, spaces.Box):
            raise ValueError(f"venv must have Box observations, got {space}")
        low, high = (
            np.concatenate(pair) for pair in zip((space.low, space.high), (action.low, action.high))
        )
        super().__init__(venv, spaces.Box(low, high, dtype=np.float32))
        self.base_agent = base_agent
        body, control = venv.get_attr("parameters")[0], venv.get_attr("control")[0]
        self._base = BASE_AGENTS[base_agent](ReachInterface.told(body, control))

    def reset(self) -> VecEnvObs:
        """Start an episode in every environment."""
        observation = self.venv.reset()
        assert isinstance(observation, np.ndarray)
        self._proposal, self._state = self._base.predict(observation)
        return np.concatenate((observation, self._proposal), axis=-1)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take note of the corrections, of shape (n, N)."""
        self.venv.step_async(corrected(self._proposal, actions))

    def step_wait(self) -> VecEnvStepReturn:
        """Step all environments by the corrected actions."""
        observation, rewards, dones, infos = self.venv.step_wait()
        assert isinstance(observation, np.ndarray)
        if dones.any():  # what the base agent would have gone on to do
            last = observation.copy()
            for index in np.flatnonzero(dones):
                last[index] = infos[index]["terminal_observation"]
            proposal, _ = self._base.predict(last, self._state)
            for index in np.flatnonzero(dones):
                ending = (last[index], proposal[index])
                infos[index]["terminal_observation"] = np.concatenate(ending)
        self._proposal, self._state = self._base.predict(observation, self._state, dones)
        return np.concatenate((observation, self._proposal), axis=-1), rewards, dones, infos
