"""Train under perturbations that are drawn anew for each episode, with a memory of what happened.

Source of the idea: domain randomisation with a memory, Peng, Andrychowicz, Zaremba & Abbeel (2018),
Sim-to-real transfer of robotic control with dynamics randomization, ICRA,
https://arxiv.org/abs/1710.06537.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from typing_extensions import override

from mmc_gym._errors import UserError, is_whole, require
from mmc_gym.agents.views import Float32, History
from mmc_gym.envs.perturbations import Obstacles, Readings
from mmc_gym.envs.scenarios import FAMILIES, Scenario, scenario
from mmc_gym.interface import ObservationLayout, ReachInterface, turned_back

VectorEnv: TypeAlias = gym.vector.VectorEnv[Any, Any, Any]


class RandomScenarios(VecEnvWrapper):
    """Arms in groups; each group draws a scenario for every episode.

    What is drawn is one of `names`, or a perturbation of one of the `ranges`, all as likely, of a
    strength that is as likely as any other in its range.  With the probability `twice` a second
    perturbation comes on top, where it can.  The wrapped environment gives number, control mode,
    engine and other arguments of the arms, and never moves.  Groups with obstacles move in pymunk,
    for the analytic engine knows no collisions.

    Groups begin one after the other: their episodes end at different steps.

    With `truth`, an observation is followed by what the senses may hide, see `Truth`.
    """

    def __init__(
        self,
        venv: VecEnv,
        names: Sequence[str] = ("random",),
        ranges: Mapping[str, Sequence[float]] | None = None,
        groups: int = 32,
        twice: float = 0.0,
        truth: bool = False,
    ) -> None:
        """Wrap a vector of equal environments.

        Args:
            venv: of a multiple of `groups` arms.
            names: of scenarios, see `mmc_gym.envs.scenarios.scenario`.
            ranges: lowest and highest strength of families of perturbations, by name.
            groups: number of groups.
            twice: probability of a second perturbation, a task's included.
            truth: whether the truth follows the observations.

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
        self._size, self._twice, self._truth = venv.num_envs // groups, twice, truth
        if truth:
            size = truth_size(venv.action_space.shape[0])  # type: ignore[index]
            self.observation_space = lengthened(venv.observation_space, size)
        for one in self._fixed:
            self._made(one, 1.0).close()  # refused here, if it is
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
            if over.all():  # all of a group end at once
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

    def _begin(self, group: int, share: float = 1.0) -> Float32:
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
        self._groups[group] = made
        observation, _ = made.reset(seed=int(self._random.integers(2**31)))
        return observation  # type: ignore[no-any-return]

    def _made(self, drawn: Scenario, share: float) -> VectorEnv:
        arguments = {**self._arguments, **drawn.arguments, "autoreset_mode": "Disabled"}
        if any(isinstance(one, Obstacles) for one in drawn.perturbations):
            arguments["engine"] = "pymunk"
        steps = gym.spec(drawn.env_id).max_episode_steps or 1
        arguments["max_episode_steps"] = max(1, round(share * steps))
        env = gym.make_vec(drawn.env_id, self._size, copy=False, **arguments)
        return Truth(env) if self._truth else env

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


