"""What may differ between arms, or change in an episode: a column of numbers for each quantity.

`Arms` holds n arms.  A perturbation is a function that overwrites their columns, see
`mmc_gym.envs.perturbations`.  One arm is n = 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import UserError, require
from mmc_gym.envs.workspace import Point, rings

if TYPE_CHECKING:  # names are registered without loading the physics
    from mmc_gym.body import ArmParameters
    from mmc_gym.body.parameters import ArmColumns

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Matrix = tuple[tuple[Any, Any], tuple[Any, Any]]  # of numbers, or of arrays (n,)


@dataclass(slots=True)
class Arms:
    """Columns of n arms of N segments, in segment lengths, segment masses, radians and seconds.

    Those of the body are the fields of `mmc_gym.body.ArmParameters`, in the same units.  A column
    is an array of floats, (n,), or (n, …) as below.
    """

    base: ArmParameters  #: the arm without perturbations
    segment_lengths: Floats  #: (n, N)
    segment_masses: Floats  #: (n, N)
    joint_limits: Floats  #: lowest and highest, (n, N, 2); infinite without limits
    gravity: Floats  #: (n, 2)
    force_field: Floats  #: (n, 2, 2)
    hand_mass: Floats  #: (n,)
    speed_limit: Floats  #: (n,)
    torque_limit: Floats  #: (n,)
    servo_gain: Floats  #: (n,)
    drive_inertia: Floats  #: (n,)
    joint_friction: Floats  #: dry friction of the joints, (n,)
    joint_damping: Floats  #: viscous friction of the joints, (n,)
    segment_radius: Floats  #: (n,)
    substep: Floats  #: (n,)
    substeps: NDArray[np.intp]  #: (n,)
    obstacles: NDArray[np.object_]  #: tuples of discs (x, y, radius), (n,)
    lockable: Bools  #: which joints lock, (n, N)
    lock_time: Floats  #: when they lock, s after the start, (n,); NaN: never
    unlock_time: Floats  #: when they are free again, (n,); NaN: never
    channel: Floats  #: curl of the field that a channel stands for, (n,); NaN: the hand is free
    turn: Floats  #: of the cursor about its centre: turns, mirrors and gains, (n, 2, 2)
    shift: Floats  #: of the turned cursor, (n, 2)
    clamp: Floats  #: direction of the cursor, degrees from that of the target, (n,); NaN: free
    jump: Floats  #: of the cursor across the way to the target, as a share of the way, (n,)
    jump_after: Floats  #: share of the way after which the cursor jumps, (n,)
    action_dropped: Floats  #: probability that a motor's action is dropped, (n,)
    action_dropped_steps: Floats  #: control steps for which it then is, (n,)
    action_held: Floats  #: probability that a motor's action stays as before, (n,)
    action_held_steps: Floats  #: control steps for which it then does, (n,)
    action_repeated: Floats  #: probability that an action is repeated, (n,)
    action_repeated_steps: Floats  #: how often it then is, (n,)
    action_delay: Floats  #: of actions, s, (n,)
    motor_gain: Floats  #: factor of actions, (n, N)
    motor_offset: Floats  #: added to actions, which are within ±1, (n, N)
    action_noise: Floats  #: standard deviation of actions, (n,)
    action_noise_size: Floats  #: its increase with the size of the action, (n,)
    dead_zone: Floats  #: size below which actions do nothing, (n,)
    backlash: Floats  #: by which actions must turn back until a motor follows, (n,)
    motor_stuck: Bools  #: which motors hold their last action, (n, N)
    joint_stuck: Bools  #: which joints are felt where they were before, (n, N)
    joint_offset: Floats  #: of felt joint angles, rad, (n, N)
    joint_drift: Floats  #: speed with which the offset grows, rad/s, (n, N)
    encoder: Floats  #: counts in a turn of the sensors of joint angles, (n,); 0: exact
    joint_noise: Floats  #: standard deviation of joint angles, rad, (n,)
    joint_noise_speed: Floats  #: its increase with the joint's speed, s, (n,)
    vision_noise: Floats  #: standard deviation of the seen hand and target, (n,)
    vision_noise_distance: Floats  #: its increase with their distance, (n,)
    delay: Floats  #: of all senses, s, (n,)
    vision_delay: Floats  #: of sight, besides, s, (n,)
    hidden: Floats  #: 0: the hand is seen; 1: never; 2: only where a movement ends, (n,)
    observation_noise: Floats  #: standard deviation of the numbers of an observation, (n,)
    number_dropped: Floats  #: probability that a number of the observation is 0, (n,)
    number_dropped_steps: Floats  #: control steps for which it then is, (n,)
    number_held: Floats  #: probability that a number of the observation stays as before, (n,)
    number_held_steps: Floats  #: control steps for which it then does, (n,)
    observation_repeated: Floats  #: probability that an observation is repeated, (n,)
    observation_repeated_steps: Floats  #: how often it then is, (n,)
    start: Floats  #: of all movements, in reaches, (n, 2); the base if starts differ
    given_lengths: Floats  #: of the segments, as agents are given them, (n, N)

    @classmethod
    def of(cls, base: ArmParameters, start: Point | None = None) -> Arms:
        """Return one arm without perturbations, whose movements begin at `start`."""
        count = len(base.segment_lengths)
        columns: dict[str, Any] = {name: np.zeros(1) for name in _COLUMNS}
        columns |= {name: np.array([getattr(base, name)]) for name in _NUMBERS}
        columns |= {name: np.full(1, np.nan) for name in _NEVER}
        columns |= {name: np.zeros((1, count)) for name in _OF_JOINTS}
        columns["motor_gain"] = np.ones((1, count))
        columns |= {name: np.ones(1) for name in _COLUMNS if name.endswith("_steps")}
        columns |= {name: np.zeros((1, count), dtype=bool) for name in _STUCK}
        columns["segment_lengths"] = np.array([base.segment_lengths])
        columns["given_lengths"] = np.array([base.segment_lengths])
        columns["segment_masses"] = np.array([base.masses])
        limits = base.joint_limits or [(-math.inf, math.inf)] * count
        columns["joint_limits"] = np.array([limits])
        columns["force_field"] = np.array([base.force_field or np.zeros((2, 2))])
        columns["obstacles"] = discs = np.empty(1, dtype=object)
        discs[0] = base.obstacles
        columns["lockable"] = np.isin(np.arange(count), base.lockable_joints)[None]
        columns["turn"], columns["shift"] = np.eye(2)[None], np.zeros((1, 2))
        columns["jump_after"] = np.full(1, 0.25)
        columns["start"] = np.array([start or (0.0, 0.0)])
        return cls(base, **columns)

    def __len__(self) -> int:
        return len(self.speed_limit)

    def rows(self, arms: Any) -> Arms:
        """Return copies of some arms, given by indices or by a mask."""
        return Arms(self.base, **{name: getattr(self, name)[arms] for name in _COLUMNS})

    def write(self, arms: Any, rows: Arms) -> None:
        """Overwrite some arms, given by indices or by a mask, by as many others."""
        for name in _COLUMNS:
            getattr(self, name)[arms] = getattr(rows, name)

    def changed(self, other: Arms) -> set[str]:
        """Return the names of the columns in which these arms differ from as many others.

        Raises:
            UserError: if a function has replaced a column by something of another shape.
        """
        for name in _COLUMNS:
            column, before = getattr(self, name), getattr(other, name)
            is_column = isinstance(column, np.ndarray) and column.shape == before.shape
            require(is_column, f"column {name}", column, f"an array of shape {before.shape}")
        return {name for name in _COLUMNS if _differ(self, other, name)}

    def check(self, names: set[str]) -> None:
        """Raise a `UserError` if a column of these names has a number that cannot be."""
        for name in sorted(names - {"obstacles"}):
            numbers = np.asarray(getattr(self, name), np.float64).ravel()
            may_be_endless = name in (*_NEVER, "joint_limits")
            is_finite = may_be_endless or bool(np.isfinite(numbers).all())
            require(is_finite, f"column {name}", numbers, "finite")
            low, high = _BOUNDS.get(name, (-math.inf, math.inf))
            is_within = may_be_endless or bool(((low <= numbers) & (numbers <= high)).all())
            require(is_within, f"column {name}", numbers, f"from {low:g} to {high:g}")

    @property
    def ring(self) -> tuple[Floats, Floats]:
        """Smallest and largest distance of targets from the base, each (n,)."""
        return rings([*self.segment_lengths.T], self.given_lengths[0].tolist())

    @property
    def centre(self) -> Floats:
        """Where cursor and hand coincide, (n, 2): where movements begin, or the base."""
        return self.start * self.ring[1][:, None] if self.start.any() else self.start

    def steps_of(self, delay: str) -> NDArray[np.intp]:
        """Return a column of delays, s, in whole control steps, (n,)."""
        return np.rint(getattr(self, delay) / self.base.control_step).astype(np.intp)

    @property
    def lock_steps(self) -> NDArray[np.intp]:
        """Control steps after which joints lock, and are free again, (2, n); -1: never."""
        times = np.stack([self.lock_time, self.unlock_time])
        steps = np.rint(np.where(np.isnan(times), -1.0, times / self.base.control_step))
        steps[:, steps[0] == steps[1]] = -1.0  # free again before it locks
        return steps.astype(np.intp)

    def turn_cursor(self, matrix: Matrix, centre: Sequence[float] | None = None) -> None:
        """Turn, mirror or stretch the cursor once more, about a centre (x, y) or its own."""
        away = 0.0 if centre is None else self.centre - np.asarray(centre)
        moved, turn = (self.shift + away).T, self.turn.transpose(1, 2, 0)
        rows = [(a * turn[0] + b * turn[1], a * moved[0] + b * moved[1]) for a, b in matrix]
        self.turn[:] = np.stack([turned for turned, _ in rows]).transpose(2, 0, 1)
        self.shift[:] = np.stack([shifted for _, shifted in rows], axis=-1) - away

    def which(self, number: Any) -> Bools:
        """Return which joint, or segment, has a number, (n, N); None: all.

        Raises:
            UserError: if there is no joint of such a number.
        """
        count = self.lockable.shape[1]
        if number is None:
            return np.ones((len(self), count), dtype=bool)
        numbers, ahead = np.broadcast_to(number, len(self)), np.arange(1, count + 1)
        accepted = f"from 1 to {count} (from the base), or from -{count} to -1 (from the hand)"
        for joint in np.unique(numbers).tolist():
            is_whole = float(joint).is_integer()
            name, value = "the number of the joint or segment", int(joint) if is_whole else joint
            require(joint in ahead or -joint in ahead, name, value, f"a whole number {accepted}")
        return np.equal(np.where(numbers < 0, numbers + count + 1, numbers)[:, None], ahead)

    def lock(self, joints: Bools, time: Any, until: Any) -> None:
        """Let joints, (n, N), lock at a time, s, and be free from another on, numbers or (n,)."""
        is_locked = self.lockable.any(axis=1) & ~np.isnan(self.lock_time)
        for column, word, value in (
            (self.lock_time, "lock", time),
            (self.unlock_time, "open", np.where(np.isinf(until), np.nan, until)),
        ):
            times = np.broadcast_to(value, len(self))
            is_equal = (column == times) | ((column != column) & (times != times))
            is_other = is_locked & ~is_equal
            if is_other.any():
                pair = {*column[is_other].tolist(), *times[is_other].tolist()}
                texts = sorted("never" if each != each else f"{each:g} s" for each in pair)
                raise UserError(f"locked joints must {word} at one time, got {' and '.join(texts)}")
            column[:] = times
        self.lockable |= joints

    def parameters(self, touched: frozenset[str], row: int = 0) -> ArmParameters:
        """Return the parameters of one arm, checked: those of the base, but for touched columns."""
        values = {name: _as_numbers(getattr(self, name)[row]) for name in touched & _OF_BODY}
        if "lockable" in touched:
            values["lockable_joints"] = tuple(np.flatnonzero(self.lockable[row]).tolist())
        return replace(self.base, **values) if values else self.base

    def columns(self, touched: frozenset[str]) -> ArmColumns:
        """Return the parameters of all arms for an engine, unchecked."""
        from mmc_gym.body.parameters import ArmColumns

        values = {field.name: getattr(self.base, field.name) for field in fields(self.base)}
        values |= {name: _nested(getattr(self, name)) for name in touched & _OF_BODY}
        if "lockable" in touched:
            joints = [(joint, locks) for joint, locks in enumerate(self.lockable.T) if locks.any()]
            values["lockable_joints"] = tuple(np.where(is_, k, np.nan) for k, is_ in joints)
        return ArmColumns(**values)


DELAYS = ("delay", "vision_delay", "action_delay")
"""The columns of what arrives late."""
_NEVER = ("lock_time", "unlock_time", "channel", "clamp")
_OF_JOINTS = ("motor_offset", "joint_offset", "joint_drift")
_STUCK = ("motor_stuck", "joint_stuck")
_COLUMNS = tuple(field.name for field in fields(Arms) if field.name != "base")
_NUMBERS = ["gravity", "hand_mass", "speed_limit", "torque_limit", "servo_gain", "drive_inertia"]
_NUMBERS += ["joint_friction", "joint_damping", "segment_radius", "substep", "substeps"]
_OF_BODY = frozenset(
    (*_NUMBERS, "segment_lengths", "segment_masses", "joint_limits", "force_field", "obstacles")
)
BODY = _OF_BODY | {"lockable"}
"""The columns that the engine simulates."""
JOINT_NOISE = frozenset(("joint_noise", "joint_noise_speed"))
VISION_NOISE = frozenset(("vision_noise", "vision_noise_distance"))
ACTION_NOISE = frozenset(("action_noise", "action_noise_size"))
"""The columns that say how noisy joints, sight and actions are."""
MISSED = ("action_dropped", "action_held", "action_repeated")
SPELLS = ("number_dropped", "number_held", "observation_repeated")
"""The columns that say how often something happens to actions and observations."""
NOISE = JOINT_NOISE | VISION_NOISE | ACTION_NOISE | {"observation_noise"}
_SIZES = NOISE | {"dead_zone", "backlash", "encoder", *DELAYS}
_CHANCES = (*MISSED, *SPELLS)
_BOUNDS = dict.fromkeys(_SIZES, (0.0, math.inf)) | dict.fromkeys(_CHANCES, (0.0, 1.0))
_BOUNDS |= {f"{name}_steps": (1.0, math.inf) for name in _CHANCES}
_AT_START = BODY - {"hand_mass", "force_field"} | {"channel", "start", "given_lengths"}
_AT_START |= {"lock_time", "unlock_time"}
IN_FLIGHT = frozenset(_COLUMNS) - _AT_START
"""The columns that may change within an episode: of the load, cursor, motors and senses."""


def _differ(arms: Arms, other: Arms, name: str) -> bool:
    values, others = getattr(arms, name), getattr(other, name)
    is_equal = (values == others) | ((values != values) & (others != others))  # NaN is NaN
    return not is_equal.all()


def _as_numbers(value: Any) -> Any:
    """Return an array, or a number of numpy, as plain numbers in tuples."""
    if isinstance(value, np.ndarray):
        return tuple(map(_as_numbers, value))
    return value.item() if isinstance(value, np.generic) else value


def _nested(column: Any) -> Any:
    """Return a column (n, …) as tuples of arrays (n,), or of numbers that all arms share."""
    if column.ndim > 1:
        return tuple(map(_nested, np.moveaxis(column, 1, 0)))
    if column.dtype == object:  # tuples of obstacles
        return column[0] if len(set(column)) == 1 else column
    return column[0].item() if (column == column[0]).all() else column
