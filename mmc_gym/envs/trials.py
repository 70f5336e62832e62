"""Trials: where an episode starts and where its targets are, drawn or given as options."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mmc_gym._errors import (
    UserError,
    is_point,
    is_whole,
    require,
    require_array,
    require_choice,
    require_numbers,
    require_rows,
)
from mmc_gym.envs.arms import Floats
from mmc_gym.envs.tasks import RandomTarget, Request, Task, Trial
from mmc_gym.envs.workspace import REACH_TOLERANCE, NoTarget, Point, Workspace

_MOST_TRIALS = 300


class Options(NamedTuple):
    """The options of a reset, checked; None for an option that was not given."""

    joint_angles: list[float] | None = None
    target: Point | None = None
    trial: int | None = None
    #: drawn numbers of all n arms, (n, m); NaN where they are not given
    context: Floats | None = None

    @property
    def has_trial(self) -> bool:
        """Whether any option changes the trial."""
        return self[:3] != (None, None, None)


class Trials:
    """The trials of a task."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.is_own = not type(task).__module__.startswith("mmc_gym.")  #: whether a user wrote it
        #: whether many arms can draw theirs at once
        self.are_random = type(task) is RandomTarget
        self.path_length = 0  #: number of places on the path of the target; 0 before the first

    def draw(self, workspace: Workspace, random: np.random.Generator, options: Options) -> Trial:
        """Return a trial with the options filled in.

        A given target does not move.  Posture and target are always drawn, so that giving one does
        not change the other.  If drawing fails, the trial of a fixed seed is returned.
        """
        try:
            trial = self._draw(workspace, random, options)
        except UserError:  # bad luck: the fixed seed worked when the environment was made
            trial = self._draw(workspace, np.random.default_rng(0), options)
        if self.is_own:
            trial = self._checked(trial, workspace)
        self.path_length = self.path_length or len(trial.targets)
        accepted = f"one whose paths have {self.path_length} places, as in its first trial"
        require(len(trial.targets) == self.path_length, "task", self.task, accepted)
        if options.target is None:
            return trial
        return Trial(options.joint_angles or trial.joint_angles, [options.target])

    def _draw(self, workspace: Workspace, random: np.random.Generator, options: Options) -> Trial:
        """Return a trial of the task; draw again if a posture has no target in reach."""
        posture = options.joint_angles if options.target is None else None
        request = Request(workspace, random, options.trial, posture)
        for _ in range(_MOST_TRIALS):
            try:
                return self.task.draw(request)
            except NoTarget as error:
                reason = error
        raise reason

    def _checked(self, trial: Any, workspace: Workspace) -> Trial:
        name = f"{type(self.task).__name__}.draw"
        accepted = "a Trial(joint_angles, targets)"
        require(isinstance(trial, Trial), f"what {name} returns", trial, accepted)
        count = len(workspace.body.segment_lengths)
        posture = require_finite_numbers(f"joint_angles of {name}", trial[0], count)

        def is_reachable(point: tuple[float, ...]) -> bool:
            slack = REACH_TOLERANCE * workspace.outer
            return is_point(point) and math.dist(point, workspace.nearest(point)) <= slack

        ring = f"{workspace.inner:g} to {workspace.outer:g} from the base"
        accepted = f"a path, one or more points (x, y) that are {ring}"
        counts = range(1, sys.maxsize)
        path = require_rows(f"targets of {name}", trial[1], accepted, is_reachable, counts)
        return Trial(posture, [(x, y) for x, y in path])

    def check(self, options: Mapping[str, Any], workspace: Workspace) -> Options:
        """Return the options of a trial, checked; raise a `UserError` if one cannot be accepted.

        They must respect joint limits, reach and obstacles, and locked joints must leave a target
        in reach.
        """
        posture, target, trial = map(options.get, Options._fields[:3])
        checked = Options(
            None if posture is None else _check_posture(posture, workspace),
            None if target is None else check_target("options['target']", target, workspace),
            None if trial is None else self._check_number(trial),
        )
        if workspace.locked and posture is not None:
            try:
                self._draw(workspace, np.random.default_rng(0), checked)
            except NoTarget as error:
                name, accepted = "options['joint_angles']", "a posture with a target in reach"
                raise UserError(f"{name} must be {accepted}, got {checked.joint_angles}") from error
        return checked

    def _check_number(self, trial: Any) -> int:
        count = self.task.trial_count or 0
        accepted = f"a whole number from 0 to {count - 1}"
        if not count:
            accepted = f"left out, as {self.task} has no numbered trials"
        require(is_whole(trial) and 0 <= trial < count, "options['trial']", trial, accepted)
        return int(trial)


def check_names(options: Any) -> Mapping[str, Any]:
    """Return the options of a reset, or none; raise a `UserError` if one is not known."""
    options = {} if options is None else options
    accepted = "a mapping with 'joint_angles', 'target', 'trial' or 'context'"
    require(isinstance(options, Mapping), "options", options, accepted)
    for name in options:
        require_choice("options", name, Options._fields)
    checked: Mapping[str, Any] = options
    return checked


def check_context(context: Any, names: Sequence[str], count: int | None) -> Floats:
    """Return the numbers of a context as in `Options`; `count` is that of the arms of a vector."""
    name = "options['context']"
    require(isinstance(context, Mapping), name, context, "a mapping of numbers by name")
    numbers = np.full((count or 1, len(names)), np.nan)
    accepted = "a number" if count is None else f"a number, or {count} of them"
    for key, value in context.items():
        if str(key).startswith("_"):  # the masks of Gymnasium's vector infos
            continue
        require_choice(name, key, names)
        array = require_array(f"{name}[{key!r}]", value, accepted)
        has_shape = array.shape in ((), (count,))
        require(has_shape, f"{name}[{key!r}]", value, accepted)
        numbers[:, names.index(key)] = array
    return numbers


def _check_posture(posture: ArrayLike, workspace: Workspace) -> list[float]:
    name, body = "options['joint_angles']", workspace.body
    numbers = require_finite_numbers(name, posture, len(body.segment_lengths))
    angles = [math.remainder(angle, math.tau) for angle in numbers]
    for angle, (low, high) in zip(angles, body.joint_limits or (), strict=False):
        accepted = f"within the joint limits {body.joint_limits}"
        require(low <= angle <= high, name, angles, accepted)
    accepted = f"a posture in which the arm is clear of the obstacles {body.obstacles}"
    require(workspace.is_clear(angles), name, angles, accepted)
    return angles


def check_target(name: str, target: ArrayLike, workspace: Workspace) -> Point:
    """Return the target (x, y); raise a `UserError` unless it can be reached."""
    x, y = require_numbers(name, target, "2 finite numbers", is_point)
    clear = " and clear of the obstacles" if workspace.body.obstacles else ""
    accepted = f"between {workspace.inner:g} and {workspace.outer:g} from the base"
    require(workspace.contains((x, y)), name, (x, y), accepted + clear)
    return x, y


def require_finite_numbers(name: str, value: ArrayLike, count: int) -> list[float]:
    """Return the value as `count` floats, or raise a `UserError` that names the argument."""

    def are_finite(numbers: tuple[float, ...]) -> bool:
        return len(numbers) == count and all(map(math.isfinite, numbers))

    return list(require_numbers(name, value, f"{count} finite numbers", are_finite))
