"""Anyone's environment together with its interface, as one environment."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np
from typing_extensions import override

from mmc_gym._errors import require
from mmc_gym.geometry import Floats, wrap_angle
from mmc_gym.interface.contract import ReachInterface

InterfaceLike: TypeAlias = "ReachInterface | str | Callable[[gym.Env[Any, Any]], ReachInterface]"


class InterfacedEnv(gym.Env[Any, Any]):
    """An environment, with its wrappers, together with the `ReachInterface` written for it.

    Observations, actions, rewards and ends of episodes are the environment's.  Infos have more
    entries, as the interface sees them: `end_effector`, `target`, `distance` between them,
    `joint_angles` (not wrapped), and `is_success` where the interface has a success distance.
    """

    def __init__(self, env: gym.Env[Any, Any], interface: InterfaceLike) -> None:
        """Join an environment with its interface.

        The environment is single; agents also accept a vector of equal ones.  The interface is a
        `ReachInterface`, "module:name" of one, or a function of the environment that returns one.
        """
        resolved: Any = interface
        if isinstance(interface, str):
            from mmc_gym._files import import_object  # `import mmc_gym` loads no yaml

            resolved = import_object(interface, "interface")
        accepted = "an object of a subclass of ReachInterface, a function of env or 'module:name'"
        if callable(resolved) and not isinstance(resolved, ReachInterface):
            try:
                inspect.signature(resolved).bind(env)
            except TypeError:  # such as a class, which takes segment lengths
                require(False, "interface", resolved, accepted)
            resolved = resolved(env)
        require(isinstance(resolved, ReachInterface), "interface", resolved, accepted)
        self.env, self.parameters, self.control = env, resolved, resolved.control
        self.reach = sum(resolved.segment_lengths)
        distance = resolved.success_distance
        self.success_distance = math.nan if distance is None else distance
        self.observation_space, self.action_space = env.observation_space, env.action_space
        self.metadata, self.spec = env.metadata, env.spec
        self.render_mode = getattr(env, "render_mode", None)
        self._joint_angles: Floats | None = None

    @override
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        self._joint_angles = None
        return observation, self._described(observation, info)

    @override
    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        space = self.action_space
        if isinstance(space, gym.spaces.Box) and np.size(action) != math.prod(space.shape):
            accepted = f"of shape {space.shape}, as the actions of env are"
            require(False, "action", np.shape(action), accepted)
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, self._described(observation, info)

    def _described(self, observation: Any, info: Mapping[str, Any]) -> dict[str, Any]:
        """Return the info with what the interface sees."""
        seen, before = self.parameters.look(observation), self._joint_angles
        turn = 0.0 if before is None else wrap_angle(seen.joint_angles - before)
        self._joint_angles = (seen.joint_angles if before is None else before) + turn
        distance = float(np.linalg.norm(seen.target - seen.hand))
        described = {"joint_angles": self._joint_angles, "end_effector": seen.hand}
        described |= {"target": seen.target, "distance": distance}
        if self.parameters.success_distance is not None:
            described["is_success"] = distance <= self.parameters.success_distance
        return {**info, **described}

    @override
    def render(self) -> Any:
        return self.env.render()

    @override
    def close(self) -> None:
        self.env.close()
