"""The contract between an environment, anyone's, and an agent: all that the agent is given."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import (
    Numbers,
    UserError,
    is_whole,
    require,
    require_choice,
    require_numbers,
    require_positive,
    require_rows,
)
from mmc_gym.geometry import Floats, in_the_world, wrap_angle
from mmc_gym.interface.observation import Observation, ObservationLayout

if TYPE_CHECKING:  # `import mmc_gym` loads no physics
    from mmc_gym.body import ArmParameters, Servo

JointLimits: TypeAlias = "tuple[tuple[float, float], ...]"
_CLOSE = 0.02  # deviation of the segment lengths from those of `arm`, shares of their sum
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


@dataclass(frozen=True)
class Sensed:
    """Posture and target of an observation in physical units; arrays lead with the batch."""

    joint_angles: Floats  #: radians, (..., N)
    target: Floats  #: segment lengths, (..., 2)

    def in_rows(self) -> Self:
        """Return the same with all batch axes as one, (n, ...); a single arm is a row."""
        rows = math.prod(self.joint_angles.shape[:-1])
        parts = {name: part for name, part in vars(self).items() if part is not None}
        flat = {name: part.reshape(rows, part.shape[-1]) for name, part in parts.items()}
        return type(self)(**flat)


@dataclass(frozen=True)
class Seen(Sensed):
    """All that an observation shows in physical units; arrays lead with the batch."""

    joint_speeds: Floats  #: rad/s, (..., N)
    hand: Floats  #: seen position of the hand or its cursor, segment lengths, (..., 2)
    #: which angles, speeds and targets may lack a number, (..., 2 N + 1), see
    #: `ObservationLayout.lost`; None: none does, as in interfaces of your own
    lost: NDArray[np.bool_] | None = None


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

    #: N lengths; of an arm in space, the distances between its nodes, or () for those of `arm`
    segment_lengths: tuple[float, ...]
    control: Control  #: the environment's control mode; "joint_position" for a servo of your own
    speed_limit: float  #: largest joint speed, rad/s
    servo_gain: float  #: speed that a position servo asks for per angle to its target, 1/s
    control_step: float  #: duration of a control step, s
    #: lowest and highest angle of each joint, radians, infinite where there is none, such as
    #: `arm.limits`; None: joints turn freely
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

        def of_arm(numbers: Numbers) -> bool:
            lengths = self.arm.segment_lengths
            same = len(numbers) == len(lengths)
            return same and np.allclose(numbers, lengths, rtol=0, atol=_CLOSE * sum(lengths))

        is_arm = self.arm is None or hasattr(self.arm, "segment_lengths")
        require(is_arm, "arm", self.arm, "a HingeArm, or None in the plane")
        lengths, accepted, fits = self.segment_lengths, "positive and finite", positive
        if self.arm is not None:
            fits, of_nodes = of_arm, self.arm.segment_lengths
            accepted = f"those of arm, {np.round(of_nodes, 4).tolist()}, or () for them"
            lengths = of_nodes if np.size(lengths) == 0 else lengths
        lengths = require_numbers("segment_lengths", lengths, accepted, fits)
        object.__setattr__(self, "segment_lengths", lengths)  # a tuple, also of an array
        require(isinstance(self.has_drive, bool), "has_drive", self.has_drive, "True or False")
        require_choice("control", self.control, CONTROLS)
        for name in ("speed_limit", "servo_gain", "control_step"):
            require_positive(name, getattr(self, name))
        if self.success_distance is not None:
            require_positive("success_distance", self.success_distance)
        count = self._joint_count
        if self.joint_limits is not None:
            accepted = f"{count} pairs of angles, the lower one first; infinite where there is none"
            limits = require_rows("joint_limits", self.joint_limits, accepted, rising, (count,))
            object.__setattr__(self, "joint_limits", limits)
        joints = self.lockable_joints if np.iterable(self.lockable_joints) else (None,)
        are_joints = all(is_whole(joint) and 0 <= joint < count for joint in joints)
        accepted = f"numbers of joints below {count}"
        require(are_joints, "lockable_joints", self.lockable_joints, accepted)

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
        names = (field.name for field in fields(cls) if hasattr(body, field.name))
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
        posture = observation["observation"] if isinstance(observation, Mapping) else observation
        parts = self.layout.split(np.asarray(posture, np.float64))
        joint_angles = np.arctan2(parts.sines, parts.cosines)
        if isinstance(observation, Mapping):
            target: Floats = np.asarray(observation["desired_goal"], np.float64)
        else:
            target = in_the_world(parts.target, joint_angles)
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
        arrays: dict[str, Floats] = {}
        for name, size in sizes.items():
            array = _finite(f"{name} of see", getattr(seen, name), (*batch, size))
            arrays[name] = array.astype(np.float64, copy=False)
        return replace(seen, lost=None, **arrays)

    def see(self, observation: Observation) -> Seen:
        """Return all that observations show."""
        flat = self.layout.flatten(self.layout.check(observation))
        parts = self.layout.split(flat.astype(np.float64))
        joint_angles = np.arctan2(parts.sines, parts.cosines)
        shown = np.array([parts.target, self.layout.whole_offset(parts)])
        target, offset = in_the_world(shown, joint_angles)
        return Seen(
            joint_angles=self.within_limits(joint_angles),
            target=target,
            joint_speeds=parts.speeds * self.speed_limit,
            hand=target - offset,
            lost=self.layout.lost(parts),
        )

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

    def checked_action(self, action: NDArray[Any], batch: tuple[int, ...]) -> NDArray[Any]:
        """Return what `act` returned; if `act` is your own, as finite numbers, (*batch, any)."""
        if type(self).act is ReachInterface.act:
            return action
        require(action is not None, "what act returns", action, "an action: is its return missing?")
        action = np.asarray(action)
        return _finite("what act returns", action, (*batch, *action.shape[-1:]))

    def check_takes_joint_targets(self) -> None:
        """Raise a `CannotActError` under torque control, whose servos take no targets."""
        if self.control == "joint_torque":
            raise CannotActError(
                "control must be 'joint_position', 'joint_delta' or 'joint_velocity' for an agent "
                f"that gives joint targets, got {self.control!r}"
            )


def _finite(name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an array of a shape; raise a `UserError` if it has another or is not finite."""
    array = np.asarray(value)
    are_numbers = array.shape == shape and array.dtype.kind in "fiu"
    require(are_numbers, name, f"{array.dtype} of shape {array.shape}", f"numbers of shape {shape}")
    # For a single arm four times quicker than numpy.
    is_finite = math.isfinite(sum(array.tolist())) if array.ndim == 1 else np.isfinite(array).all()
    require(bool(is_finite), name, array, "finite")
    return array


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
