"""Reaching tasks: where a trial starts, and where its target is.

The target of a trial moves along a path, by one place each control step, or, for via points, each
time it is reached.  It stays at the last place, or starts again if the task is periodic.
"""

from __future__ import annotations

import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import (
    LONGEST,
    SMALLEST_SIZE,
    UserError,
    frozen,
    is_point,
    is_whole,
    nearest,
    require,
    require_between,
    require_finite,
    require_rows,
    require_whole,
)
from mmc_gym.envs.workspace import Point, Workspace


class Trial(NamedTuple):
    """A posture to start from, N joint angles, and the path of the target, a list of (x, y)."""

    joint_angles: list[float]
    targets: list[Point]


class Request(NamedTuple):
    """The arguments with which a task draws a trial."""

    workspace: Workspace  #: of the arm
    random: np.random.Generator  #: the generator to draw from
    trial: int | None = None  #: number of the trial, if the task numbers them; None draws one
    joint_angles: list[float] | None = None  #: posture to start from; None draws one

    def draw_posture(self) -> list[float]:
        """Return the posture to start from.

        A posture is drawn even if `joint_angles` is given, so that later draws are the same.
        """
        drawn = self.workspace.draw_posture(self.random)
        return self.joint_angles or drawn

    def draw_target(self, posture: list[float]) -> Point:
        """Return a target that the hand can reach from a posture."""
        return self.workspace.draw_target(self.random, posture)


class Task(ABC):
    """A reaching task."""

    #: when the target moves to the next place of its path: "time", each control step, or "reach",
    #: when the hand is within the success distance
    advance: ClassVar[Literal["time", "reach"]] = "time"
    periodic: ClassVar[bool] = False  #: whether the path starts again at its end
    #: control steps of an episode in the environments that Gymnasium makes
    episode_steps: ClassVar[int] = 100

    @property
    def start(self) -> Point | None:
        """Start of all movements, (x, y) as fractions of the reach; None if starts differ."""
        return None

    @property
    def trial_count(self) -> int | None:
        """Number of different trials, for `options={"trial": …}`; None: unlimited."""
        return None

    def check(self, workspace: Workspace) -> None:  # noqa: B027  (most tasks suit all arms)
        """Raise a `UserError` if the arm cannot do the task."""

    def check_hooks(self) -> None:
        """Raise a `UserError` if the class seems to misspell `draw`, and overrides no method."""
        members = vars(type(self))
        misspelt = nearest("draw", [name for name, value in members.items() if callable(value)])
        hooks = {"start", "trial_count", "check", "draw"}
        name = f"a method of {type(self).__name__}"
        require(not misspelt or bool(hooks & members.keys()), name, misspelt, "draw(self, request)")

    @abstractmethod
    def draw(self, request: Request) -> Trial:
        """Draw a trial; the paths of all trials have the same number of places."""


@frozen
class RandomTarget(Task):
    """From any posture to a target anywhere in reach.

    Postures are uniform in the joint angles, targets area-uniform over the reachable set.
    """

    @override
    def draw(self, request: Request) -> Trial:
        start = request.draw_posture()
        return Trial(start, [request.draw_target(start)])


@frozen
class DoubleStep(RandomTarget):
    """The target jumps to another place while the hand is on its way.

    After Georgopoulos, Kalaska & Massey (1981), J. Neurophysiol. 46:725.
    """

    delay: float = 0.1  #: when it jumps, s after the start

    def __post_init__(self) -> None:
        require_between(0, LONGEST, delay=self.delay)

    @override
    def draw(self, request: Request) -> Trial:
        start, targets = super().draw(request)
        steps = round(self.delay / request.workspace.body.control_step)
        return Trial(start, targets * steps + [request.draw_target(start)])


@frozen
class ViaPoints(RandomTarget):
    """Random targets one after the other: each appears when the one before has been reached.

    Success means being at the last target.
    """

    advance: ClassVar[Literal["time", "reach"]] = "reach"
    episode_steps: ClassVar[int] = 200
    count: int = 3  #: number of targets in a trial

    def __post_init__(self) -> None:
        require_whole("count", self.count)

    @override
    def draw(self, request: Request) -> Trial:
        start, targets = super().draw(request)
        more = [request.draw_target(start) for _ in range(self.count - 1)]
        return Trial(start, targets + more)


