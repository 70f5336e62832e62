"""The contract between environments and agents: observations, actions, what agents are given.

Only this module knows the place of each number in an observation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from math import cos, sin, sqrt
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self, TypeAlias, get_args

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import (
    Numbers,
    UserError,
    is_whole,
    require,
    require_choice,
    require_floats,
    require_numbers,
    require_positive,
    require_rows,
)
from mmc_gym.geometry import Floats, in_the_world, wrap_angle

if TYPE_CHECKING:  # `import mmc_gym` loads no physics
    from mmc_gym.body import ArmParameters, Servo

Observation: TypeAlias = "NDArray[Any] | Mapping[str, NDArray[Any]]"
JointLimits: TypeAlias = "tuple[tuple[float, float], ...]"
Control = Literal["joint_position", "joint_delta", "joint_velocity", "joint_torque"]
CONTROLS: tuple[Control, ...] = get_args(Control)


class CannotActError(UserError):
    """An agent cannot act in an environment.

    Factories of agents, yours too, raise it to refuse an environment.  The benchmark then leaves
    out that pair and reports the message.  Any other exception of a factory is a failure.
    """


class ControlError(CannotActError):
    """An agent cannot act in the control mode of an environment, but in its own, `control`."""

    def __init__(self, message: str, control: str = "") -> None:
        super().__init__(message)
        self.control = control


class ActionMeaning(NamedTuple):
    """The meaning of an action for a joint's servo."""

    servo: Servo  #: the kind of servo that follows it
    scale: float  #: command for an action of 1, in radians, rad/s, or mass · length² / s²
    is_relative: bool = False  #: whether the present joint angle is added to the command


def action_meaning(control: Control, body: ArmParameters) -> ActionMeaning:
    """Return what the actions of a control mode mean for an arm."""
    ahead = body.speed_limit / body.servo_gain
    meanings: dict[Control, ActionMeaning] = {
        "joint_position": ActionMeaning("position", math.pi),
        "joint_delta": ActionMeaning("position", ahead, is_relative=True),
        "joint_velocity": ActionMeaning("velocity", body.speed_limit),
        "joint_torque": ActionMeaning("torque", body.torque_limit),
    }
    return meanings[control]


class ObservationParts(NamedTuple):
    """The parts of observations, arrays of numpy or torch with the batch in front.

    Target and offset are vectors in the first segment's frame, whose x axis is that segment.
    """

    cosines: Any  #: of the joint angles, (..., N)
    sines: Any  #: of the joint angles, (..., N)
    speeds: Any  #: joint velocities as fractions of their limit, (..., N)
    target: Any  #: position of the target, segment lengths, (..., 2)
    offset: Any  #: target − hand, segment lengths, (..., 2)


OFFSET_SCALE = 0.05  # segment lengths


