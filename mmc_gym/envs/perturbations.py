"""Perturbations of the body, of the cursor that stands for the hand, or of the senses.

Each is a frozen dataclass of physical parameters.  They can be combined.  Some change the body
(`change_body`), whose new parameters are checked.  Some move the cursor, such as a visuomotor
rotation.  Noise and delay change observations, not rewards.  `Timed` perturbations begin or grow
within an episode.  Lengths are in segment lengths.

`mmc_gym.envs.names` gives them names, with any strength.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import (
    LARGEST_SIZE,
    LONGEST,
    UserError,
    frozen,
    is_point,
    is_whole,
    nearest,
    require,
    require_between,
    require_finite,
    require_number,
    require_numbers,
    require_positive,
    shown,
)
from mmc_gym.envs.workspace import Point, distances
from mmc_gym.interface import Seen

if TYPE_CHECKING:  # names are registered without loading the physics
    from mmc_gym.body import ArmParameters

Floats = NDArray[np.float64]
Place = tuple[Any, Any]  # (x, y): numbers, or arrays of one shape
FOUR_DISCS = ((1.5, 1.0, 0.25), (-1.5, 1.0, 0.25), (1.5, -1.0, 0.25), (-1.5, -1.0, 0.25))


class Drawn(np.ndarray):
    """Numbers drawn for many arms from a distribution whose ends have been checked."""


def ends_of(distribution: Any) -> tuple[float, float]:
    """Return the least and greatest value; for an infinite tail, its quantile at 1e-6."""
    ends = zip(distribution.support(), (1e-6, 1 - 1e-6), strict=True)
    low, high = (float(end if np.isfinite(end) else distribution.ppf(tail)) for end, tail in ends)
    return low, high


def drawn_fields(*perturbations: Perturbation) -> list[str]:
    """Return the names of the fields that are distributions, see `mmc_gym.envs.drawn`."""
    fields = (field for one in perturbations for field in vars(one).items())
    return [name for name, value in fields if hasattr(value, "ppf")]


class Perturbation:
    """The base class of perturbations, which itself changes nothing."""

    known: bool = False  # whether agents are given the changed body
    #: field values that mean no change; without any, a perturbation cannot be `Timed`
    neutral: ClassVar[Mapping[str, float]] = {}

    def __init_subclass__(cls) -> None:
        """Make `__post_init__` check both ends of a distribution that is the value of a field."""
        if "__post_init__" not in vars(cls):
            return
        check: Callable[[Perturbation], None] = vars(cls)["__post_init__"]

        def check_ends(self: Perturbation) -> None:
            drawn = {name: ends_of(getattr(self, name)) for name in drawn_fields(self)}
            for end in (0, 1) if drawn else ():
                at_end = object.__new__(type(self))
                vars(at_end).update({**vars(self), **{k: ends[end] for k, ends in drawn.items()}})
                check(at_end)
            if not drawn and not any(isinstance(one, Drawn) for one in vars(self).values()):
                check(self)

        cls.__post_init__ = check_ends  # type: ignore[attr-defined]

    def grown(self, share: Any) -> Self:
        """Return the perturbation at a share (0 to 1) of its strength, a number or (n,)."""
        grown = object.__new__(type(self))  # its numbers may become arrays, and are checked already
        vars(grown).update(vars(self))
        vars(grown).pop("turn", None)
        for name, none in self.neutral.items():
            vars(grown)[name] = none + share * (getattr(self, name) - none)
        return grown

    def change_body(self, body: ArmParameters) -> ArmParameters:
        """Return the arm under this perturbation."""
        return body

    def check_hooks(self) -> None:
        """Raise a `UserError` if the class changes nothing, as with a misspelt method."""
        changes = type(self).change_body is not Perturbation.change_body
        if not changes and not isinstance(self, Noise | Cursor | Delay | Feedback | Channel):
            found = nearest("change_body", vars(type(self)))
            raise UserError(
                f"the perturbation {type(self).__name__} must have a method change_body(self, body)"
                f"{f', got {found}' if found else ''}: without one it changes nothing"
            )


@frozen
class ForceField(Perturbation):
    """A viscous curl field pushes the hand sideways: force = `curl` · (v_y, −v_x).  Fields add up.

    After Shadmehr & Mussa-Ivaldi (1994), J. Neurosci. 14:3208.  The hand leaves its course where
    the field drives the servos to their torque limit.
    """

    curl: float = 60.0  #: mass / s; positive bends to the right of the movement
    neutral = {"curl": 0.0}

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        (xx, xy), (yx, yy) = body.force_field or ((0.0, 0.0), (0.0, 0.0))
        return replace(body, force_field=((xx, xy + self.curl), (yx - self.curl, yy)))


@frozen
class Channel(Perturbation):
    """Stiff walls confine the hand to the line from its start to the first target.

    After Scheidt, Reinkensmeyer, Conditt, Rymer & Mussa-Ivaldi (2000), J. Neurophysiol. 84:853.
    `info` has the `channel_force` with which the hand pushes to the left, and the `ideal_force`
    that would cancel a curl field: `curl` times the speed along the line.  The slope of
    `channel_force` on `ideal_force` is the share of the field that was learned (Smith, Ghazizadeh &
    Shadmehr 2006, PLoS Biol. 4:e179).
    """

    curl: float = 60.0  #: of the field that `ideal_force` would cancel, see `ForceField`


@frozen
class HandMass(Perturbation):
    """The hand carries a point mass.  Masses add up."""

    mass: float = 3.0  #: segment masses; 3 is as heavy as the default arm
    neutral = {"mass": 0.0}

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        return replace(body, hand_mass=body.hand_mass + self.mass)


@frozen
class Gravity(Perturbation):
    """The arm hangs in gravity, which pulls along −y.  Agents are always given it."""

    acceleration: float = 60.0  #: segment lengths / s²; it is added to the `gravity` of the arm
    known = True
    neutral = {"acceleration": 0.0}

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        x, y = body.gravity
        return replace(body, gravity=(x, y - self.acceleration))


@frozen
class SegmentLength(Perturbation):
    """A segment is longer or shorter than before, as by a tool or growth; its mass is the same."""

    factor: float = 1.2  #: new length over old
    segment: int = -1  #: index of the segment; -1 is the last
    known: bool = False  #: whether agents are given the new length
    neutral = {"factor": 1.0}

    def __post_init__(self) -> None:
        require_positive("factor", self.factor)

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        lengths = list(body.segment_lengths)
        segment = _index("segment", self.segment, len(lengths))
        lengths[segment] = lengths[segment] * self.factor  # not in place: it may be an array
        return replace(body, segment_lengths=tuple(lengths))


@frozen
class LockedJoint(Perturbation):
    """A joint becomes rigid at its present angle until the next reset.

    If it is locked from the start, the other joints can reach all targets.  If it locks later, the
    target may become unreachable: the posture at that time is not known when targets are drawn.
    """

    joint: int = 1  #: index of the joint, from the base outward
    time: float = 0.0  #: when it locks, s after the start; the same for all joints that lock
    known: bool = False  #: whether agents are given the joint (`env.unwrapped.parameters`)
    neutral = {"shown": 0.0}
    shown = 1.0  # 1: locks, 0: does not; an array for many arms

    def __post_init__(self) -> None:
        require_between(0, LONGEST, time=self.time)

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        joint = _index("joint", self.joint, len(body.segment_lengths))
        if np.ndim(self.shown):
            joint = np.where(self.shown, joint, np.nan)
        elif not self.shown:
            return body
        return replace(body, lockable_joints=(*body.lockable_joints, joint))


@frozen
class Obstacles(Perturbation):
    """Fixed discs in the plane stop the arm, without friction.  Several `Obstacles` add up.

    Starting postures and drawn targets are clear of them.  The way between may be blocked, and
    the path of a pursued target may lead through them.  Physics steps are half as long as without
    obstacles, because a fast segment sinks into a disc a little: at most 0.07 in a million control
    steps of rough commands, and 0.14 with full steps.
    """

    discs: tuple[tuple[float, float, float], ...] = FOUR_DISCS[:2]  #: (x, y, radius) of each
    segment_radius: float = 0.05  #: half the thickness of the segments

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        discs = (*body.obstacles, *self.discs)
        arm = replace(body, obstacles=discs, segment_radius=self.segment_radius)
        if body.obstacles:  # physics steps are short already
            return arm
        return replace(arm, substep=body.substep / 2, substeps=2 * body.substeps)


class Noise(Perturbation, ABC):
    """Noise of the senses, white and normally distributed; noise of 0 draws no random numbers."""

    @property
    def is_heard(self) -> Any:
        """Whether the noise is not 0, a bool or (n,) for n arms."""
        differ = [getattr(self, name) != none for name, none in self.neutral.items()]
        return reduce(np.logical_or, differ) if differ else True

    @abstractmethod
    def disturb(self, seen: Seen, draw: Callable[[int], Floats]) -> Seen:
        """Return `seen` with noise; `draw(k)` gives standard normal numbers, (..., k)."""


class Cursor(Perturbation, ABC):
    """A cursor is seen, measured and rewarded in place of the hand."""

    #: (x, y), where cursor and hand coincide.  None: where the task's movements begin, or the base
    #: if they begin anywhere.
    centre: Point | None
    keeps_distance: ClassVar[bool] = False  #: if the cursor is as far from the centre as the hand
    shown: Any = 1.0  # in `neutral` of cursors that cannot grow: 0 before they begin, then 1

    @abstractmethod
    def cursor(self, x: Any, y: Any, target: Place) -> Place:
        """Return where the cursor is for a hand at (x, y): numbers, or arrays of one shape."""

    def hand(self, x: Any, y: Any) -> Place:
        """Return where the hand is for a cursor at the target (x, y): numbers, or arrays."""
        return x, y

    def farthest(self, reach: float) -> float:
        """Return a distance from the base that the cursor never exceeds, grown or not."""
        return 3 * max(reach, math.hypot(*(self.centre or (0.0, 0.0))))

    @cached_property
    def turn(self) -> tuple[Any, Any]:
        """Cosine and sine of its `degrees`."""
        return _turn(self.degrees)  # type: ignore[attr-defined]

    def _if_shown(self, cursor: Place, hand: Place) -> Place:
        """Return the position of the cursor, or of the hand until the perturbation begins."""
        if isinstance(self.shown, float):
            return cursor if self.shown else hand
        x, y = (np.where(self.shown, one, other) for one, other in zip(cursor, hand, strict=True))
        return x, y


@frozen
class VisuomotorRotation(Cursor):
    """The cursor is the hand, turned about a centre.

    After Krakauer, Pine, Ghilardi & Ghez (2000), J. Neurosci. 20:8916, who turned by 30°.
    """

    degrees: float = 30.0  #: counter-clockwise
    #: as for every cursor.  A turn about the base leaves all targets in reach; one about another
    #: point may take fixed targets near the border out of reach.
    centre: Point | None = None
    neutral = {"degrees": 0.0}
    keeps_distance = True

    def __post_init__(self) -> None:
        require_finite("degrees", self.degrees)
        if self.centre is not None:
            require_numbers("centre", self.centre, "two finite values (x, y)", is_point)

    @override
    def cursor(self, x: Any, y: Any, target: Place | None = None) -> Place:
        return self._turned(x, y, *self.turn)

    @override
    def hand(self, x: Any, y: Any) -> Place:
        cos, sin = self.turn
        return self._turned(x, y, cos, -sin)

    def _turned(self, x: Any, y: Any, cos: Any, sin: Any) -> Place:
        centre = self.centre or (0.0, 0.0)
        x, y = x - centre[0], y - centre[1]
        return centre[0] + cos * x - sin * y, centre[1] + sin * x + cos * y

    @override
    def farthest(self, reach: float) -> float:
        half = math.radians(min(abs(self.degrees), 180.0) / 2)
        return reach + 2 * math.sin(half) * math.hypot(*(self.centre or (0.0, 0.0)))


@frozen
class CursorGain(Cursor):
    """The cursor is `factor` times as far from the centre as the hand.

    After Krakauer, Pine, Ghilardi & Ghez (2000), J. Neurosci. 20:8916, who also changed the gain.
    """

    factor: float = 1.4  #: distance of the cursor over that of the hand
    centre: Point | None = None
    neutral = {"factor": 1.0}

    def __post_init__(self) -> None:
        require_positive("factor", self.factor)

    @override
    def cursor(self, x: Any, y: Any, target: Place) -> Place:
        centre = self.centre or (0.0, 0.0)
        return centre[0] + self.factor * (x - centre[0]), centre[1] + self.factor * (y - centre[1])

    @override
    def hand(self, x: Any, y: Any) -> Place:
        centre = self.centre or (0.0, 0.0)
        return centre[0] + (x - centre[0]) / self.factor, centre[1] + (y - centre[1]) / self.factor

    @override
    def farthest(self, reach: float) -> float:
        away = math.hypot(*(self.centre or (0.0, 0.0)))
        return max(reach, self.factor * reach + abs(1 - self.factor) * away)


@frozen
class CursorMirror(Cursor):
    """The cursor is the mirror image of the hand, on the other side of an axis.

    After Telgen, Parvin & Diedrichsen (2014), J. Neurosci. 34:13768, who swapped left and right.
    """

    degrees: float = 90.0  #: direction of the axis, which goes through the centre
    centre: Point | None = None
    neutral = {"shown": 0.0}
    keeps_distance = True

    def __post_init__(self) -> None:
        require_finite("degrees", self.degrees)

    @override
    def cursor(self, x: Any, y: Any, target: Place | None = None) -> Place:
        cos, sin = self.turn
        centre = self.centre or (0.0, 0.0)
        x_away, y_away = x - centre[0], y - centre[1]
        along, across = cos * x_away + sin * y_away, cos * y_away - sin * x_away
        image = cos * along + sin * across, sin * along - cos * across
        return self._if_shown((centre[0] + image[0], centre[1] + image[1]), (x, y))

    @override
    def hand(self, x: Any, y: Any) -> Place:
        return self.cursor(x, y)


@frozen
class ErrorClamp(Cursor):
    """The cursor moves in a fixed direction, as far from the centre as the freely moving hand.

    After Morehead, Taylor, Parvin & Ivry (2017), J. Cogn. Neurosci. 29:1061.
    """

    #: from the direction of the target to that of the cursor, counter-clockwise
    degrees: float = 15.0
    centre: Point | None = None
    neutral = {"shown": 0.0}
    keeps_distance = True

    def __post_init__(self) -> None:
        require_finite("degrees", self.degrees)

    @override
    def cursor(self, x: Any, y: Any, target: Place) -> Place:
        cos, sin = self.turn
        centre = self.centre or (0.0, 0.0)
        along, across, _ = _direction(centre, target)
        _, _, away = _direction(centre, (x, y))
        turned = cos * along - sin * across, sin * along + cos * across
        clamped = centre[0] + away * turned[0], centre[1] + away * turned[1]
        return self._if_shown(clamped, (x, y))


@frozen
class CursorJump(Cursor):
    """The cursor is the hand, until it jumps sideways from the way to the target and stays offset.

    After Saunders & Knill (2005), Exp. Brain Res. 162:458.
    """

    percent: float = 10.0  #: of the way from the centre to the target; positive to the left
    share: float = 0.25  #: of the way that the hand has covered when the cursor jumps
    centre: Point | None = None
    neutral = {"percent": 0.0}

    def __post_init__(self) -> None:
        require_number("percent", self.percent, "at most 100", lambda jump: abs(jump) <= 100)
        require_number("share", self.share, "from 0 to 1", lambda share: 0 <= share <= 1)

    @override
    def cursor(self, x: Any, y: Any, target: Place) -> Place:
        centre = self.centre or (0.0, 0.0)
        along, across, way = _direction(centre, target)
        made = (x - centre[0]) * along + (y - centre[1]) * across
        jump = (made >= self.share * way) * (self.percent / 100) * way
        return x - jump * across, y + jump * along


@dataclass(frozen=True)
class Cursors(Cursor):
    """Several cursors combined: each transforms the position that the previous one shows."""

    parts: tuple[Cursor, ...]

    @property
    def centre(self) -> Point | None:  # type: ignore[override]
        """The common centre of all parts; None if their centres differ."""
        centres = {part.centre for part in self.parts}
        return centres.pop() if len(centres) == 1 else None

    @property
    def keeps_distance(self) -> bool:  # type: ignore[override]
        """Whether every part keeps the distance from its centre."""
        return all(part.keeps_distance for part in self.parts)

    @override
    def cursor(self, x: Any, y: Any, target: Place) -> Place:
        return reduce(lambda place, part: part.cursor(*place, target), self.parts, (x, y))

    @override
    def hand(self, x: Any, y: Any) -> Place:
        return reduce(lambda place, part: part.hand(*place), reversed(self.parts), (x, y))

    @override
    def farthest(self, reach: float) -> float:
        return reduce(lambda farthest, part: part.farthest(farthest), self.parts, reach)


def _turn(degrees: Any) -> tuple[Any, Any]:
    """Return cosine and sine of an angle or of an array of angles, bit for bit the same."""
    if isinstance(degrees, np.ndarray):  # numpy's cosine may differ; few angles do
        angles, places = np.unique(degrees, return_inverse=True)
        return tuple(np.array([*map(_turn, angles.tolist())])[places].T)
    return math.cos(math.radians(degrees)), math.sin(math.radians(degrees))


def _direction(centre: Point, target: Place) -> tuple[Any, Any, Any]:
    """Return x and y of the unit vector from centre to target (0 if equal), and their distance."""
    x, y = target[0] - centre[0], target[1] - centre[1]
    way = np.sqrt(x * x + y * y)  # rounds alike for numbers and arrays; `hypot` does not
    whole = way + (way == 0.0)
    return x / whole, y / whole, way


@frozen
class JointNoise(Noise):
    """Noise of joint angles and velocities.

    Standing still, people feel their joint angles to about 1° (van Beers, Sittig & Denier van
    der Gon, 1998, Exp. Brain Res. 122:367).
    """

    #: standard deviation of the angles, rad; that of the velocities is 10 / s times as large
    std: float = 0.02
    speed_std: float = 0.0  #: increase of `std` with the joint's speed, s
    neutral = {"std": 0.0, "speed_std": 0.0}
    _RATE: ClassVar[float] = 10.0  # 1/s

    def __post_init__(self) -> None:
        require_between(0, LARGEST_SIZE, std=self.std, speed_std=self.speed_std)

    @override
    def disturb(self, seen: Seen, draw: Callable[[int], Floats]) -> Seen:
        angles, speeds = seen.joint_angles, seen.joint_speeds
        std = (self.std + self.speed_std * np.abs(speeds.T)).T  # `std` may be an array of n arms
        of_angles, of_speeds = np.split(draw(2 * angles.shape[-1]), 2, axis=-1)
        return replace(
            seen,
            joint_angles=angles + std * of_angles,
            joint_speeds=speeds + self._RATE * std * of_speeds,
        )


@frozen
class VisionNoise(Noise):
    """Noise of the seen hand and target, in each coordinate."""

    std: float = 0.03  #: standard deviation, segment lengths
    #: increase of `std` with the distance of hand and target (Weber's law)
    distance_std: float = 0.0
    neutral = {"std": 0.0, "distance_std": 0.0}

    def __post_init__(self) -> None:
        require_between(0, LARGEST_SIZE, std=self.std, distance_std=self.distance_std)

    @override
    def disturb(self, seen: Seen, draw: Callable[[int], Floats]) -> Seen:
        std = (self.std + self.distance_std * distances(seen.hand, seen.target))[..., None]
        of_hand, of_target = np.split(draw(4), 2, axis=-1)
        return replace(seen, hand=seen.hand + std * of_hand, target=seen.target + std * of_target)


@dataclass(frozen=True)
class Delay(Perturbation):
    """Senses are late; until the delay is over, they show the start."""

    seconds: float = 0.1  #: the delay, at most 1,000, rounded to control steps; several add
    neutral = {"seconds": 0.0}

    def __post_init__(self) -> None:
        require_between(0, LONGEST, seconds=self.seconds)


@frozen
class SensoryDelay(Delay):
    """All observations are late; until the delay is over, they show the start.

    Gymnasium has `gymnasium.wrappers.DelayObservation`, but it shows zeros at first, which no
    posture has, and cannot wrap a vector environment.
    """


@frozen
class VisionDelay(Delay):
    """Hand and target are seen late, while the joints are felt on time.

    Until the delay is over, hand and target are seen where they were at the start.  People also see
    later than they feel (Crevecoeur, Munoz & Scott 2016, J. Neurosci. 36:8598).
    """


class Feedback(Perturbation, ABC):
    """The hand is seen at the start, and after that only at some times.

    In between, observations repeat where the hand, or its cursor, was last seen.
    `info["is_hand_seen"]` says whether it is seen now.  The target is always seen.
    """

    neutral = {"hidden": 0.0}
    hidden: Any = 1.0  # 1 from when it begins, 0 before

    @abstractmethod
    def shows(self, ends: Any) -> Any:
        """Return whether hands are seen, (n,), given whether movements end in this step, (n,)."""


@frozen
class NoFeedback(Feedback):
    """The hand is never seen after the start: no visual correction hides what was learned."""

    @override
    def shows(self, ends: Any) -> Any:
        return ends & False


@frozen
class EndpointFeedback(Feedback):
    """The hand is seen only at the end of the movement, and is shown there from then on.

    The movement ends when the hand is slower than 5 % of its peak speed.  People learn from such
    endpoints, too (Taylor, Krakauer & Ivry 2014, J. Neurosci. 34:3023).
    """

    @override
    def shows(self, ends: Any) -> Any:
        return ends


class OneOf(Perturbation):
    """One of several perturbations, drawn for each episode; `None` is no change.

    Options may be drawn themselves, such as `VisuomotorRotation(uniform(-60, 120))`.
    """

    def __init__(self, *options: Any, weights: Sequence[float] | None = None) -> None:
        """Take perturbations, their names or None, and their relative weights (equal if None)."""
        accepted = "at least two perturbations, names of them, or None"
        require(len(options) > 1, "OneOf", options, accepted)
        self.options = options

        def are_fine(given: tuple[float, ...]) -> bool:
            return len(given) == len(options) and min(given) >= 0 and 0 < sum(given) < np.inf

        accepted = f"{len(options)} numbers of at least 0, not all 0"
        weights = [1.0] * len(options) if weights is None else weights
        self.weights = require_numbers("weights", weights, accepted, are_fine)

    def __repr__(self) -> str:
        return f"OneOf({', '.join(map(repr, self.options))}, weights={self.weights})"

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and vars(other) == vars(self)

    def __hash__(self) -> int:
        return hash((self.options, self.weights))

    @override
    def check_hooks(self) -> None: ...  # its options are checked by themselves

    def ppf(self, shares: Floats) -> Floats:
        """Return the indices of the options at the quantiles `shares`, as floats of its shape."""
        borders = np.cumsum(self.weights) / np.sum(self.weights)
        return np.searchsorted(borders[:-1], shares, side="right").astype(np.float64)

    def support(self) -> tuple[float, float]:
        """Return the indices of the first and the last option."""
        return 0.0, len(self.options) - 1.0


@frozen
class Timed(Perturbation):
    """A perturbation that begins during the episode, and may grow from then on.

    It grows linearly, from no change to its strength.  Drawn targets stay in reach.  People
    correct for a change within the movement (Crevecoeur, Thonnard & Lefèvre 2020, eNeuro 7).
    """

    perturbation: Perturbation
    at: float = 0.0  #: when it begins, s after the start, rounded to control steps
    over: float = 0.0  #: how long it grows, s, also rounded; 0: full strength at once

    def __post_init__(self) -> None:
        require_between(0, LONGEST, at=self.at, over=self.over)
        neutral = getattr(self.perturbation, "neutral", {})
        if isinstance(self.perturbation, Gravity | SegmentLength | LockedJoint):
            neutral = {}
        accepted = "one that can begin within an episode (cursors, senses, loads, force fields)"
        require(bool(neutral), "perturbation", self.perturbation, accepted)
        accepted = f"0, as a {type(self.perturbation).__name__} cannot grow"
        can_grow = neutral.keys().isdisjoint(("shown", "hidden"))
        require(self.over == 0 or can_grow, "over", self.over, accepted)

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        return self.perturbation.change_body(body)

    @override
    def check_hooks(self) -> None:
        self.perturbation.check_hooks()

    def share(self, steps: Any, control_step: float) -> Any:
        """Return the share (0 to 1) of the full strength after `steps` control steps, (...)."""
        since, rise = steps - np.rint(self.at / control_step), np.rint(self.over / control_step)
        return np.clip((since + (rise == 0)) / np.maximum(rise, 1), 0.0, 1.0)

    @override
    def grown(self, share: Any) -> Self:
        return replace(self, perturbation=self.perturbation.grown(share))

    def moments(self, control_step: float) -> list[int]:
        """Return sorted control steps: the one before it begins, and up to 101 while it grows."""
        at, rise = round(self.at / control_step), round(self.over / control_step)
        growing = np.linspace(at, at + rise, min(rise, 100) + 1)
        return [at - 1, *growing.round().astype(int).tolist()]


def timed_parts(
    perturbations: Sequence[Perturbation], steps: Any, control_step: float
) -> list[Perturbation]:
    """Return the perturbations as they are after `steps` control steps, a number or (n,)."""
    return [
        one.perturbation.grown(one.share(steps, control_step)) if isinstance(one, Timed) else one
        for one in perturbations
    ]


def _index(name: str, index: Any, count: int) -> Any:
    """Return the index as one from 0 to `count` − 1; a negative index counts from the end."""
    if isinstance(index, np.ndarray):  # of many arms
        return index.astype(int) % count
    if isinstance(index, float) and index.is_integer():  # drawn
        index = int(index)
    if not (is_whole(index) and -count <= index < count):
        also = f", {name} {index + 1} from the base" if is_whole(index) and index >= 0 else ""
        accepted = f"an index from {-count} to {count - 1}"
        raise UserError(f"{name} must be {accepted}, got {shown(index)}{also}")
    return index % count
