"""What a reaching environment is made of: its arguments, checked, and all that follows from them.

Nothing here changes while an environment runs, and the single and the vector environment use the
same, so that both mean the same by every argument.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import UserError
from mmc_gym.body import ArmParameters
from mmc_gym.body.engines import Engine
from mmc_gym.envs.perturbations import (
    LockedJoint,
    Noise,
    Perturbation,
    Readings,
    SensoryDelay,
    VisuomotorRotation,
)
from mmc_gym.envs.scenarios import environment_id, find_perturbation, find_task
from mmc_gym.envs.tasks import Request, Task, Trial
from mmc_gym.envs.workspace import Point, Workspace
from mmc_gym.interface import (
    CONTROLS,
    Control,
    ObservationLayout,
    action_meaning,
    max_joint_delta,
    relative_speeds,
)

RewardType = Literal["dense", "sparse"]


class ReachSetup:
    """The arguments of `MMCReachEnv`, and what follows from them.

    Attributes:
        told: physical parameters of the arm, as agents are told them.
        body: those of the arm that is simulated; perturbations make the difference.
        task: where trials come from.
        task_name: the name that it was given by, if any.
        perturbations: what goes wrong.
        caption: task and perturbations, for a picture; empty if they are the plain ones.
        workspace: what the hand can reach.
        rotation: the visuomotor rotation, or None.
        noises: of the senses.
        noise_draws: how many normal numbers each of them takes.
        delay: of the senses, control steps.
        are_senses_disturbed: whether there is any noise or delay.
        lock_step: after how many control steps the lockable joints lock; None: never.
        path_length: places on the path of the target.
        action: what the actions mean.
        layout: of the observations; its `reach` is the sum of the told lengths.
        farthest: distance from the base within which the hand, or its cursor, always is.
        may_exceed_reach: whether that is beyond `reach`, so that observations must be clipped.
    """

    def __init__(
        self,
        *,
        control: Control = "joint_position",
        reward_type: RewardType = "dense",
        control_weight: float = 0.1,
        smoothness_weight: float = 0.0,
        success_distance: float = 0.05,
        task: str | Task = "random",
        perturbations: Sequence[str | Perturbation] = (),
        engine: Engine = "pymunk",
        **arm_parameters: Any,
    ) -> None:
        """Check the arguments; they are listed in `MMCReachEnv`.

        Raises:
            ValueError: if one is outside what it accepts.
            TypeError: if one is unknown.
        """
        require_one_of("control", control, CONTROLS)
        require_one_of("reward_type", reward_type, get_args(RewardType))
        require_one_of("engine", engine, get_args(Engine))
        _require_at_least_zero("control_weight", control_weight)
        _require_at_least_zero("smoothness_weight", smoothness_weight)
        _require_at_least_zero("success_distance", success_distance)
        self.control: Control = control
        self.reward_type: RewardType = reward_type
        self.control_weight = float(control_weight)
        self.smoothness_weight = float(smoothness_weight)
        self.success_distance = float(success_distance)
        self.engine: Engine = engine
        self.task = find_task(task)
        if isinstance(perturbations, (str, Perturbation)):
            perturbations = (perturbations,)
        self.perturbations = tuple(map(find_perturbation, perturbations))
        self.task_name = task if isinstance(task, str) else None
        named = [*([] if task == "random" else [task]), *perturbations]
        self.caption = ", ".join(n if isinstance(n, str) else type(n).__name__ for n in named)
        self._apply_perturbations(ArmParameters(**arm_parameters))
        self.action = action_meaning(control, self.told)
        lengths = self.told.segment_lengths
        self.joint_count, self.reach = len(lengths), sum(lengths)
        self.layout = ObservationLayout(self.joint_count, self.reach)
        self.action_space = spaces.Box(-1.0, 1.0, (self.joint_count,), np.float32)
        self.path_length = self.task.path_length(self.told.control_step)
        self.task.check(self.workspace)

    def _apply_perturbations(self, parameters: ArmParameters) -> None:
        changes = self.perturbations
        step = parameters.control_step
        self.body = reduce(lambda arm, change: change.change_body(arm), changes, parameters)
        told = [change for change in changes if change.told]
        self.told = reduce(lambda arm, change: change.change_body(arm), told, parameters)
        self.noises = [change for change in changes if isinstance(change, Noise)]
        count = len(parameters.segment_lengths)
        self.noise_draws = [noise.draws(count) for noise in self.noises]
        delays = [change.seconds for change in changes if isinstance(change, SensoryDelay)]
        self.delay = round(sum(delays) / step)
        self.are_senses_disturbed = bool(self.noises or self.delay)
        times = {change.time for change in changes if isinstance(change, LockedJoint)}
        if len(times) > 1:
            raise UserError(f"locked joints must lock at one time, got the times {sorted(times)}")
        self.lock_step = round(times.pop() / step) if times else None
        locked = self.body.lockable_joints if self.lock_step == 0 else ()
        self.workspace = Workspace(self.body, self.told, locked)
        self.rotation = self.workspace.rotation = self._rotation()
        shift = self.rotation.cursor(0.0, 0.0) if self.rotation else (0.0, 0.0)
        self.farthest = sum(self.body.segment_lengths) + math.hypot(*shift)
        self.may_exceed_reach = self.farthest > sum(self.told.segment_lengths)

    def disturb(self, readings: Readings, randoms: Sequence[np.random.Generator]) -> Readings:
        """Return the readings of n arms under the noises.

        Args:
            readings: of the arms, (n, …).
            randoms: the generator of each of the n arms.
        """
        for noise, draws in zip(self.noises, self.noise_draws, strict=True):
            normals = np.stack([random.standard_normal(draws) for random in randoms])
            readings = noise.disturb(readings, normals)
        return readings

    def observe(self, readings: Readings) -> NDArray[np.float32]:
        """Return the observations of `MMCReach-v0` for readings, (..., 3 N + 4)."""
        return self.layout.encode(
            readings.joint_angles,
            relative_speeds(readings.joint_velocities, self.told.speed_limit),
            hand=readings.hand,
            target=readings.target,
            clip=self.may_exceed_reach or bool(self.noises),
        )

    def observe_goals(self, readings: Readings) -> dict[str, NDArray[Any]]:
        """Return the observations of `MMCReachGoal-v0` for readings."""
        return self.layout.encode_goals(
            readings.joint_angles,
            relative_speeds(readings.joint_velocities, self.told.speed_limit),
            hand=readings.hand,
            target=readings.target,
        )

    def _rotation(self) -> VisuomotorRotation | None:
        """Return the rotation, if there is one, about the point that it is meant to turn about."""
        rotations = [one for one in self.perturbations if isinstance(one, VisuomotorRotation)]
        if len(rotations) > 1:
            raise UserError(f"perturbations must have at most one rotation, got {rotations}")
        if not rotations or rotations[0].centre is not None:
            return rotations[0] if rotations else None
        x, y = self.task.start or (0.0, 0.0)
        reach = self.workspace.outer
        return replace(rotations[0], centre=(x * reach, y * reach))

    @property
    def max_joint_delta(self) -> float:
        """How far an action of 1 puts the joint target ahead under `joint_delta`, radians."""
        return max_joint_delta(speed_limit=self.told.speed_limit, servo_gain=self.told.servo_gain)

    def draw_trial(self, random: np.random.Generator, options: Options) -> Trial:
        """A trial of the task, with what the options decide.

        A target given as an option stands still.  Everything is drawn in any case, so that an
        option given for the one does not change the other.
        """
        posture, target, number = options
        trial = self.task.draw(Request(self.workspace, random, number, posture))
        return trial if target is None else Trial(trial.joint_angles, [target])

    def check_options(self, options: dict[str, Any] | None) -> Options:
        """Posture, target and number of the trial that the options of a reset ask for, or None.

        Raises:
            ValueError: for an unknown option, or one of wrong shape, not finite, outside the
                joint limits, out of reach, or in an obstacle.
        """
        options = options or {}
        unknown = set(options) - {"joint_angles", "target", "trial"}
        if unknown:
            names = sorted(map(str, unknown))
            raise ValueError(f"options must be 'joint_angles', 'target' or 'trial', got {names}")
        posture, target, trial = (options.get(key) for key in ("joint_angles", "target", "trial"))
        return (
            None if posture is None else self._check_posture(posture),
            None if target is None else self.check_target("options['target']", target),
            None if trial is None else self._check_trial(trial),
        )

    def _check_posture(self, posture: ArrayLike) -> list[float]:
        angles = finite("options['joint_angles']", posture, self.joint_count)
        posture = [math.remainder(angle, math.tau) for angle in angles]
        for angle, (low, high) in zip(posture, self.body.joint_limits or (), strict=False):
            if not low <= angle <= high:
                raise ValueError(
                    f"options['joint_angles'] must lie within the joint limits "
                    f"{self.body.joint_limits}, got {posture}"
                )
        if not self.workspace.is_clear(posture):
            raise ValueError(
                f"options['joint_angles'] must keep the arm clear of the obstacles "
                f"{self.body.obstacles}, got {posture}"
            )
        return posture

    def check_target(self, name: str, target: ArrayLike) -> Point:
        """The target as a point, if it can be reached.

        Raises:
            ValueError: if it is of wrong shape, not finite, out of reach, or in an obstacle.
        """
        x, y = finite(name, target, 2)
        if not self.workspace.contains((x, y)):
            inner, outer = self.workspace.inner, self.workspace.outer
            clear = " and clear of the obstacles" if self.body.obstacles else ""
            raise ValueError(
                f"{name} must lie between {inner:g} and {outer:g} from the base{clear}, "
                f"got {(x, y)}"
            )
        return x, y

    def _check_trial(self, trial: Any) -> int:
        count = self.task.trial_count
        if count is None:
            raise ValueError(
                f"options['trial'] must not be given: {self.task} has no numbered trials"
            )
        whole = isinstance(trial, (int, np.integer)) and not isinstance(trial, bool)
        if not whole or not 0 <= trial < count:
            raise ValueError(f"options['trial'] must be from 0 to {count - 1}, got {trial!r}")
        return int(trial)


class HasSetup:
    """What an environment tells of its setup; agents and measures read it."""

    setup: ReachSetup
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's specification, if `gym.make` made the environment.

        Setting it raises a `UserError` if the task was given by name and takes another time than
        an episode of the id: Gymnasium goes by the id alone.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        registered = gym.registry.get(spec.id) if spec else None
        if registered is not None:
            self._check_length(registered)
        self._spec = spec

    def _check_length(self, registered: EnvSpec) -> None:
        name, steps = self.setup.task_name, self.setup.task.episode_steps
        if name is None or name == registered.kwargs.get("task", "random"):
            return
        if registered.max_episode_steps not in (None, steps):
            raise UserError(
                f"task must be one with episodes of {registered.max_episode_steps} steps, as "
                f"{registered.id} has, got {name!r} with {steps}: make {environment_id(name)!r}, "
                "which accepts all other arguments"
            )

    @property
    def parameters(self) -> ArmParameters:
        """The arm as agents are told it."""
        return self.setup.told

    @property
    def control(self) -> Control:
        """What actions mean."""
        return self.setup.control

    @property
    def reward_type(self) -> RewardType:
        """The kind of reward."""
        return self.setup.reward_type

    @property
    def control_weight(self) -> float:
        """Weight of the control cost."""
        return self.setup.control_weight

    @property
    def success_distance(self) -> float:
        """Distance within which the target counts as reached, segment lengths."""
        return self.setup.success_distance

    @property
    def reach(self) -> float:
        """Sum of the told segment lengths."""
        return self.setup.reach

    @property
    def max_joint_delta(self) -> float:
        """How far an action of 1 puts the joint target ahead under `joint_delta`, radians."""
        return self.setup.max_joint_delta


Options = tuple[list[float] | None, Point | None, int | None]


def require_one_of(name: str, value: object, accepted: Sequence[object]) -> None:
    """Raise a `ValueError` that names the argument unless `value` is one of `accepted`."""
    if value not in accepted:
        raise ValueError(f"{name} must be one of {tuple(accepted)}, got {value!r}")


def _require_at_least_zero(name: str, value: float) -> None:
    if not 0 <= value < math.inf:
        raise ValueError(f"{name} must be finite and not negative, got {value!r}")


def finite(name: str, value: ArrayLike, count: int) -> list[float]:
    """The value as `count` numbers, or a `ValueError` that names the argument."""
    message = f"{name} must be {count} finite numbers, got {value!r}"
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:  # not numbers, or of uneven lengths
        raise ValueError(message) from error
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(message)
    values: list[float] = array.tolist()
    return values
