"""`MMCReach-v0`: a planar arm reaches for a target and stays there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import cos, sin
from typing import TYPE_CHECKING, Any, Literal, SupportsFloat, get_args

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from mmc_gym.body import Arm, ArmParameters, Servo
from mmc_gym.envs import tasks
from mmc_gym.network.chain import reachable_radii

if TYPE_CHECKING:
    from mmc_gym.envs.rendering import Renderer

Control = Literal["joint_position", "joint_delta", "joint_velocity", "joint_torque"]
RewardType = Literal["dense", "sparse"]
Info = dict[str, Any]

_SERVO: dict[Control, Servo] = {
    "joint_position": "position",
    "joint_delta": "position",
    "joint_velocity": "velocity",
    "joint_torque": "torque",
}


class MMCReachEnv(gym.Env[Any, NDArray[np.float32]], EzPickle):
    """A planar arm of three segments reaches for a target and stays there.

    ## Description
    Three uniform rods of length 1 and mass 1 with continuous joints lie in a horizontal plane,
    simulated by pymunk in control steps of 0.02 s (four physics steps of 0.005 s).  A servo
    at each joint follows the action with at most 2π rad/s and a torque of at most 400
    (mass · length² / s²): the whole stretched arm turns by 90° in 0.36 s, to within 0.05 rad.

    ## Action Space
    `Box(-1, 1, (3,), float32)`, from the base outward.  `control` says what it means:

    | control | an action a asks for |
    | --- | --- |
    | `joint_position` (default) | the joint angle π·a, the short way round |
    | `joint_delta` | the present joint angle + (2π/12)·a: held, it turns at 0.85 · 2π·a rad/s |
    | `joint_velocity` | the joint velocity 2π·a, rad/s |
    | `joint_torque` | the torque 400·a, until the joint turns at 2π rad/s |

    Actions outside the Box are an error and are not clipped (stable-baselines3 clips by itself;
    `gymnasium.wrappers.ClipAction` does it for others).

    ## Observation Space
    `Box(-1, 1, (13,), float32)`:

    | index | observation |
    | --- | --- |
    | 0–2 | cos of the joint angles |
    | 3–5 | sin of the joint angles |
    | 6–8 | joint velocities / 2π rad/s, clipped to ±1 |
    | 9–10 | target (x, y) / reach |
    | 11–12 | (target − hand) / (2 · reach) |

    ## Rewards
    Dense (default): −distance − 0.1 · mean((joint velocity / 2π)²), the distance from hand to
    target in segment lengths.  Sparse: 0 within 0.05 of the target, −1 elsewhere.

    ## Starting State
    Joint angles uniform on the circle, at rest; target area-uniform over the disc (for unequal
    segments: the ring) that the hand can reach.  `reset(options={"joint_angles": …})` (3
    angles in radians) and `{"target": (x, y)}` set either.

    ## Episode End
    Never terminates: the hand must stay at the target.  `gym.make` truncates after 100 steps
    (2 s).

    ## Information
    `reset` and `step` return `distance`, `is_success` (distance ≤ 0.05), `end_effector`,
    `target`, and the terms of the dense reward, `reward_distance` and `reward_control`.

    ## Arguments
    `control`, `reward_type` ("dense", "sparse"), `control_weight` (0.1), `success_distance`
    (0.05), `render_mode` ("human", "rgb_array"), and any field of
    `mmc_gym.body.ArmParameters` by name: `segment_lengths`, `segment_masses`, `speed_limit`,
    `torque_limit`, `servo_gain`, `joint_limits`, `gravity`, `substep`, `substeps`.  The arm has
    as many joints as `segment_lengths`, and action and observation grow with it.

    A pickled or deep-copied environment is a new one with the same arguments.

    ## Version History
    * v0: initial version
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 50}

    def __init__(
        self,
        *,
        control: Control = "joint_position",
        reward_type: RewardType = "dense",
        control_weight: float = 0.1,
        success_distance: float = 0.05,
        render_mode: str | None = None,
        **arm_parameters: Any,
    ) -> None:
        """Make the environment; the arguments are listed in the class docstring.

        Raises:
            ValueError: if an argument is outside what it accepts.
        """
        EzPickle.__init__(
            self,
            control=control,
            reward_type=reward_type,
            control_weight=control_weight,
            success_distance=success_distance,
            render_mode=render_mode,
            **arm_parameters,
        )
        _require_one_of("control", control, get_args(Control))
        _require_one_of("reward_type", reward_type, get_args(RewardType))
        _require_one_of("render_mode", render_mode, (None, *self.metadata["render_modes"]))
        _require_at_least_zero("control_weight", control_weight)
        _require_at_least_zero("success_distance", success_distance)
        self.parameters = p = ArmParameters(**arm_parameters)
        self.metadata = {**type(self).metadata, "render_fps": round(1 / p.control_step)}
        self.control: Control = control
        self.reward_type: RewardType = reward_type
        self.control_weight = float(control_weight)
        self.success_distance = float(success_distance)
        self.render_mode = render_mode
        self.reach = sum(p.segment_lengths)
        count = len(p.segment_lengths)
        self.action_space = spaces.Box(-1.0, 1.0, (count,), np.float32)
        self._action_shape = (count,)
        self.observation_space = self._make_observation_space(count)
        self._arm = Arm(p, _SERVO[control])
        # What an action of 1 means.  A target so far ahead asks the servo for its full speed; the
        # joint's mean speed is less, for it has come nearer when the control step ends.
        self._action_scale = {
            "joint_position": math.pi,
            "joint_delta": self.max_joint_delta,
            "joint_velocity": p.speed_limit,
            "joint_torque": p.torque_limit,
        }[control]
        limits = p.joint_limits
        self._hands = limits and tasks.reachable_hands(p.segment_lengths, limits)
        self._renderer: Renderer | None = None
        self._place([0.0] * count, (self.reach, 0.0))

    @property
    def max_joint_delta(self) -> float:
        """How far an action of 1 puts the joint target ahead under `joint_delta`, radians."""
        return self.parameters.speed_limit / self.parameters.servo_gain

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, Info]:
        """Start an episode: see "Starting State" in the class docstring.

        Raises:
            ValueError: for an unknown option, or one of wrong shape, not finite, outside the
                joint limits, or out of reach; the environment stays as it was.
        """
        posture, target = self._check_options(options or {})
        super().reset(seed=seed)
        # Always drawn, so that an option given for the one does not change the other.
        drawn_posture, drawn_target = self._draw_posture(), self._draw_target()
        self._place(posture or drawn_posture, target or drawn_target)
        if self.render_mode == "human":
            self.render()
        observation, _, info = self._outcome()
        return observation, info

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Hand the action to the servos and simulate one control step.

        Raises:
            ValueError: if the action has the wrong shape or an element that is not a number
                within −1 and 1; the environment stays as it was.
        """
        values = self._check_action(action)
        scale = self._action_scale
        if self.control == "joint_delta":
            command = [
                angle + scale * value for angle, value in zip(self._arm.joint_angles, values)
            ]
        else:
            command = [scale * value for value in values]
        self._arm.command(command)
        self._arm.step()
        if self.render_mode == "human":
            self.render()
        observation, reward, info = self._outcome()
        return observation, reward, False, False, info

    def set_target(self, target: ArrayLike) -> None:
        """Move the target during an episode; the next step's observation and reward tell of it.

        Args:
            target: (x, y) in segment lengths.

        Raises:
            ValueError: if it is of wrong shape, not finite, or out of reach; the target stays
                where it was.
        """
        self._target = self._check_target("target", target)

    def render(self) -> NDArray[np.uint8] | None:
        """The picture (height, width, 3) for "rgb_array"; for "human", a window shows it."""
        if self.render_mode is None:
            gym.logger.warn("render() needs a render_mode: gym.make(..., render_mode='rgb_array')")
            return None
        if self._renderer is None:
            from mmc_gym.envs.rendering import Renderer

            self._renderer = Renderer(
                self.parameters.segment_lengths,
                self.success_distance,
                self.render_mode,
                self.metadata["render_fps"],
            )
        return self._renderer.draw(self._arm.segment_angles, self._target)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _make_observation_space(self, count: int) -> spaces.Space[Any]:
        return spaces.Box(-1.0, 1.0, (3 * count + 4,), np.float32)

    def _outcome(self) -> tuple[Any, float, Info]:
        """Observation, reward and info of the present state."""
        arm, target, limit = self._arm, self._target, self.parameters.speed_limit
        hand = arm.end_effector
        speeds = [
            -1.0 if velocity < -limit else 1.0 if velocity > limit else velocity / limit
            for velocity in arm.joint_velocities
        ]
        offset_x, offset_y = target[0] - hand[0], target[1] - hand[1]
        # The operations of `compute_reward`, so that relabelling gives the same bits.
        distance = math.sqrt(offset_x * offset_x + offset_y * offset_y)
        reward_distance = tasks.dense_reward(distance)
        reward_control = tasks.control_cost(speeds, self.control_weight)
        if self.reward_type == "sparse":
            reward = tasks.sparse_reward(distance, self.success_distance)
        else:
            reward = reward_distance + reward_control
        info = {
            "distance": distance,
            "is_success": distance <= self.success_distance,
            "end_effector": np.array(hand),
            "target": np.array(target),
            "reward_distance": reward_distance,
            "reward_control": reward_control,
        }
        posture = [*map(cos, arm.joint_angles), *map(sin, arm.joint_angles), *speeds]
        return self._observation(posture, info), reward, info

    def _observation(self, posture: list[float], info: Info) -> Any:
        """Observation from cos, sin and speed of the joints; `info` tells hand and target."""
        del info
        (x, y), (hand_x, hand_y), reach = self._target, self._arm.end_effector, self.reach
        diameter = 2 * reach
        posture += (x / reach, y / reach, (x - hand_x) / diameter, (y - hand_y) / diameter)
        return np.array(posture, dtype=np.float32)

    def _place(self, posture: Sequence[float], target: tuple[float, float]) -> None:
        self._arm.reset(posture)
        self._target = target
        if self._renderer is not None:
            self._renderer.clear_trace()

    def _check_action(self, action: ArrayLike) -> list[float]:
        array = np.asarray(action)
        if array.shape != self._action_shape:
            raise ValueError(f"action must have shape {self._action_shape}, got {array.shape}")
        values: list[float] = array.tolist()
        for value in values:
            if not -1.0 <= value <= 1.0:  # false for NaN too
                raise ValueError(f"action must lie within -1 and 1, got {values}")
        return values

    def _check_options(
        self, options: dict[str, Any]
    ) -> tuple[list[float] | None, tuple[float, float] | None]:
        unknown = set(options) - {"joint_angles", "target"}
        if unknown:
            names = sorted(map(str, unknown))
            raise ValueError(f"options must be 'joint_angles' or 'target', got {names}")
        p, posture, target = self.parameters, None, None
        if options.get("joint_angles") is not None:
            count = len(p.segment_lengths)
            angles = _finite("options['joint_angles']", options["joint_angles"], count)
            posture = [math.remainder(angle, math.tau) for angle in angles]
            for angle, (low, high) in zip(posture, p.joint_limits or (), strict=False):
                if not low <= angle <= high:
                    raise ValueError(
                        f"options['joint_angles'] must lie within the joint limits "
                        f"{p.joint_limits}, got {posture}"
                    )
        if options.get("target") is not None:
            target = self._check_target("options['target']", options["target"])
        return posture, target

    def _check_target(self, name: str, target: ArrayLike) -> tuple[float, float]:
        x, y = _finite(name, target, 2)
        if not tasks.is_reachable((x, y), self.parameters.segment_lengths):
            inner, outer = reachable_radii(self.parameters.segment_lengths)
            raise ValueError(
                f"{name} must lie between {inner:g} and {outer:g} from the base, got {(x, y)}"
            )
        return x, y

    def _draw_posture(self) -> list[float]:
        p = self.parameters
        limits = p.joint_limits or ((-math.pi, math.pi),) * len(p.segment_lengths)
        return [self.np_random.uniform(low, high) for low, high in limits]

    def _draw_target(self) -> tuple[float, float]:
        if self._hands:
            cell = self._hands[self.np_random.integers(len(self._hands))]
            x, y = cell[self.np_random.integers(len(cell))]
            return float(x), float(y)
        return tasks.sample_target(self.parameters.segment_lengths, self.np_random)


def _require_one_of(name: str, value: object, accepted: Sequence[object]) -> None:
    if value not in accepted:
        raise ValueError(f"{name} must be one of {tuple(accepted)}, got {value!r}")


def _require_at_least_zero(name: str, value: float) -> None:
    if not 0 <= value < math.inf:
        raise ValueError(f"{name} must be finite and not negative, got {value!r}")


def _finite(name: str, value: ArrayLike, count: int) -> list[float]:
    message = f"{name} must be {count} finite numbers, got {value!r}"
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:  # not numbers, or of uneven lengths
        raise ValueError(message) from error
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(message)
    values: list[float] = array.tolist()
    return values
