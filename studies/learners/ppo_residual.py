"""Define `ppo-residual`, a policy that corrects the actions of `mmc`.

    python -m studies.learners.train_all --names ppo-residual --seeds 1

The five policies that ship were trained in this way, with the seeds 0 to 4.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from typing_extensions import override

from mmc_gym import UserError
from mmc_gym.agents.policy import BASE_AGENTS, corrected
from mmc_gym.interface import ReachInterface
from mmc_gym.training.hyperparameters import Recipe

HYPERPARAMETERS = Path(__file__).with_name("ppo-residual.yml")


class Residual(VecEnvWrapper):
    """A reaching environment whose actions correct those of a base agent.

    The action that the base agent proposes follows the observation.
    """

    def __init__(self, venv: VecEnv, base_agent: str = "mmc") -> None:
        """Wrap an environment with Box observations; `base_agent` is a key of `BASE_AGENTS`."""
        if base_agent not in BASE_AGENTS:
            raise UserError(f"base_agent must be one of {list(BASE_AGENTS)}, got {base_agent!r}")
        space, action = venv.observation_space, venv.action_space
        if not isinstance(space, spaces.Box) or not isinstance(action, spaces.Box):
            raise UserError(f"venv must have Box observations, got {space}")
        low = np.concatenate((space.low, action.low))
        high = np.concatenate((space.high, action.high))
        super().__init__(venv, spaces.Box(low, high, dtype=np.float32))
        self.base_agent = base_agent
        self._base = BASE_AGENTS[base_agent](ReachInterface.of(venv))

    @override
    def reset(self) -> VecEnvObs:
        observation = self.venv.reset()
        assert isinstance(observation, np.ndarray)
        self._proposal, self._state = self._base.predict(observation)
        return np.concatenate((observation, self._proposal), axis=-1)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Begin a step with corrections, of shape (n, N)."""
        self.venv.step_async(corrected(self._proposal, actions))

    @override
    def step_wait(self) -> VecEnvStepReturn:
        observation, rewards, dones, infos = self.venv.step_wait()
        assert isinstance(observation, np.ndarray)
        if dones.any():  # at the last observation the base agent would have proposed this
            last, ended = observation.copy(), np.flatnonzero(dones)
            last[ended] = [infos[index]["terminal_observation"] for index in ended]
            proposal, _ = self._base.predict(last, self._state)
            for index in ended:
                ending = (last[index], proposal[index])
                infos[index]["terminal_observation"] = np.concatenate(ending)
        self._proposal, self._state = self._base.predict(observation, self._state, dones)
        return np.concatenate((observation, self._proposal), axis=-1), rewards, dones, infos


Recipe.classes["studies.learners.ppo_residual.Residual"] = Residual