@dataclass(frozen=True)
class ObservationLayout:
    """The place of each number of an observation, for an arm of `joint_count` joints, N.

    An observation of `MMCReach-v0` is (..., 3 N + 6), with e = R(−q_1) (target − hand)::

        cos q, sin q, joint speeds / limit, R(−q_1) target, e, e / (OFFSET_SCALE + |e|)

    One of `MMCReachGoal-v0` is a mapping: `observation` is the first 3 N numbers of that,
    `achieved_goal` the hand and `desired_goal` the target, (..., 2).  Lengths are in segment
    lengths.
    """

    joint_count: int  #: N
    reach: float  #: sum of the segment lengths that agents are given
    #: whether `encode` clips to `limits`; noise or a cursor may exceed the reach
    is_clipped: bool = False
    has_goals: bool = False  #: whether `encode` makes observations of `MMCReachGoal-v0`
    context_size: int = 0  #: how many numbers of a context follow an observation

    @cached_property
    def posture_size(self) -> int:
        """Number of values for posture and joint speeds."""
        return 3 * self.joint_count

    @cached_property
    def size(self) -> int:
        """Number of values of an observation of `MMCReach-v0`."""
        return self.posture_size + 6

    @cached_property
    def limits(self) -> NDArray[np.float32]:
        """The largest size of each value of an observation of `MMCReach-v0`."""
        limits = np.ones(self.size, np.float32)
        limits[-6:-2] = self.reach, self.reach, 2 * self.reach, 2 * self.reach
        return limits

    def space(self, more: Sequence[float] | Floats = ()) -> spaces.Box:
        """Return the observation space of `MMCReach-v0`, with the limits of numbers behind."""
        limits = np.concatenate([self.limits, more], dtype=np.float32)
        return spaces.Box(-limits, limits, dtype=np.float32)

    def goal_space(self, farthest: float, more: Sequence[float] | Floats = ()) -> spaces.Dict:
        """Return the observation space of `MMCReachGoal-v0`; no coordinate is beyond `farthest`."""
        goal = spaces.Box(-farthest, farthest, (2,), np.float64)
        limits = np.concatenate([np.ones(self.posture_size), more], dtype=np.float32)
        posture = spaces.Box(-limits, limits, dtype=np.float32)
        return spaces.Dict(observation=posture, achieved_goal=goal, desired_goal=goal)

    def additions(self, space: spaces.Space[Any]) -> int:
        """Return how many values an observation space has beyond this layout."""
        goals = space.spaces if isinstance(space, spaces.Dict) else {}
        shape = goals.get("observation", space).shape or (0,)
        count = shape[0] - (self.posture_size if goals else self.size)
        accepted = f"that of a reaching environment with {self.joint_count} joints"
        require(count >= 0, "observation_space", space, accepted)
        return count

    def encode(self, joint_angles: Any, joint_speeds: Any, *, hand: Any, target: Any) -> Any:
        """Return the observation of one arm, given as lists, or of many, given as arrays.

        For one arm, lists of floats take a fraction of the time.  Both give the same bits if
        numpy's cosine and sine are those of the C library.

        Args:
            joint_angles: radians, a list of N or (..., N).
            joint_speeds: as fractions of their limit, likewise, see `relative_speeds`.
            hand: seen position of the hand or its cursor, segment lengths, (x, y) or (..., 2).
            target: segment lengths, (x, y) or (..., 2).
        """
        if isinstance(joint_angles, list):
            cosines, sines = [*map(cos, joint_angles)], [*map(sin, joint_angles)]
            shown = () if self.has_goals else _shown(cosines[0], sines[0], hand, target, sqrt)
            seen = np.array([*cosines, *sines, *joint_speeds, *shown], np.float32)
        else:
            cosine, sine = np.cos(joint_angles), np.sin(joint_angles)
            first = cosine[..., 0], sine[..., 0]
            points = _components(hand), _components(target)
            shown = () if self.has_goals else _shown(*first, *points, np.sqrt)
            columns = (value[..., None] for value in shown)
            parts = (cosine, sine, joint_speeds, *columns)
            seen = np.concatenate(parts, axis=-1, dtype=np.float32)
        if self.has_goals:
            goals = {"achieved_goal": np.array(hand), "desired_goal": np.array(target)}
            return {"observation": seen, **goals}
        if self.is_clipped:
            np.clip(seen, -self.limits, self.limits, out=seen)
        return seen

    def check(self, observation: Observation) -> Observation:
        """Return an observation of either kind, see the class, as arrays of finite numbers."""
        if type(observation) is np.ndarray and observation.ndim == 1:
            values = observation.tolist()  # for a single arm four times quicker than numpy
            fine = len(values) == self.size + self.context_size and observation.dtype.char in "fd"
            if fine and math.isfinite(sum(values)):
                return observation
        if not isinstance(observation, Mapping):
            return require_floats("observation", observation, (self.size + self.context_size,))
        sizes = {"observation": self.posture_size + self.context_size}
        sizes |= {"achieved_goal": 2, "desired_goal": 2}
        accepted = f"a mapping with {', '.join(sizes)}"
        require(sizes.keys() <= observation.keys(), "observation", sorted(observation), accepted)
        rows = {
            name: require_floats(f"observation[{name!r}]", observation[name], (size,))
            for name, size in sizes.items()
        }
        shapes = {name: one.shape for name, one in rows.items()}
        fine = len({shape[:-1] for shape in shapes.values()}) == 1
        require(fine, "observation", shapes, "of arrays with the same batch axes")
        return rows

    def flatten(self, observation: Any, arrays: Any = np) -> Any:
        """Return observations of either kind, in numpy or torch, as those of `MMCReach-v0`.

        They may be longer; the values that follow are kept.
        """
        if not isinstance(observation, Mapping):
            return observation
        posture, end = observation["observation"], self.posture_size
        first = posture[..., 0], posture[..., self.joint_count]
        points = _components(observation["achieved_goal"]), _components(observation["desired_goal"])
        shown = _shown(*first, *points, arrays.sqrt)
        parts = (posture[..., :end], arrays.stack(shown, -1), posture[..., end:])
        return arrays.concatenate(parts, -1)

    def split(self, observation: Any, arrays: Any = np) -> ObservationParts:
        """Split observations of either kind; see `flatten`."""
        count, end = self.joint_count, self.posture_size
        posture = observation["observation"] if isinstance(observation, Mapping) else observation
        values = self.flatten(observation, arrays)
        return ObservationParts(
            cosines=posture[..., :count],
            sines=posture[..., count : 2 * count],
            speeds=posture[..., 2 * count : end],
            target=values[..., end : end + 2],
            offset=values[..., end + 2 : end + 4],
        )


