"""Adapters for stable-baselines3: Gymnasium's vector environments, and a memory of observations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn
from typing_extensions import override

from mmc_gym._errors import require
from mmc_gym.agents.policy_network import History
from mmc_gym.interface import ReachInterface

VectorEnv: TypeAlias = gym.vector.VectorEnv[Any, Any, Any]
Info = dict[str, Any]


class GymnasiumVecEnv(VecEnv):
    """A native vector environment, made by `gym.make_vec`, as a stable-baselines3 `VecEnv`.

    It does what `DummyVecEnv` does with the same environments, seeds and actions, except that an
    info is empty unless its episode has just ended: making all infos would take longer than the
    step itself.  At the end of an episode the info is complete, with `terminal_observation` and
    `TimeLimit.truncated`; stable-baselines3 reads no other infos.

    >>> import gymnasium as gym, mmc_gym
    >>> from stable_baselines3 import PPO
    >>> env = GymnasiumVecEnv(gym.make_vec("MMCReach-v0", 64, autoreset_mode="SameStep"))
    >>> model = PPO("MlpPolicy", env, n_steps=64, device="cpu").learn(4096)
    """

    def __init__(self, vector_env: VectorEnv) -> None:
        """Adapt an environment; raise a `UserError` unless its autoreset mode is "SameStep"."""
        mode = vector_env.metadata.get("autoreset_mode")
        accepted = "AutoresetMode.SAME_STEP, as in gym.make_vec(..., autoreset_mode='SameStep')"
        require(mode == AutoresetMode.SAME_STEP, "autoreset_mode of vector_env", mode, accepted)
        self.vector_env = vector_env
        super().__init__(
            vector_env.num_envs, vector_env.single_observation_space, vector_env.single_action_space
        )
        self.metadata = vector_env.metadata

    def reset(self) -> VecEnvObs:
        """Reset all environments with the seeds and options set before, and return observations.

        Raise a `UserError` if options differ between environments.
        """
        options = self._options
        are_equal = all(data_equivalence(options[0], other) for other in options[1:])
        require(are_equal, "options", options, "the same for all environments")
        shared_options = dict(options[0]) or None
        observation, infos = self.vector_env.reset(seed=self._seeds[0], options=shared_options)
        self.reset_infos = [_row(infos, index) for index in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observation

    @override
    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions

    @override
    def step_wait(self) -> VecEnvStepReturn:
        observation, rewards, terminated, truncated, infos = self.vector_env.step(self._actions)
        dones = terminated | truncated
        rows: list[Info] = [{} for _ in range(self.num_envs)]
        for index in np.flatnonzero(dones).tolist():
            begun = _row(infos, index)
            rows[index] = begun.pop("final_info")
            rows[index]["terminal_observation"] = begun.pop("final_obs")
            rows[index]["TimeLimit.truncated"] = bool(truncated[index] and not terminated[index])
            self.reset_infos[index] = begun
        return observation, rewards.astype(np.float32), dones, rows

    @override
    def close(self) -> None:
        self.vector_env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute, which all environments share, once per chosen environment."""
        is_space = attr_name in ("action_space", "observation_space")
        value = getattr(self.vector_env, f"single_{attr_name}" if is_space else attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of all environments; raise a `UserError` if only some are chosen."""
        require(indices is None, "indices", indices, f"None, to set {attr_name!r} of all")
        setattr(self.vector_env.unwrapped, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment once per chosen environment; return results."""
        method = getattr(self.vector_env, method_name)
        return [method(*args, **kwargs) for _ in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return False for each chosen environment: an arm in a vector has no wrapper."""
        return [False for _ in self._get_indices(indices)]


class Memory(VecEnvWrapper):
    """A wrapper that appends past steps, averaged in blocks by a `History`, to each observation.

    It gives any algorithm, such as plain PPO, a memory of observations and actions.

    >>> import gymnasium as gym, mmc_gym
    >>> env = GymnasiumVecEnv(gym.make_vec("MMCReach-v0", 2, autoreset_mode="SameStep"))
    >>> Memory(env, [1, 1, 2, 4]).reset().shape
    (2, 55)
    """

    def __init__(self, venv: VecEnv, blocks: Sequence[int]) -> None:
        """Wrap an environment with Box observations; `blocks` has the number of steps per block."""
        self.blocks = tuple(blocks)
        self._history, space = _remembering(venv, self.blocks)
        super().__init__(venv, space)

    @property
    def single_wrapper(self) -> Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]]:
        """The function that puts a single environment into the same memory."""
        return partial(MemoryObservation, blocks=self.blocks)

    @override
    def reset(self) -> VecEnvObs:
        observation: Any = self.venv.reset()
        self._memory = self._history.start(observation)
        self._now, shown = self._history.appended(observation, self._memory)
        return shown

    @override
    def step_async(self, actions: NDArray[Any]) -> None:
        taken = np.asarray(actions, np.float32)
        self._memory = self._history.extended(self._now, taken, self._memory)
        self.venv.step_async(actions)

    @override
    def step_wait(self) -> VecEnvStepReturn:
        observation, rewards, dones, infos = self.venv.step_wait()
        seen: Any = observation  # the next episode's first one where an episode has ended
        for index in np.flatnonzero(dones).tolist():
            last = infos[index]["terminal_observation"]
            _, shown = self._history.appended(last, self._memory[index])
            infos[index]["terminal_observation"] = shown
            self._memory[index] = self._history.start(seen[index])
        self._now, shown = self._history.appended(seen, self._memory)
        return shown, rewards, dones, infos


class MemoryObservation(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """The `Memory` of a single environment, in which a model that was saved is compared.

    >>> import gymnasium as gym, mmc_gym
    >>> MemoryObservation(gym.make("MMCReach-v0"), [1, 1, 2, 4]).reset()[0].shape
    (55,)
    """

    def __init__(self, env: gym.Env[Any, Any], blocks: Sequence[int]) -> None:
        """Wrap an environment with Box observations; `blocks` has the number of steps per block."""
        gym.utils.RecordConstructorArgs.__init__(self, blocks=blocks)
        super().__init__(env)
        self._history, self.observation_space = _remembering(env, blocks)

    @override
    def reset(self, **options: Any) -> tuple[Any, Info]:
        observation, info = self.env.reset(**options)
        self._memory = self._history.start(observation)
        self._now, shown = self._history.appended(observation, self._memory)
        return shown, info

    @override
    def step(self, action: Any) -> tuple[Any, Any, bool, bool, Info]:
        taken = np.asarray(action, np.float32)
        self._memory = self._history.extended(self._now, taken, self._memory)
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._now, shown = self._history.appended(observation, self._memory)
        return shown, reward, terminated, truncated, info


def _remembering(env: Any, blocks: Sequence[int]) -> tuple[History, gym.spaces.Box]:
    """Return the memory of an environment, and the space of observations with it."""
    space, accepted = env.observation_space, "Box observations, which MMCReachGoal-v0 has not"
    require(isinstance(space, gym.spaces.Box), "observation_space", space, accepted)
    history = History(ReachInterface.of(env).layout, blocks)
    unbounded = np.full(history.size, np.inf, np.float32)
    low, high = np.concatenate((space.low, -unbounded)), np.concatenate((space.high, unbounded))
    return history, gym.spaces.Box(low, high, dtype=np.float32)


def _row(infos: Info, index: int) -> Info:
    """Return one environment's info from Gymnasium's vector infos: arrays, each with a mask."""
    row = {}
    for name, values in infos.items():
        mask = infos.get(f"_{name}")
        if mask is None and name.startswith("_"):  # a mask itself
            continue
        if mask is None or mask[index]:
            row[name] = _row(values, index) if isinstance(values, dict) else values[index]
    return row