class Truth(gym.vector.VectorWrapper[Any, Any, Any]):
    """A vector of reaching environments whose observations are followed by the truth.

    That is

        the observation without noise and delay; the target's velocity, seen as the target is;
        the cursor's turn (sine, cosine − 1); curl of the force field / 100, hand's mass / 10,
        gravity / 100; segment lengths − 1; which joints are locked now

    but nothing of obstacles.
    """

    def __init__(self, env: VectorEnv) -> None:
        """Wrap a native vector environment."""
        super().__init__(env)
        reaching: Any = env.unwrapped
        self._setup, self._arms = reaching.setup, reaching.arms
        count, body, turn = self._setup.joint_count, self._setup.body, self._setup.rotation
        angle = 0.0 if turn is None else np.radians(turn.degrees)
        curl = 0.0 if body.force_field is None else body.force_field[0][1]
        forces = curl / 100, body.hand_mass / 10, body.gravity[1] / 100
        lengths = np.array(body.segment_lengths) - 1
        self._body = np.array([np.sin(angle), np.cos(angle) - 1, *forces, *lengths])
        self._locks = np.isin(np.arange(count), body.lockable_joints)
        self._step = 0

    @override
    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        observation, infos = self.env.reset(**arguments)
        self._targets, self._step = infos["target"], 0
        return self._with_truth(observation, infos), infos

    @override
    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        observation, *outcome, infos = self.env.step(actions)
        self._step += 1
        return self._with_truth(observation, infos), *outcome, infos

    def _with_truth(self, seen: Float32, infos: dict[str, Any]) -> Float32:
        setup, arms, targets = self._setup, self._arms, infos["target"]
        hands = infos.get("cursor", infos["end_effector"])
        true = setup.observe(Readings(arms.joint_angles, arms.joint_velocities, hands, targets))
        moved, self._targets = targets - self._targets, targets
        moved[np.abs(moved).max(axis=-1) > JUMP] = 0.0
        count = setup.joint_count
        x, y = moved.T / setup.given_body.control_step
        velocity = turned_back(x, y, true[:, 0], true[:, count])
        locked = self._locks & (setup.lock_step is not None and self._step >= setup.lock_step)
        of_all = np.broadcast_to((*self._body, *locked), (len(true), len(self._body) + count))
        truth = (seen, true, np.stack(velocity, axis=-1), of_all)
        return np.concatenate(truth, axis=-1, dtype=np.float32)


JUMP = 0.1
"""A target that is farther than this from where it was a step ago has jumped, segment lengths."""


def truth_size(joint_count: int) -> int:
    """Return how many values `Truth` adds."""
    return ObservationLayout(joint_count, 1.0).size + 2 + 2 + 3 + 2 * joint_count


def lengthened(space: spaces.Space[Any], count: int) -> spaces.Box:
    """Return the space of observations that so many values follow, of any size.

    Raises:
        UserError: if the observations are no arrays.
    """
    if not isinstance(space, spaces.Box):
        raise UserError(f"venv must have Box observations, got {space}")
    unknown = np.full(count, np.inf, np.float32)
    low, high = np.concatenate((space.low, -unknown)), np.concatenate((space.high, unknown))
    return spaces.Box(low, high, dtype=np.float32)


class Memory(VecEnvWrapper):
    """A reaching environment whose observations are followed by a `History` in blocks.

    What already follows them, such as the truth, comes after that.
    """

    def __init__(
        self, venv: VecEnv, blocks: Sequence[int] = (1, 1, 1, 1, 2, 2, 4, 4, 4, 10)
    ) -> None:
        """Wrap an environment with `Box` observations; the blocks are those of `History`.

        Raises:
            UserError: if the observations are of another kind, or a block has no step.
        """
        fine = len(blocks) > 0 and all(is_whole(steps) and steps >= 1 for steps in blocks)
        require(fine, "blocks", blocks, "whole numbers of at least 1")
        self.blocks = tuple(blocks)
        self._history = History(ReachInterface.of(venv).layout, self.blocks)
        super().__init__(venv, lengthened(venv.observation_space, self._history.size))

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
            endings = self._with_memory(last, self._history.observed(last, memory), memory)
            for index, ending in zip(ended, endings, strict=True):
                infos[index]["terminal_observation"] = ending
            self._memory[ended] = self._history.start(observation[ended])
        return self._show(observation, self._memory), rewards, dones, infos

    def _show(self, observation: Float32, memory: Float32) -> Float32:
        self._now = self._history.observed(observation, memory)
        return self._with_memory(observation, self._now, memory)

    def _with_memory(
        self,
        observation: NDArray[np.float32],
        now: NDArray[np.float32],
        memory: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        seen, more = np.split(observation, [self._history.layout.size], axis=-1)
        return np.concatenate((seen, self._history.recall(now, memory), more), -1)
