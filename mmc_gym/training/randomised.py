"""Train under perturbations that are drawn anew for each episode, with a memory of what happened.

Source of the idea: domain randomisation with a memory, Peng, Andrychowicz, Zaremba & Abbeel (2018),
Sim-to-real transfer of robotic control with dynamics randomization, ICRA,
https://arxiv.org/abs/1710.06537.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from typing_extensions import override

from mmc_gym._errors import UserError, is_whole, require
from mmc_gym.agents.views import History
from mmc_gym.envs.perturbations import Obstacles
from mmc_gym.envs.scenarios import FAMILIES, Scenario, scenario
from mmc_gym.interface import ReachInterface
from mmc_gym.training.vec_env import GymnasiumVecEnv


class RandomScenarios(VecEnvWrapper):
    """Arms in groups; each group draws a scenario for every episode.

    What is drawn is one of `names`, or a perturbation of one of the `ranges`, all as likely, of a
    strength that is as likely as any other in its range.  With the probability `twice` a second
    perturbation comes on top, where it can.  The wrapped environment gives number, control mode,
    engine and other arguments of the arms, and never moves.  Groups with obstacles move in pymunk,
    for the analytic engine knows no collisions.

    Groups begin one after the other: their episodes end at different steps.
    """

    def __init__(
        self,
        venv: VecEnv,
        names: Sequence[str] = ("random",),
        ranges: Mapping[str, Sequence[float]] | None = None,
        groups: int = 32,
        twice: float = 0.0,
    ) -> None:
        """Wrap a vector of equal environments.

        Args:
            venv: of a multiple of `groups` arms.
            names: of scenarios, see `mmc_gym.envs.scenarios.scenario`.
            ranges: lowest and highest strength of families of perturbations, by name.
            groups: number of groups.
            twice: probability of a second perturbation, a task's included.

        Raises:
            UserError: if a name or a strength is not accepted, or the groups are not.
        """
        super().__init__(venv)
        fine = is_whole(groups) and groups >= 1 and venv.num_envs % groups == 0
        require(fine, "groups", groups, f"a divisor of the {venv.num_envs} environments")
        require(0 <= twice <= 1, "twice", twice, "a probability")
        self._fixed = [scenario(name) for name in names]
        self._ranges = {name: _range(name, ends) for name, ends in (ranges or {}).items()}
        require(bool(self._fixed or self._ranges), "names", names, "one at least, without ranges")
        spec = venv.get_attr("spec")[0]
        own = ("task", "num_envs", "max_episode_steps")
        self._arguments = {key: value for key, value in spec.kwargs.items() if key not in own}
        self._size, self._twice = venv.num_envs // groups, twice
        for one in self._fixed:
            self._made(one, 1.0).close()  # refused here, if it is
        self._random = np.random.default_rng()
        self._groups: list[GymnasiumVecEnv | None] = [None] * groups

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
        for env, part in zip(self._groups, np.split(actions, len(self._groups)), strict=True):
            assert env is not None
            env.step_async(part)

    @override
    def step_wait(self) -> VecEnvStepReturn:
        seen, rewards, dones, infos = zip(*(env.step_wait() for env in self._groups if env))
        observations = list(seen)
        for group, over in enumerate(dones):
            if over.all():  # all of a group end at once
                observations[group] = self._begin(group)
        together = np.concatenate(observations), np.concatenate(rewards), np.concatenate(dones)
        return *together, [info for part in infos for info in part]

    @override
    def close(self) -> None:
        for env in self._groups:
            if env is not None:
                env.close()
        self.venv.close()

    def _begin(self, group: int, share: float = 1.0) -> NDArray[np.float32]:
        """Give a group a scenario, and return its first observations.

        The episode lasts this share of what it lasts otherwise.
        """
        old = self._groups[group]
        if old is not None:
            old.close()
        made = None
        while made is None:
            try:
                made = self._made(self._draw(), share)
            except UserError:  # a task that the arm cannot do under a second perturbation
                continue
        env = self._groups[group] = GymnasiumVecEnv(made)
        env.seed(int(self._random.integers(2**31)))
        observation = env.reset()
        assert isinstance(observation, np.ndarray)
        return observation

    def _made(self, drawn: Scenario, share: float) -> gym.vector.VectorEnv[Any, Any, Any]:
        arguments = {**self._arguments, **drawn.arguments, "autoreset_mode": "SameStep"}
        if any(isinstance(one, Obstacles) for one in drawn.perturbations):
            arguments["engine"] = "pymunk"
        steps = gym.spec(drawn.env_id).max_episode_steps or 1
        arguments["max_episode_steps"] = max(1, round(share * steps))
        return gym.make_vec(drawn.env_id, self._size, **arguments)

    def _draw(self) -> Scenario:
        """Return a scenario, with one perturbation more now and then."""
        first = self._draw_one()
        if self._random.random() >= self._twice:
            return first
        second = self._draw_one()
        kinds = {type(one) for one in first.perturbations}
        fits = not any(type(one) in kinds for one in second.perturbations)
        if second.task != "random" and first.task == "random":
            first, second = second, first
        if not fits or second.task != "random":
            return first
        return replace(first, perturbations=first.perturbations + second.perturbations)

    def _draw_one(self) -> Scenario:
        index = int(self._random.integers(len(self._fixed) + len(self._ranges)))
        if index < len(self._fixed):
            return self._fixed[index]
        name = list(self._ranges)[index - len(self._fixed)]
        return FAMILIES[name].scenario(float(self._random.uniform(*self._ranges[name])))


def _range(name: str, ends: Sequence[float]) -> tuple[float, float]:
    """Return a range of strengths, checked."""
    accepted = "the lowest and the highest strength"
    require(len(ends) == 2 and ends[0] <= ends[1], f"ranges[{name!r}]", ends, accepted)
    for strength in ends:
        scenario(f"{name}-{np.format_float_positional(strength, trim='-')}")
    return float(ends[0]), float(ends[1])


class Memory(VecEnvWrapper):
    """A reaching environment whose observations are followed by a `History` in blocks."""

    def __init__(
        self, venv: VecEnv, blocks: Sequence[int] = (1, 1, 1, 1, 2, 2, 4, 4, 4, 10)
    ) -> None:
        """Wrap an environment with `Box` observations; the blocks are those of `History`.

        Raises:
            UserError: if the observations are of another kind, or a block has no step.
        """
        space = venv.observation_space
        if not isinstance(space, spaces.Box):
            raise UserError(f"venv must have Box observations, got {space}")
        fine = len(blocks) > 0 and all(is_whole(steps) and steps >= 1 for steps in blocks)
        require(fine, "blocks", blocks, "whole numbers of at least 1")
        self.blocks = tuple(blocks)
        self._history = History(ReachInterface.of(venv).layout, self.blocks)
        unknown = np.full(self._history.size, np.inf, np.float32)
        low, high = np.concatenate((space.low, -unknown)), np.concatenate((space.high, unknown))
        super().__init__(venv, spaces.Box(low, high, dtype=np.float32))

    @override
    def reset(self) -> VecEnvObs:
        observation = self.venv.reset()
        assert isinstance(observation, np.ndarray)
        self._memory = self._history.start(observation)
        return self._show(observation, self._memory)

    @override
    def step_async(self, actions: NDArray[Any]) -> None:
        done = np.asarray(actions, np.float32)
        self._memory = self._history.extended(self._now, done, self._memory)
        self.venv.step_async(actions)

    @override
    def step_wait(self) -> VecEnvStepReturn:
        observation, rewards, dones, infos = self.venv.step_wait()
        assert isinstance(observation, np.ndarray)
        if dones.any():
            ended = np.flatnonzero(dones)
            last = np.array([infos[index]["terminal_observation"] for index in ended])
            memory = self._memory[ended]
            recalled = self._history.recall(self._history.observed(last, memory), memory)
            for index, ending in zip(ended, np.concatenate((last, recalled), -1), strict=True):
                infos[index]["terminal_observation"] = ending
            self._memory[ended] = self._history.start(observation[ended])
        return self._show(observation, self._memory), rewards, dones, infos

    def _show(
        self, observation: NDArray[np.float32], memory: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        self._now = self._history.observed(observation, memory)
        return np.concatenate((observation, self._history.recall(self._now, memory)), -1)
