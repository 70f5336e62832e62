"""Train under perturbations that are drawn for each episode (domain randomisation).

    mmc-gym train my/ppo-mine.yml --import studies.learners.random_scenarios

where the YAML file has

    vec_env_wrapper:
      studies.learners.random_scenarios.RandomScenarios:
        groups: 16          # groups of environments, each with its own scenario; must divide n_envs
        names: [random, pursuit]
        ranges: {rotation: [-60, 60], locked: [1, 3]}
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from typing_extensions import override

from mmc_gym import UserError
from mmc_gym.envs.names import BASELINE, FAMILIES, TASKS, parse_change
from mmc_gym.envs.perturbations import Obstacles, SensoryDelay
from mmc_gym.envs.scenarios import Scenario, parse_scenario
from mmc_gym.training.hyperparameters import Recipe

Float32 = NDArray[np.float32]
VectorEnv: TypeAlias = gym.vector.VectorEnv[Any, Any, Any]


class RandomScenarios(VecEnvWrapper):
    """Arms in groups; each group draws a scenario for every episode (domain randomisation).

    Each of the `names` and of the `ranges` is equally likely to be drawn; a strength is uniform in
    its range.  The wrapped environment gives number, control mode, engine and other arguments of
    the arms, and never moves.  Groups with obstacles move in pymunk, because the analytic engine
    knows no collisions.  The first episodes of the groups have different lengths, so that later
    ones end at different steps.

    Source: Peng, Andrychowicz, Zaremba & Abbeel (2018), Sim-to-real transfer of robotic control
    with dynamics randomization, ICRA, https://arxiv.org/abs/1710.06537.
    """

    def __init__(
        self,
        venv: VecEnv,
        names: Sequence[str] = ("random",),
        ranges: Mapping[str, Sequence[float]] | None = None,
        groups: int = 32,
    ) -> None:
        """Wrap a vector of equal environments, a multiple of `groups`.

        The `names` are of scenarios, see `mmc_gym.envs.scenarios.parse_scenario`.  The `ranges` are
        lowest and highest strength of families of perturbations by name, both included; where
        strengths are whole numbers, only those are drawn.
        """
        super().__init__(venv)
        if not isinstance(groups, int) or groups < 1 or venv.num_envs % groups:
            accepted = f"a divisor of the {venv.num_envs} environments"
            raise UserError(f"groups must be {accepted}, got {groups}")
        self._fixed = [parse_scenario(name) for name in names]
        self._ranges = {name: _range(name, ends) for name, ends in (ranges or {}).items()}
        if not self._fixed and not self._ranges:
            raise UserError(f"names must be one at least, without ranges, got {names}")
        spec = venv.get_attr("spec")[0]
        own = ("task", "num_envs", "max_episode_steps", "render_mode")
        self._arguments = {key: value for key, value in spec.kwargs.items() if key not in own}
        self._size = venv.num_envs // groups
        self._control_step = venv.get_attr("parameters")[0].control_step
        ends = [_scenario(name, end) for name in self._ranges for end in self._ranges[name]]
        for one in (*self._fixed, *ends):
            self.make_group(one).close()  # refused here rather than in the training
        self._random = np.random.default_rng()
        self._groups: list[VectorEnv | None] = [None] * groups

    @override
    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        self._random = np.random.default_rng(seed)
        return self.venv.seed(seed)

    @override
    def reset(self) -> VecEnvObs:
        count = len(self._groups)
        return np.concatenate([self._begin(group, (group + 1) / count) for group in range(count)])

    @override
    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = np.split(actions, len(self._groups))

    @override
    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, dones = [], [], []
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for group, actions in enumerate(self._actions):
            env = cast(VectorEnv, self._groups[group])
            observation, reward, _, over, _ = env.step(actions)
            if over.all():  # the episodes of a group end together
                for row, last in zip(infos[group * self._size :], observation.copy()):
                    row |= {"terminal_observation": last, "TimeLimit.truncated": True}
                observation = self._begin(group)
            observations.append(observation)
            rewards.append(reward)
            dones.append(over)
        together = np.concatenate(rewards).astype(np.float32), np.concatenate(dones)
        return np.concatenate(observations), *together, infos

    @override
    def close(self) -> None:
        for env in self._groups:
            if env is not None:
                env.close()
        self.venv.close()

    def draw_group(self, share: float) -> VectorEnv:
        """Make the arms of a group in a random scenario, see `make_group`."""
        return self.make_group(self.draw(), share)

    def make_group(self, drawn: Scenario, share: float = 1.0) -> VectorEnv:
        """Make the arms of a group; their episode has `share` of the usual length."""
        env_id, own = drawn.for_gymnasium()
        arguments = {**self._arguments, **own, "autoreset_mode": "Disabled"}
        perturbations = [one.perturbation for one in drawn.changes]
        arguments["perturbations"] = [
            one
            for one in perturbations  # less than half a control step is no delay
            if not isinstance(one, SensoryDelay) or round(one.seconds / self._control_step)
        ]
        if any(isinstance(one, Obstacles) for one in perturbations):
            arguments["engine"] = "pymunk"
        steps = drawn.task.task.episode_steps
        arguments["max_episode_steps"] = max(1, round(share * steps))
        return gym.make_vec(env_id, self._size, copy=False, **arguments)

    def draw(self) -> Scenario:
        """Return a random scenario."""
        index = int(self._random.integers(len(self._fixed) + len(self._ranges)))
        if index < len(self._fixed):
            return self._fixed[index]
        name = list(self._ranges)[index - len(self._fixed)]
        low, high = self._ranges[name]
        if FAMILIES[name].whole:
            return _scenario(name, float(self._random.integers(int(low), int(high) + 1)))
        return _scenario(name, float(self._random.uniform(low, high)))

    def _begin(self, group: int, share: float = 1.0) -> Float32:
        """Draw a scenario for a group, and return its first observations."""
        if (old := self._groups[group]) is not None:
            old.close()
        self._groups[group] = made = self.draw_group(share)
        observation, _ = made.reset(seed=int(self._random.integers(2**31)))
        return observation


def _range(name: str, ends: Sequence[float]) -> tuple[float, float]:
    """Check and return a range of strengths."""
    if len(ends) != 2 or ends[0] > ends[1]:
        accepted = "the lowest and the highest strength"
        raise UserError(f"ranges[{name!r}] must be {accepted}, got {ends}")
    low, high = float(ends[0]), float(ends[1])
    family = parse_change(name).family
    assert family is not None
    between = [] if family.whole else [low + (high - low) / math.e]  # any of them can be drawn
    for strength in (low, high, *between):
        family.with_strength(strength)
    return low, high


def _scenario(family: str, strength: float) -> Scenario:
    """Return the scenario of a perturbation of this strength."""
    return Scenario(TASKS[BASELINE], (FAMILIES[family].with_strength(strength),))


Recipe.classes[f"{__name__}.{RandomScenarios.__name__}"] = RandomScenarios