def _shown(cosine: Any, sine: Any, hand: Any, target: Any, root: Any) -> tuple[Any, ...]:
    """Return the last six values of observations, from cosine and sine of the first joint angle.

    All are numbers, or arrays of one shape; `root` is the square root for them.
    """
    (hand_x, hand_y), (target_x, target_y) = hand, target
    along, across = target_x - hand_x, target_y - hand_y
    # Written out: calls of `turned_back` would cost a step of one arm a microsecond.
    x, y = cosine * along + sine * across, cosine * across - sine * along
    scale = OFFSET_SCALE + root(x * x + y * y)
    seen_x, seen_y = cosine * target_x + sine * target_y, cosine * target_y - sine * target_x
    return seen_x, seen_y, x, y, x / scale, y / scale


def _components(vectors: Any) -> tuple[Any, Any]:
    return vectors[..., 0], vectors[..., 1]


def relative_speeds(joint_velocities: Any, limit: float) -> Any:
    """Return joint velocities, a list of N or (..., N), as fractions of their limit, within ±1."""
    if isinstance(joint_velocities, list):
        return [
            -1.0 if velocity < -limit else 1.0 if velocity > limit else velocity / limit
            for velocity in joint_velocities
        ]
    # np.clip would take twice as long for few arms.
    speeds: Floats = np.maximum(joint_velocities / limit, -1.0)
    return np.minimum(speeds, 1.0, out=speeds)


@dataclass(frozen=True)
class Sensed:
    """Posture and target of an observation in physical units; arrays lead with the batch."""

    joint_angles: Floats  #: radians, (..., N)
    target: Floats  #: segment lengths, (..., 2)

    def in_rows(self) -> Self:
        """Return the same with all batch axes as one, (n, ...); a single arm is a row."""
        rows = math.prod(self.joint_angles.shape[:-1])
        flat = {key: one.reshape(rows, one.shape[-1]) for key, one in vars(self).items()}
        return type(self)(**flat)


@dataclass(frozen=True)
class Seen(Sensed):
    """All that an observation shows in physical units; arrays lead with the batch."""

    joint_speeds: Floats  #: rad/s, (..., N)
    hand: Floats  #: seen position of the hand or its cursor, segment lengths, (..., 2)


