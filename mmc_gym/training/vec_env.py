"""Gymnasium's vector environments for stable-baselines3: one step of arrays for many arms."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.env_util import is_wrapped
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import (
    VecEnvIndices,
    VecEnvObs,
    VecEnvStepReturn,
)
from typing_extensions import override

from mmc_gym._errors import UserError
from mmc_gym.agents.policy import BASE_AGENTS, corrected
from mmc_gym.interface import ReachInterface

Info = dict[str, Any]

_SINGLE = {name: f"single_{name}" for name in ("action_space", "observation_space")}
_OF_EACH = ("np_random", "np_random_seed")  # a vector environment has a tuple of them
_OF_ALL = ("close", "render", "reset", "step")  # it does for all at once


class GymnasiumVecEnv(VecEnv):
    """A `gymnasium.vector.VectorEnv` as a stable-baselines3 `VecEnv`.

    It does what `DummyVecEnv` does with the same environments, seeds and actions.  But infos are
    empty where no episode has ended: to make them would take longer than the step itself.  Where
    one has ended they are complete, with `terminal_observation` and `TimeLimit.truncated`, which is
    all that stable-baselines3 reads.  `info_keys` asks for more.

    Attributes:
        vector_env: the environment inside.
        reset_infos: infos of the latest reset of each environment.

    >>> import gymnasium as gym, mmc_gym
    >>> from stable_baselines3 import PPO
    >>> env = GymnasiumVecEnv(gym.make_vec("MMCReach-v0", 64, autoreset_mode="SameStep"))
    >>> model = PPO("MlpPolicy", env, n_steps=64, device="cpu").learn(4096)
    """

    def __init__(self, vector_env: VectorEnv[Any, Any, Any], info_keys: Sequence[str] = ()) -> None:
        """Adapt an environment that restarts in the step that ends an episode.

        Args:
            vector_env: with the autoreset mode "SameStep".
            info_keys: names of infos to give in every step.

        Raises:
            UserError: if the environment has another autoreset mode.
        """
        mode = vector_env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise UserError(
                "vector_env must restart in the step that ends an episode, as one made by "
                f"gym.make_vec(..., autoreset_mode='SameStep') does, got autoreset_mode={mode}"
            )
        self.vector_env = vector_env
        self.info_keys = tuple(info_keys)
        super().__init__(
            vector_env.num_envs,
            vector_env.single_observation_space,
            vector_env.single_action_space,
        )
        self.metadata = vector_env.metadata
        self._was_reset = False

    def reset(self) -> VecEnvObs:
        """Start an episode in every environment, with the seeds and options set for it."""
        seed, options = self._seeds[0], self._options
        if all(data_equivalence(options[0], one) for one in options[1:]):
            observation, infos = self.vector_env.reset(seed=seed, options=dict(options[0]) or None)
            self.reset_infos = [_row(infos, index) for index in range(self.num_envs)]
        else:
            if not self._was_reset:
                self.vector_env.reset()
            for index, own in enumerate(options):
                mask = np.arange(self.num_envs) == index
                observation, infos = self.vector_env.reset(
                    seed=seed, options={**own, "reset_mask": mask}
                )
                self.reset_infos[index] = _row(infos, index)
        self._was_reset = True
        self._reset_seeds()
        self._reset_options()
        return observation  # type: ignore[no-any-return]

    @override
    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions

    @override
    def step_wait(self) -> VecEnvStepReturn:
        observation, rewards, terminated, truncated, infos = self.vector_env.step(self._actions)
        dones = terminated | truncated
        rows: list[Info] = [{} for _ in range(self.num_envs)]
        if self.info_keys:
            names = {name for key in self.info_keys for name in (key, f"_{key}")}
            chosen = {name: infos[name] for name in sorted(names & infos.keys())}
            rows = [_row(chosen, index) for index in range(self.num_envs)]
        for index in np.flatnonzero(dones).tolist():
            begun = _row(infos, index)
            rows[index] |= begun.pop("final_info")
            rows[index]["terminal_observation"] = begun.pop("final_obs")
            rows[index]["TimeLimit.truncated"] = bool(truncated[index] and not terminated[index])
            self.reset_infos[index] = begun
        return observation, rewards.astype(np.float32), dones, rows

    @override
    def close(self) -> None:
        self.vector_env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture of each environment, if its render mode is "rgb_array"."""
        if self.render_mode != "rgb_array":
            warnings.warn(
                f"render_mode must be 'rgb_array' for pictures, got {self.render_mode!r}",
                stacklevel=2,
            )
            return [None] * self.num_envs
        pictures: Any = self.vector_env.render()
        return list(pictures)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return the attribute of each chosen environment: all share a native one's."""
        values = self._values(attr_name)
        return [values[index] for index in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set the attribute of the chosen environments.

        Raises:
            UserError: if only some are chosen of a native vector environment.
        """
        chosen = self._chosen(indices)
        everywhere = set(chosen) == set(range(self.num_envs))
        env: Any = self.vector_env.unwrapped
        if hasattr(env, "set_attr"):
            values = [value] * self.num_envs if everywhere else self._values(attr_name)
            for index in chosen:
                values[index] = value
            env.set_attr(attr_name, values)
        elif everywhere:
            setattr(env, attr_name, value)
        else:
            raise UserError(
                f"indices must be those of all {self.num_envs} environments, which are one "
                f"object, to set {attr_name!r}, got {chosen}"
            )

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method once for each chosen environment; return the results.

        Raises:
            UserError: if a native vector environment has it only for all at once.
        """
        chosen = self._chosen(indices)
        env: Any = self.vector_env.unwrapped
        if hasattr(env, "call"):
            returned = env.call(method_name, *method_args, **method_kwargs)
            return [returned[index] for index in chosen]
        if method_name in _OF_ALL:
            raise UserError(
                f"method_name must not be {method_name!r}, which all environments do at once: "
                "call the method of that name of the VecEnv itself"
            )
        method = getattr(self.vector_env, method_name)
        return [method(*method_args, **method_kwargs) for _ in chosen]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Tell of each chosen environment whether it is in such a wrapper: no native arm is."""
        envs = getattr(self.vector_env.unwrapped, "envs", None)
        return [
            envs is not None and is_wrapped(envs[index], wrapper_class)
            for index in self._chosen(indices)
        ]

    def _chosen(self, indices: VecEnvIndices) -> list[int]:
        return [int(index) for index in self._get_indices(indices)]

    def _values(self, name: str) -> list[Any]:
        env: Any = self.vector_env.unwrapped
        if hasattr(env, "get_attr"):
            return list(env.get_attr(name))
        value = getattr(self.vector_env, _SINGLE.get(name, name))
        return list(value) if name in _OF_EACH else [value] * self.num_envs


def _row(infos: Info, index: int) -> Info:
    """Return the info of one environment, out of Gymnasium's arrays with a mask for each."""
    row = {}
    for name, values in infos.items():
        mask = infos.get(f"_{name}")
        if mask is None and name.startswith("_"):  # a mask itself
            continue
        if mask is None or mask[index]:
            row[name] = _row(values, index) if isinstance(values, dict) else values[index]
    return row


class Residual(VecEnvWrapper):
    """A reaching environment whose actions correct those of a base agent.

    Its proposed action follows the observation.
    """

    def __init__(self, venv: VecEnv, base_agent: str = "mmc") -> None:
        """Wrap an environment with `Box` observations; `base_agent` is a key of `BASE_AGENTS`.

        Raises:
            UserError: if there is no such agent, or the observations are of another kind.
        """
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
        """Take note of the corrections, of shape (n, N)."""
        self.venv.step_async(corrected(self._proposal, actions))

    @override
    def step_wait(self) -> VecEnvStepReturn:
        observation, rewards, dones, infos = self.venv.step_wait()
        assert isinstance(observation, np.ndarray)
        if dones.any():  # what the base agent would have gone on to do
            last, ended = observation.copy(), np.flatnonzero(dones)
            last[ended] = [infos[index]["terminal_observation"] for index in ended]
            proposal, _ = self._base.predict(last, self._state)
            for index in ended:
                ending = (last[index], proposal[index])
                infos[index]["terminal_observation"] = np.concatenate(ending)
        self._proposal, self._state = self._base.predict(observation, self._state, dones)
        return np.concatenate((observation, self._proposal), axis=-1), rewards, dones, infos
