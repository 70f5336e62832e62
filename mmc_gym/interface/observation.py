"""The observations of this package: the place of each number, in numpy and torch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, sin, sqrt
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mmc_gym._errors import all_true, any_true, require, require_floats
from mmc_gym.geometry import Floats

Observation: TypeAlias = "NDArray[Any] | Mapping[str, NDArray[Any]]"


class ObservationParts(NamedTuple):
    """The parts of observations, arrays of numpy or torch with the batch in front.

    Target and offset are vectors in the first segment's frame, whose x axis is that segment.
    """

    cosines: Any  #: of the joint angles, (..., N)
    sines: Any  #: of the joint angles, (..., N)
    speeds: Any  #: joint velocities as fractions of their limit, (..., N)
    target: Any  #: position of the target, segment lengths, (..., 2)
    offset: Any  #: target − hand, segment lengths, (..., 2)
    bounded: Any  #: offset / (OFFSET_SCALE + |offset|), (..., 2)


OFFSET_SCALE = 0.05  # segment lengths
INCONSISTENT = 1e-4  # difference of cos² + sin² from 1 that rounding does not make


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

    def encode(
        self,
        joint_angles: list[float] | Floats,
        joint_speeds: list[float] | Floats,
        *,
        hand: Sequence[float] | Floats,
        target: Sequence[float] | Floats,
    ) -> Any:
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
            is_complete = len(values) == self.size + self.context_size
            if is_complete and observation.dtype.char in "fd" and math.isfinite(sum(values)):
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
        shapes = {name: row.shape for name, row in rows.items()}
        is_one_batch = len({shape[:-1] for shape in shapes.values()}) == 1
        require(is_one_batch, "observation", shapes, "of arrays with the same batch axes")
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
        """Split observations of either kind; see `flatten`.

        Of the posture alone, the `observation` of `MMCReachGoal-v0`, target and offset are empty.
        """
        values = self.flatten(observation, arrays)
        posture = values if values is observation else observation["observation"]
        count, end = self.joint_count, self.posture_size
        return ObservationParts(
            cosines=posture[..., :count],
            sines=posture[..., count : 2 * count],
            speeds=posture[..., 2 * count : end],
            target=values[..., end : end + 2],
            offset=values[..., end + 2 : end + 4],
            bounded=values[..., end + 4 : end + 6],
        )

    def whole_offset(self, parts: ObservationParts) -> NDArray[np.float64]:
        """Return the offset of observations, (..., 2); a clipped one follows from the bounded one.

        A cursor may be seen farther away than an arm can reach, see `limits`.  An offset may also
        lack a number: it is 0 where the bounded one is not.
        """
        offset: NDArray[np.float64] = parts.offset
        is_clipped = np.abs(offset) == self.limits[-3]
        if not all_true(offset):
            is_clipped |= (offset == 0) & (parts.bounded != 0)
        if not any_true(is_clipped):
            return offset
        share = np.linalg.norm(parts.bounded, axis=-1, keepdims=True)
        size = OFFSET_SCALE / np.maximum(1 - share, 1e-4)
        return np.where(is_clipped.any(axis=-1, keepdims=True), parts.bounded * size, offset)

    def lost(self, parts: ObservationParts) -> NDArray[np.bool_] | None:
        """Return which angles, speeds and targets may lack a number, (..., 2 N + 1); None: none.

        Sensors that fail show 0.  An angle lacks a number if its cosine or sine is 0, and they are
        not those of one angle; a speed or target with a 0 may.
        """
        if all(map(all_true, (parts.cosines, parts.sines, parts.speeds, parts.target))):
            return None
        is_zero = (parts.cosines == 0) | (parts.sines == 0), parts.speeds == 0, parts.target == 0
        lost = np.concatenate([*is_zero[:2], is_zero[2].any(axis=-1, keepdims=True)], axis=-1)
        if not any_true(lost):
            return None
        size = parts.cosines * parts.cosines + parts.sines * parts.sines
        lost[..., : self.joint_count] &= np.abs(size - 1) > INCONSISTENT
        return lost


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


def relative_speeds(joint_velocities: list[float] | Floats, limit: float) -> Any:
    """Return joint velocities, a list of N or (..., N), as fractions of their limit, within ±1."""
    if isinstance(joint_velocities, list):
        return [
            -1.0 if velocity < -limit else 1.0 if velocity > limit else velocity / limit
            for velocity in joint_velocities
        ]
    # np.clip would take twice as long for few arms.
    speeds: Floats = np.maximum(joint_velocities / limit, -1.0)
    return np.minimum(speeds, 1.0, out=speeds)
