"""A control step of many arms of the analytic engine in one go: movement, observation, reward.

Each thread takes its arms through the whole step, so no thread reads what another has just written.
`_encode` repeats `ObservationLayout.encode`, and `look_and_reward` besides `reward_and_info`,
operation by operation.  Only the cosines and sines of the joint angles come from the engine instead
of the C library.  Both are right to a unit in the last place of float64, so observations differ in
the last place of a float32, once in some hundred million values.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym._compiling import compiled, sine_cosine
from mmc_gym.body.analytic.arms import AnalyticArmBatch
from mmc_gym.envs.reward import HALF_PRECISE
from mmc_gym.envs.setup import ReachSetup, State
from mmc_gym.interface import OFFSET_SCALE, Seen

Floats = NDArray[np.float64]


class Constants(NamedTuple):
    """Values that all arms and steps share; `limits` is empty if observations are not clipped."""

    speed_limit: float
    success_distance: float
    precision_weight: float
    control_weight: float
    smoothness_weight: float
    limits: NDArray[np.float32]


class Arms(NamedTuple):
    """Arrays of n arms: what `look_and_reward` reads, and from `speeds` on what it writes."""

    cosines: Floats  #: of the joint angles, (n, N)
    sines: Floats  #: of the joint angles, (n, N)
    velocities: Floats  #: of the joints, rad/s, (n, N)
    hands: Floats  #: positions of the hands or their cursors, (n, 2)
    targets: Floats  #: positions, (n, 2)
    may_succeed: NDArray[np.bool_]  #: whether the target is the last one, (n,)
    speeds: Floats  #: of the joints before, then after the step, shares of the limit, (n, N)
    #: (n, 3 N + 6), or (n, 3 N) of a goal environment; (n, 0) where disturbed senses observe
    observation: NDArray[np.float32]
    terms: Floats  #: distance, −distance, precision, control, smoothness, dense reward, (6, n)
    is_success: NDArray[np.bool_]  #: whether the target is reached, (n,)


class CompiledStep:
    """Movements, observations, rewards and infos of all arms, as `MMCReachVectorEnv` gives them."""

    def __init__(self, setup: ReachSetup, arms: AnalyticArmBatch) -> None:
        self._arms, self._action = arms, setup.action
        layout = setup.layout
        self._constants = Constants(
            setup.given_body.speed_limit,
            setup.success_distance,
            setup.reward.precision_weight,
            setup.reward.control_weight,
            setup.reward.smoothness_weight,
            layout.limits if layout.is_clipped else np.empty(0, np.float32),
        )
        self._is_sparse = setup.reward.is_sparse

    def look(self, state: State) -> tuple[Floats, dict[str, Any]]:
        """Return rewards and infos of the present state; write observations and speeds."""
        return self._look(state, lambda first, last: None)

    def move_and_look(
        self, actions: NDArray[np.floating], state: State
    ) -> tuple[Floats, dict[str, Any]]:
        """Let all arms carry out their actions, (n, N), then do as `look`."""
        return self._look(state, partial(self._move, actions))

    def move(self, actions: NDArray[np.floating]) -> None:
        """Let all arms carry out their actions, (n, N)."""
        self._arms.share_out(partial(self._move, actions))

    def observe(self, seen: Seen) -> NDArray[np.float32]:
        """Return observations of n arms, (n, 3 N + 6), of what they sense."""
        count, joints = seen.joint_angles.shape
        observation = np.empty((count, 3 * joints + 6), np.float32)
        parts = (seen.joint_angles, seen.joint_speeds, seen.hand, seen.target)
        compact = map(np.ascontiguousarray, parts)  # the layout that the kernel is compiled for
        write_observations(self._constants, *compact, observation)
        return observation

    def _move(self, actions: NDArray[np.floating], first: int, last: int) -> None:
        _, scale, is_relative = self._action
        self._arms.command_arms(actions, scale, is_relative, first, last)
        self._arms.step_arms(first, last)

    def _look(
        self, state: State, move: Callable[[int, int], None]
    ) -> tuple[Floats, dict[str, Any]]:
        engine, seen, count = self._arms, state.observation, len(state.targets)
        end_effector, target = np.empty((count, 2)), np.empty((count, 2))
        copies = [(end_effector, engine.end_effectors), (target, state.targets)]
        if isinstance(seen, dict):
            copies += [(seen["achieved_goal"], state.hands), (seen["desired_goal"], state.targets)]
            seen = seen["observation"]
        arms = Arms(
            engine.joint_cosines,
            engine.joint_sines,
            engine.joint_velocities,
            state.hands,
            state.targets,
            state.may_succeed,
            state.speeds,
            seen,
            terms=np.empty((6, count)),
            is_success=np.empty(count, dtype=bool),
        )

        def advance(first: int, last: int) -> None:
            move(first, last)
            for copy, original in copies:
                copy[first:last] = original[first:last]
            look_and_reward(first, last, self._constants, arms)

        engine.share_out(advance)
        distance, distance_cost, precision, control, smoothness, reward = arms.terms
        info = {
            "distance": distance,
            "is_success": arms.is_success,
            "reward_distance": distance_cost,
            "reward_precision": precision,
            "reward_control": control,
        }
        if self._constants.smoothness_weight:
            info["reward_smoothness"] = smoothness
        info |= {"end_effector": end_effector, "target": target}
        return arms.is_success.astype(np.float64) - 1.0 if self._is_sparse else reward, info


@compiled
def _encode(cosines, sines, speeds, hand, target, limits, observation):
    """Write the observation of an arm; that of a goal environment ends before the target."""
    joints = cosines.shape[0]
    end = 3 * joints
    for joint in range(joints):
        observation[joint] = cosines[joint]
        observation[joints + joint] = sines[joint]
        observation[2 * joints + joint] = speeds[joint]
    if end < observation.shape[0]:
        cosine, sine = cosines[0], sines[0]
        along, across = target[0] - hand[0], target[1] - hand[1]
        x, y = cosine * along + sine * across, cosine * across - sine * along
        scale = OFFSET_SCALE + math.sqrt(x * x + y * y)
        observation[end] = cosine * target[0] + sine * target[1]
        observation[end + 1] = cosine * target[1] - sine * target[0]
        observation[end + 2] = x
        observation[end + 3] = y
        observation[end + 4] = x / scale
        observation[end + 5] = y / scale
    for place in range(limits.shape[0]):
        observation[place] = min(max(observation[place], -limits[place]), limits[place])


@compiled
def write_observations(constants, joint_angles, joint_velocities, hands, targets, observation):
    """Write the observations of n arms, given what they sense as in `Seen`."""
    joints = joint_angles.shape[1]
    cosines, sines, speeds = np.empty(joints), np.empty(joints), np.empty(joints)
    for arm in range(joint_angles.shape[0]):
        for joint in range(joints):
            speed = joint_velocities[arm, joint] / constants.speed_limit
            speeds[joint] = min(max(speed, -1.0), 1.0)
            sines[joint], cosines[joint] = sine_cosine(joint_angles[arm, joint])
        seen, limits = observation[arm], constants.limits
        _encode(cosines, sines, speeds, hands[arm], targets[arm], limits, seen)


@compiled
def look_and_reward(first, last, constants, arms):
    """Write observations, rewards and their terms of the arms from `first` to before `last`.

    The observation of a goal environment ends before the target.
    """
    # Counted from 0: else numba would ask of each index whether it counts from the end.
    cosines, sines = arms.cosines[first:last], arms.sines[first:last]
    velocities, speeds = arms.velocities[first:last], arms.speeds[first:last]
    hands, targets = arms.hands[first:last], arms.targets[first:last]
    may_succeed, is_success = arms.may_succeed[first:last], arms.is_success[first:last]
    observation, terms = arms.observation[first:last], arms.terms[:, first:last]
    joints = cosines.shape[1]
    for arm in range(last - first):
        squares = changes = 0.0
        for joint in range(joints):
            speed = velocities[arm, joint] / constants.speed_limit
            speed = min(max(speed, -1.0), 1.0)
            change = speed - speeds[arm, joint]
            squares += speed * speed
            changes += change * change
            speeds[arm, joint] = speed
        x, y = targets[arm, 0] - hands[arm, 0], targets[arm, 1] - hands[arm, 1]
        distance = math.sqrt(x * x + y * y)
        if observation.shape[1] > 0:
            seen, limits = observation[arm], constants.limits
            _encode(cosines[arm], sines[arm], speeds[arm], hands[arm], targets[arm], limits, seen)
        precision = constants.precision_weight * (HALF_PRECISE / (HALF_PRECISE + distance))
        control = -constants.control_weight * squares / joints
        smoothness = -constants.smoothness_weight * changes / joints
        reward = -distance + precision + control
        if constants.smoothness_weight > 0.0:
            reward = reward + smoothness
        is_success[arm] = (distance <= constants.success_distance) & may_succeed[arm]
        terms[0, arm] = distance
        terms[1, arm] = -distance
        terms[2, arm] = precision
        terms[3, arm] = control
        terms[4, arm] = smoothness
        terms[5, arm] = reward
