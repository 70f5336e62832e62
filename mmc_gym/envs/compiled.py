"""A control step of many arms of the analytic engine in one go: movement, observation, reward.

Each thread takes its arms through the whole step, so no thread reads what another has just written.
`look_and_reward` repeats `ObservationLayout.encode` and `reward_and_info` operation by operation.
Only the cosines and sines of the joint angles come from the engine instead of the C library.  Both
are right to a unit in the last place of float64, so observations differ in the last place of a
float32, once in some hundred million values.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym._compiling import compiled
from mmc_gym.body.analytic.arms import AnalyticArmBatch
from mmc_gym.envs.reach import HALF_PRECISE
from mmc_gym.envs.setup import ReachSetup, State
from mmc_gym.interface import OFFSET_SCALE

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
    observation: NDArray[np.float32]  #: (n, 3 N + 6), or (n, 3 N) of a goal environment
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
    limits = constants.limits
    joints = cosines.shape[1]
    end = 3 * joints
    for arm in range(last - first):
        seen = observation[arm]
        squares = changes = 0.0
        for joint in range(joints):
            speed = velocities[arm, joint] / constants.speed_limit
            speed = min(max(speed, -1.0), 1.0)
            change = speed - speeds[arm, joint]
            squares += speed * speed
            changes += change * change
            speeds[arm, joint] = speed
            seen[joint] = cosines[arm, joint]
            seen[joints + joint] = sines[arm, joint]
            seen[2 * joints + joint] = speed
        target_x, target_y = targets[arm, 0], targets[arm, 1]
        x, y = target_x - hands[arm, 0], target_y - hands[arm, 1]
        distance = math.sqrt(x * x + y * y)
        cosine, sine = cosines[arm, 0], sines[arm, 0]
        if end < seen.shape[0]:
            x, y = cosine * x + sine * y, cosine * y - sine * x
            scale = OFFSET_SCALE + math.sqrt(x * x + y * y)
            seen[end] = cosine * target_x + sine * target_y
            seen[end + 1] = cosine * target_y - sine * target_x
            seen[end + 2] = x
            seen[end + 3] = y
            seen[end + 4] = x / scale
            seen[end + 5] = y / scale
        for place in range(limits.shape[0]):
            seen[place] = min(max(seen[place], -limits[place]), limits[place])
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