@dataclass(frozen=True)
class ReachInterface:
    """The contract between a reaching environment and an agent: all that the agent is given.

    `of` returns that of an environment of this package.  For any other environment write a
    subclass: `see` says where in an observation posture, joint speeds, hand and target are, and
    `act` makes an action of joint targets.  Both take leading batch axes.

        class MyInterface(ReachInterface):
            def see(self, observation):
                angles, speeds, hand, target = np.split(observation, [2, 4, 6], axis=-1)
                return Seen(angles, target, joint_speeds=speeds, hand=hand)

            def act(self, joint_targets, sensed):
                return self.turn(sensed.joint_angles, joint_targets)

    `make_agent` and `compare` take an object of it as `interface`.  Choose the unit of length such
    that the segments have lengths near 1, because agents know no others.  In space vectors have
    three components, (..., 3).
    """

    #: N lengths; of an arm in space, the distances between its nodes
    segment_lengths: tuple[float, ...]
    control: Control  #: the environment's control mode; "joint_position" for a servo of your own
    speed_limit: float  #: largest joint speed, rad/s
    servo_gain: float  #: speed that a position servo asks for per angle to its target, 1/s
    control_step: float  #: duration of a control step, s
    #: lowest and highest angle of each joint, radians, infinite where there is none; None: joints
    #: turn freely
    joint_limits: JointLimits | None = None
    #: joints that lock during an episode; empty if agents are not given them
    lockable_joints: tuple[int, ...] = ()
    #: distance within which the target counts as reached, in the unit above.  None: as the
    #: environment says, in `info["is_success"]`.
    success_distance: float | None = None
    #: whether `act` itself plans how the joints move to their targets.  Agents then give the
    #: posture to be reached in the end, not how far to turn in a control step.
    has_drive: bool = False
    arm: Any = None  #: of an arm in space, its joints; None in the plane
    context_size: int = 0  #: how many numbers of a context follow an observation of this package

    def __post_init__(self) -> None:
        def positive(numbers: Numbers) -> bool:
            return bool(numbers) and all(0 < number < math.inf for number in numbers)

        def rising(ends: Numbers) -> bool:
            return len(ends) == 2 and ends[0] < ends[1]

        require_numbers("segment_lengths", self.segment_lengths, "positive and finite", positive)
        is_arm = self.arm is None or hasattr(self.arm, "joint_count")
        require(is_arm, "arm", self.arm, "a HingeArm, or None in the plane")
        require(isinstance(self.has_drive, bool), "has_drive", self.has_drive, "True or False")
        require_choice("control", self.control, CONTROLS)
        for name in ("speed_limit", "servo_gain", "control_step"):
            require_positive(name, getattr(self, name))
        if self.success_distance is not None:
            require_positive("success_distance", self.success_distance)
        count = self._joint_count
        if self.joint_limits is not None:
            accepted = f"{count} pairs of angles, the lower one first; infinite where there is none"
            require_rows("joint_limits", self.joint_limits, accepted, rising, (count,))
        joints = self.lockable_joints if np.iterable(self.lockable_joints) else (None,)
        fine = all(is_whole(joint) and 0 <= joint < count for joint in joints)
        require(fine, "lockable_joints", self.lockable_joints, f"numbers of joints below {count}")

    @classmethod
    def of(cls, env: Any) -> ReachInterface:
        """Return the interface of an environment of this package, or of a vector of equal ones.

        Both may be wrapped.  A vector may be Gymnasium's, native or not, or stable-baselines3's.
        """
        body, control = read_attribute(env, "parameters"), read_attribute(env, "control")
        if isinstance(body, ReachInterface):  # of an `InterfacedEnv`, your interface
            return body
        if body is None or control is None:
            raise UserError(
                f"env must be a reaching environment of mmc_gym, got {env!r}; for any other "
                "write a ReachInterface and hand it in, interface=..."
            )
        names = (one.name for one in fields(cls) if hasattr(body, one.name))
        more = {"control": control, "context_size": read_attribute(env, "context_size") or 0}
        return cls(**{name: getattr(body, name) for name in names}, **more)

    @property
    def is_own(self) -> bool:
        """Whether observations are those of `ObservationLayout`: no subclass has its own `see`."""
        return type(self).see is ReachInterface.see

    @cached_property
    def layout(self) -> ObservationLayout:
        """The layout of the environment's observations; a `CannotActError` if they are others."""
        if not self.is_own:
            raise CannotActError(
                "env must be a reaching environment of mmc_gym for an agent that reads its "
                f"observations itself, got one with {type(self).__name__}"
            )
        lengths = self.segment_lengths
        return ObservationLayout(len(lengths), sum(lengths), context_size=self.context_size)

    @property
    def _joint_count(self) -> int:
        # An arm in space may have more joints than distances between its nodes.
        return getattr(self.arm, "joint_count", len(self.segment_lengths))

    @property
    def max_joint_delta(self) -> float:
        """Angle from a joint to its target that asks the servo for full speed, radians."""
        return self.speed_limit / self.servo_gain

    def sense(self, observation: Observation) -> Sensed:
        """Return posture and target of observations of either kind, see `ObservationLayout`."""
        if not self.is_own:
            return self.look(observation)
        observation = self.layout.check(observation)
        if isinstance(observation, Mapping):
            joint_angles = self._joint_angles(np.asarray(observation["observation"], np.float64))
            target: Floats = np.asarray(observation["desired_goal"], np.float64)
        else:
            values = np.asarray(observation, np.float64)
            joint_angles = self._joint_angles(values)
            target = in_the_world(self.layout.split(values).target, joint_angles)
        return Sensed(self.within_limits(joint_angles), target)

    def look(self, observation: Observation) -> Seen:
        """Return what `see` returns; if it is your own, checked and as float64.

        So no value that is not finite gets into an agent or a measure.  `sense` returns what most
        agents need.
        """
        seen = self.see(observation)
        if self.is_own:
            return seen
        require(isinstance(seen, Seen), "what see returns", seen, "a Seen")
        batch = np.shape(seen.joint_angles)[:-1]
        joints, axes = self._joint_count, 2 if self.arm is None else 3
        sizes = {"joint_angles": joints, "target": axes, "joint_speeds": joints, "hand": axes}
        checked: dict[str, Any] = {}
        for name, size in sizes.items():
            array = _finite(f"{name} of see", getattr(seen, name), (*batch, size))
            checked[name] = array.astype(np.float64, copy=False)
        return replace(seen, **checked)

    def see(self, observation: Observation) -> Seen:
        """Return all that observations show."""
        layout = self.layout
        values = np.asarray(layout.flatten(layout.check(observation)), np.float64)
        joint_angles, end = self._joint_angles(values), layout.posture_size
        pair = values[..., end : end + 4].reshape(*values.shape[:-1], 2, 2)  # target and offset
        points: Floats = in_the_world(pair, joint_angles[..., None, :])
        target = points[..., 0, :]
        return Seen(
            joint_angles=self.within_limits(joint_angles),
            target=target,
            joint_speeds=values[..., 2 * layout.joint_count : end] * self.speed_limit,
            hand=target - points[..., 1, :],
        )

    def _joint_angles(self, values: Floats) -> Floats:
        count = self.layout.joint_count
        return np.arctan2(values[..., count : 2 * count], values[..., :count])

    def within_limits(self, joint_angles: Floats) -> Floats:
        """Return the angles within the joint limits that are nearest to these, (..., N)."""
        if self.joint_limits is None:
            return joint_angles
        low, high, middle, half, is_open = self._limits
        within = middle + wrap_angle(joint_angles - middle).clip(-half, half)
        if is_open is None:
            return within
        return np.where(is_open, joint_angles.clip(low, high), within)

    def within_limits_from(self, before: Floats, joint_angles: Floats) -> Floats:
        """Return the angles reached on the short way from `before` up to the limits, (..., N).

        So an internal posture never jumps from one limit to the other.
        """
        if self.joint_limits is None:
            return joint_angles
        low, high, *_ = self._limits
        return (before + wrap_angle(joint_angles - before)).clip(low, high)

    def turn(self, joint_angles: Floats, joint_targets: Floats) -> Floats:
        """Return the turns from joint angles to their targets, radians, (..., N).

        Joints take the short way, or with limits the way within them.
        """
        if self.joint_limits is None:
            return wrap_angle(joint_targets - joint_angles)
        turn = self.within_limits(joint_targets) - self.within_limits(joint_angles)
        low, high, *_, is_open = self._limits
        if is_open is None:
            return turn
        return np.where(np.isinf(low) & np.isinf(high), wrap_angle(turn), turn)

    @cached_property
    def _limits(self) -> tuple[Floats, Floats, Floats, Floats, NDArray[np.bool_] | None]:
        """Lowest, highest, middle, half the range, and which are infinite, if any is."""
        low, high = np.transpose(self.joint_limits or ())
        is_open = np.isinf(low) | np.isinf(high)
        if not is_open.any():
            return low, high, (low + high) / 2, (high - low) / 2, None
        ends = np.where(is_open, 0.0, (low, high))
        return low, high, ends.mean(axis=0), np.diff(ends, axis=0)[0] / 2, is_open

    def act(self, joint_targets: Floats, sensed: Sensed) -> NDArray[np.float32]:
        """Return the action that sends the joints to their targets, (..., N), float32 within ±1.

        Under position control the action is the targets; under delta and velocity control it is the
        speed that a position servo would ask for.  A target beyond a joint limit becomes the limit,
        and no joint is sent through its forbidden range.  Under torque control a `CannotActError`
        is raised.
        """
        self.check_takes_joint_targets()
        if self.control == "joint_position":
            action = wrap_angle(self.within_limits(joint_targets)) / math.pi
        else:
            action = self.turn(sensed.joint_angles, joint_targets) / self.max_joint_delta
        # np.clip would take twice as long for few arms.
        clipped: NDArray[np.float32] = np.minimum(np.maximum(action, -1.0), 1.0).astype(np.float32)
        return clipped

    def checked_action(self, action: Any, batch: tuple[int, ...]) -> Any:
        """Return what `act` returned; if `act` is your own, as finite numbers, (*batch, any)."""
        if type(self).act is ReachInterface.act:
            return action
        action = np.asarray(action)
        return _finite("what act returns", action, (*batch, *action.shape[-1:]))

    def check_takes_joint_targets(self) -> None:
        """Raise a `CannotActError` under torque control, whose servos take no targets."""
        if self.control == "joint_torque":
            raise CannotActError(
                "control must be 'joint_position', 'joint_delta' or 'joint_velocity' for an agent "
                f"that gives joint targets, got {self.control!r}"
            )