@frozen
class PointToPoint(Task):
    """From one of a list of points to another, starting at rest in the evenly bent posture."""

    points: tuple[Point, ...]  #: (x, y) as fractions of the arm's reach
    #: (start, target) of each trial, as indices of `points`
    pairs: tuple[tuple[int, int], ...]

    def __post_init__(self) -> None:
        require_rows("points", self.points, "points (x, y), finite", is_point)

        def are_indices(pair: tuple[float, ...]) -> bool:
            return len(pair) == 2 and set(pair) <= set(range(len(self.points)))

        accepted = f"at least one pair of indices from 0 to {len(self.points) - 1}"
        require_rows("pairs", self.pairs, accepted, are_indices, range(1, sys.maxsize))

    @property
    @override
    def trial_count(self) -> int:
        return len(self.pairs)

    @property
    @override
    def start(self) -> Point | None:
        starts = {start for start, _ in self.pairs}
        return self.points[starts.pop()] if len(starts) == 1 else None

    @override
    def draw(self, request: Request) -> Trial:
        drawn = int(request.random.integers(len(self.pairs)))
        trial = drawn if request.trial is None else request.trial
        start, target = self._ends(request.workspace, trial)
        return Trial(request.joint_angles or request.workspace.posture_at(start), [target])

    @override
    def check(self, workspace: Workspace) -> None:
        for trial in range(len(self.pairs)):
            start, target = self._ends(workspace, trial)
            posture = workspace.posture_at(start)
            if not (workspace.is_clear(posture) and workspace.contains(target, posture)):
                raise UserError(
                    "task must be one that the perturbed arm can do: it cannot be where trial "
                    f"{trial} starts or ends"
                )

    def _ends(self, workspace: Workspace, trial: int) -> list[Point]:
        """Return start and target of a trial, each (x, y) in segment lengths."""
        ends, reach = (self.points[index] for index in self.pairs[trial]), workspace.outer
        return [(x * reach, y * reach) for x, y in ends]


@frozen
class CuedTarget(PointToPoint):
    """The target waits at the start until a go cue, and may jump across the way in flight.

    All movements have the same start.  For the jump see Saunders & Knill (2005), Exp. Brain Res.
    162:458.
    """

    go_cue: float = 0.0  #: when the target leaves the start, s
    jump: float = 0.0  #: across the way from start to target, percent of it, positive to the left
    jump_time: float = 0.1  #: when it jumps, s after the go cue

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.start is not None, "pairs", self.pairs, "with the same start")
        require_between(0, LONGEST, go_cue=self.go_cue, jump_time=self.jump_time)
        require_finite("jump", self.jump)

    @override
    def draw(self, request: Request) -> Trial:
        workspace, step = request.workspace, request.workspace.body.control_step
        posture, (target,) = super().draw(request)
        start, _ = self._ends(workspace, 0)  # the start is that of all trials
        waits = round(self.jump_time / step) if self.jump else 0
        before = [start] * round(self.go_cue / step) + [target] * waits
        x, y, share = target[0] - start[0], target[1] - start[1], self.jump / 100
        after = target[0] - share * y, target[1] + share * x
        accepted = "small enough for the target to stay in reach"
        require(workspace.contains(after), "jump", self.jump, accepted)
        return Trial(posture, [*before, after])


@frozen
class Pursuit(Task):
    """The target moves along sums of sines, as in manual tracking (McRuer & Jex, 1967).

    Frequencies are multiples of 1 / period.  The multiples are prime, so that no sine is a harmonic
    of another; phases are random.  The centre is half a reach in front of the base (along y).
    """

    periodic: ClassVar[bool] = True
    episode_steps: ClassVar[int] = 500  # one period
    period: float = 10.0  #: time after which the path repeats, s
    multiples_x: tuple[int, ...] = (2, 5)  #: frequencies of the sines in x, per period
    multiples_y: tuple[int, ...] = (3, 7)  #: those in y
    amplitude: float = 0.3  #: sum of the amplitudes in x, and in y, as a fraction of the reach

    def __post_init__(self) -> None:
        require_between(SMALLEST_SIZE, LONGEST, period=self.period)
        require_finite("amplitude", self.amplitude)
        for name in ("multiples_x", "multiples_y"):
            multiples = getattr(self, name)
            are_accepted = isinstance(multiples, Sequence) and bool(multiples)
            are_accepted = are_accepted and all(
                is_whole(multiple) and multiple >= 1 for multiple in multiples
            )
            require(are_accepted, name, multiples, "whole numbers of at least 1, one or more")

    @override
    def draw(self, request: Request) -> Trial:
        workspace, start = request.workspace, request.draw_posture()
        count = max(1, round(self.period / workspace.body.control_step))
        x = self._coordinate(self.multiples_x, count, request.random)
        y = self._coordinate(self.multiples_y, count, request.random)
        path = np.stack([x, 0.5 + y], axis=-1) * workspace.outer
        radii = np.hypot(*path.T)
        if workspace.inner < radii.min() and radii.max() < workspace.outer:
            return Trial(start, [(x, y) for x, y in path.tolist()])
        return Trial(start, [workspace.nearest(point) for point in path.tolist()])

    def _coordinate(
        self, multiples: Sequence[int], count: int, random: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return a coordinate along the path, (count,), in reaches, with random phases."""
        weights = 1 / np.array(multiples)
        amplitudes = self.amplitude * weights / weights.sum()
        time = np.arange(count)[:, None] / count * math.tau
        phases = random.uniform(-math.pi, math.pi, len(multiples))
        waves = amplitudes * np.sin(time * np.array(multiples) + phases)
        return np.asarray(waves.sum(axis=-1))


def outward(distances: Sequence[float], turns: Sequence[float]) -> tuple[Any, Any]:
    """Return `points` and `pairs` of movements outward from half a reach in front of the base.

    There is one for each distance, as a fraction of the reach, and each direction, in radians.
    """
    circles = [
        (distance * math.cos(turn), 0.5 + distance * math.sin(turn))
        for distance in distances
        for turn in turns
    ]
    return ((0.0, 0.5), *circles), tuple((0, end) for end in range(1, len(circles) + 1))