def _finite(name: str, value: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an array of a shape; raise a `UserError` if it has another or is not finite."""
    array = np.asarray(value)
    fine = array.shape == shape and array.dtype.kind in "fiu"
    require(fine, name, f"{array.dtype} of shape {array.shape}", f"numbers of shape {shape}")
    # For a single arm four times quicker than numpy.
    is_finite = math.isfinite(sum(array.tolist())) if array.ndim == 1 else np.isfinite(array).all()
    require(bool(is_finite), name, array, "finite")
    return array


class InterfacedEnv(gym.Env[Any, Any]):
    """An environment, with its wrappers, together with the `ReachInterface` written for it.

    Observations, actions, rewards and ends of episodes are the environment's.  Infos have more
    entries, as the interface sees them: `end_effector`, `target`, `distance` between them,
    `joint_angles` (not wrapped), and `is_success` where the interface has a success distance.
    """

    def __init__(self, env: Any, interface: Any) -> None:
        """Join an environment with its interface.

        The environment is single; agents also accept a vector of equal ones.  The interface is a
        `ReachInterface`, "module:name" of one, or a function of the environment that returns one.
        """
        found = interface
        if isinstance(interface, str):
            from mmc_gym._files import import_object  # `import mmc_gym` loads no yaml

            found = import_object(interface, "interface")
        if callable(found) and not isinstance(found, ReachInterface):
            found = found(env)
        accepted = "an object of a subclass of ReachInterface, a function of env or 'module:name'"
        require(isinstance(found, ReachInterface), "interface", found, accepted)
        self.env, self.parameters, self.control = env, found, found.control
        self.reach = sum(found.segment_lengths)
        distance = found.success_distance
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


def read_attribute(env: Any, name: str) -> Any:
    """Return an attribute of any environment that `ReachInterface.of` accepts; None if it has none.

    It must be the same for all environments of a vector.
    """
    value = getattr(getattr(env, "unwrapped", None), name, None)
    if value is not None or not hasattr(env, "get_attr"):
        return value
    try:
        values = list(env.get_attr(name))
    except AttributeError:
        return None
    if any(other != values[0] for other in values):
        raise UserError(f"env must be of environments with the same {name}, got {values}")
    return values[0] if values else None
