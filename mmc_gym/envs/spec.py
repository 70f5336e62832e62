"""The setup of a reaching environment: everything that is derived from its arguments.

The single and the vector environment both use it.  It does not change while they run.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy, deepcopy
from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import ArrayLike, NDArray

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
from mmc_gym.body import ArmParameters, make_arm
from mmc_gym.body.parameters import ArmColumns
from mmc_gym.envs.arguments import ReachArguments
from mmc_gym.envs.drawn import Draws, senses_of
from mmc_gym.envs.names import Change, as_change, as_plain, as_task, environment_id
from mmc_gym.envs.perturbations import (
    Channel,
    Cursor,
    Cursors,
    Delay,
    Feedback,
    LockedJoint,
    Noise,
    Perturbation,
    SensoryDelay,
    Timed,
    VisionDelay,
    timed_parts,
)
from mmc_gym.envs.tasks import RandomTarget, Request, Trial
from mmc_gym.envs.workspace import (
    REACH_TOLERANCE,
    NoTarget,
    Point,
    Workspace,
    rings,
    shared_ring,
    uniform_numbers,
)
from mmc_gym.interface import ObservationLayout, Seen, action_meaning, relative_speeds

_MOST_TRIALS = 300
_AT_LAST = 10**9  # control steps, after which nothing grows any more
_TRIED = 10  # trials drawn of a user's own task when the environment is made


class Options(NamedTuple):
    """The options of a reset, checked; None for an option that was not given."""

    joint_angles: list[float] | None = None
    target: Point | None = None
    trial: int | None = None
    #: drawn numbers of all n arms, (n, m); NaN where they are not given
    context: NDArray[np.float64] | None = None

    @property
    def has_trial(self) -> bool:
        """Whether any option changes the trial."""
        return self[:3] != (None, None, None)


class RewardSettings(NamedTuple):
    """The numbers that the reward depends on."""

    control_weight: float
    precision_weight: float
    smoothness_weight: float
    is_sparse: bool


class Disturbance(NamedTuple):
    """The disturbance of the senses at one time; numbers may be arrays (n,) for n arms."""

    cursor: Cursor | None  #: stands for the hand
    noises: list[Noise]  #: noise of the senses
    delay: Any  #: of all senses, control steps
    vision_delay: Any  #: of sight, besides `delay`, control steps
    feedback: list[Feedback]  #: say when the hand is seen


class Episodes(NamedTuple):
    """The drawn episodes of k arms; numbers may be arrays (k,)."""

    body: ArmColumns | None  #: the arms; None if no body is drawn
    ring: tuple[Any, Any]  #: smallest and largest distance of targets from the base
    parts: list[Perturbation]  #: those that disturb the senses, as in `ReachSetup`
    cursor: Cursor | None  #: at full strength
    lock_steps: Any  #: control steps after which joints lock; -1: never
    locked: NDArray[np.bool_] | None  #: joints that are locked from the start, (k, N), if any


class State(NamedTuple):
    """Arrays of n arms: a compiled step reads them, and overwrites `speeds` and `observation`."""

    hands: NDArray[np.float64]  #: positions of the hands, or of their cursors, (n, 2)
    targets: NDArray[np.float64]  #: (n, 2)
    may_succeed: NDArray[np.bool_]  #: whether the target is the last one, (n,)
    speeds: NDArray[np.float64]  #: of joints, fractions of the limit, a step earlier, (n, N)
    observation: Any  #: without noise; that of a goal environment is a mapping


class ReachSetup:
    """The setup that is derived from the arguments of a reaching environment."""

    observation_space: spaces.Space[Any]
    perturbations: tuple[Perturbation, ...]
    body: ArmParameters  #: the simulated arm, with all perturbations
    given_body: ArmParameters  #: the arm with those perturbations that are `known`
    parts: list[Perturbation]  #: those that disturb the senses; cursors have centres
    delay: int  #: of all senses, control steps, at full strength
    vision_delay: int  #: of sight, besides `delay`, control steps, at full strength
    workspace: Workspace  #: where hand and target can be
    is_sight_disturbed: bool  #: by noise, a delay of vision, or a hand that is hidden
    farthest: float  #: distance from the base that the hand, or its cursor, never exceeds

    def __init__(self, arguments: ReachArguments, context_limits: Any = 1.0) -> None:
        """Derive the setup; raise a `UserError` if the arguments do not fit together.

        The observed context is bounded by `context_limits`, or by more if the draws go beyond.
        """
        self.control, self.engine = arguments.control, arguments.engine
        self.success_distance = arguments.success_distance
        self.terminates = arguments.terminate_on_success  #: whether success ends an episode
        self.arms_differ = False  #: whether bodies are drawn
        self.others: list[ArmParameters] = []  #: bodies that may be drawn
        self.reward = RewardSettings(
            arguments.control_weight,
            arguments.precision_weight,
            arguments.smoothness_weight,
            is_sparse=arguments.reward_type == "sparse",
        )
        self.task = as_task(arguments.task)
        #: the name by which the task was given, or None
        self.task_name = arguments.task if isinstance(arguments.task, str) else None
        changes = _changes(arguments.perturbations)
        #: what is drawn for each episode, or None
        self.draws = Draws(changes) if any(one.is_drawn for one in changes) else None
        self._changes, shown = changes, arguments.observe_context
        #: the draws on whose scale the context is observed, or None
        self.scale = self.draws if shown is True else Draws(_changes(shown)) if shown else None
        if self.scale is not None:
            accepted = "True, or perturbations from ranges with a width, such as 'rotation--60..60'"
            ranges = arguments.perturbations if shown is True else shown
            has_width = all(one.low < one.high for one in self.scale.strengths)
            require(bool(self.scale.strengths) and has_width, "observe_context", ranges, accepted)
        task = [] if arguments.task == "random" else [self.task_name or type(self.task).__name__]
        #: task and perturbations, for a picture; empty without any
        self.caption = ", ".join([*task, *(one.name for one in changes)])
        self.unperturbed = arguments.arm  #: the arm of the arguments
        self.control_step = self.unperturbed.control_step  #: its duration, s
        if self.draws is None:
            self._perturb(changes)
        else:
            self._perturb([*map(Change, self.draws.perturbations(self.draws.samples()[0]))])
        self._check_loads(changes)
        channels = [one.curl for one in self.perturbations if isinstance(one, Channel)]
        self.channel = sum(channels) if channels else None  #: curl of its ideal force, or None
        if channels:
            accepted = "without a channel if any of them is drawn"
            require(self.draws is None, "perturbations", self.perturbations, accepted)
            make_arm(self.engine, self.body).confine((0.0, 0.0), (1.0, 0.0))
        self.action = action_meaning(self.control, self.given_body)  #: what actions mean
        lengths = self.given_body.segment_lengths
        self.joint_count, self.reach = len(lengths), sum(lengths)
        rows = np.zeros((1, 0)) if self.draws is None else self.draws.samples()
        #: largest absolute value, at least 1, of each number of the observed context
        self.context_limits: Any = np.float32(np.inf)
        largest = np.abs(self.context_of(rows)).max(axis=0)
        self.context_limits = np.maximum(largest, np.float32(context_limits))
        #: order of the observed numbers; its `reach` is the sum of the given lengths
        self.layout = ObservationLayout(
            self.joint_count,
            self.reach,
            self._may_exceed_limits,
            context_size=len(self.context_limits),
        )
        self.plain_space: spaces.Space[Any] = self.layout.space()  #: without the context
        self.observation_space = self.layout.space(self.context_limits)
        self.action_space = spaces.Box(-1.0, 1.0, (self.joint_count,), np.float32)
        #: pictures a second, one each control step
        self.frame_rate = round(1 / self.given_body.control_step)
        self.task.check(self.workspace)
        self.steps_lock = self.lock_steps > 0  #: whether joints may lock within an episode
        #: whether many trials can be drawn at once
        self.draws_pairs = type(self.task) is RandomTarget and self.workspace.is_ring
        self._is_own_task = not type(self.task).__module__.startswith("mmc_gym.")
        self.path_length = 0  #: number of places on the path of the target
        for seed in range(_TRIED if self._is_own_task else 1):  # find errors now
            self.path_length = len(self.draw_trial(np.random.default_rng(seed), Options()).targets)
        if self.draws is not None:
            self._try_draws(self.draws)

    @property
    def _may_exceed_limits(self) -> bool:
        """Whether noise, a longer arm or a cursor may take observed values beyond the limits."""
        return bool(self.noises) or self.farthest > self.reach

    def _perturb(self, changes: Sequence[Change], is_checked: bool = True) -> None:
        self.perturbations = tuple(one.perturbation for one in changes)
        self._change_arm(changes, is_checked)
        timed = [one for one in self.perturbations if isinstance(one, Timed)]
        plain = Perturbation.change_body
        #: timed perturbations that change the arm within an episode
        self.loads = [one for one in timed if type(one.perturbation).change_body is not plain]
        self._disturb_senses(changes, timed)
        locked = self.body.lockable_joints if self.lock_step == 0 else ()
        at_all_times = self.disturbance(self.moments).cursor if self.is_timed else None
        self.workspace = Workspace(self.body, self.given_body, locked, self.cursor, at_all_times)
        reach = sum(self.body.segment_lengths)
        self.farthest = self.cursor.farthest(reach) if self.cursor else reach

    def episode(self, numbers: NDArray[np.float64], is_checked: bool = False) -> ReachSetup:
        """Return the setup of an episode that drew `numbers`, (m,); check the arm if asked."""
        assert self.draws is not None
        one = copy(self)
        one._perturb([*map(Change, self.draws.perturbations(numbers))], is_checked)
        return one

    def context_of(self, numbers: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the context, (k, c), that k arms observe if they have drawn `numbers`, (k, m)."""
        if self.scale is None:
            return np.zeros((len(numbers), 0), np.float32)
        if self.draws is None:
            shown = np.tile(self.scale.shown_of(self._changes), (len(numbers), 1))
        elif self.scale.is_like(self.draws):
            shown = self.scale.shown(numbers)
        else:
            drawn = [map(Change, self.draws.perturbations(row)) for row in numbers]
            shown = np.stack([self.scale.shown_of([*one]) for one in drawn])
        return np.clip(shown, -self.context_limits, self.context_limits)

    def _try_draws(self, draws: Draws) -> None:
        """Set limits that hold for all draws; raise a `UserError` if a draw is impossible."""
        samples = draws.samples()
        every = []
        for numbers in samples:
            try:
                every.append(self._possible_episode(numbers))
            except UserError as error:
                drawn = ", ".join(f"{k}={v:g}" for k, v in draws.context(numbers).items())
                raise UserError(
                    f"perturbations must be possible whatever is drawn, got {drawn}: {error}"
                ) from error
        bodies = [one.body for one in every]
        same = {(one.joint_limits is None, one.control_step) for one in bodies}
        require(len(same) == 1, "perturbations", bodies[0], "with joint limits always or never")
        self.arms_differ = draws.changes_body or any(body != bodies[0] for body in bodies)
        accepted = "without a drawn body if a load or force field begins within an episode"
        require(not (self.loads and self.arms_differ), "perturbations", self.loads, accepted)
        self.others = bodies if self.arms_differ else self.others
        self.steps_lock = any(one.lock_steps > 0 for one in every)
        self.farthest = max(one.farthest for one in every)
        self.make_room(every)
        self.layout = replace(self.layout, is_clipped=True)  # a given context may be beyond ranges
        are_many = ~draws.are_alone(samples)
        every = [one for one, is_many in zip(every, are_many.tolist(), strict=True) if is_many]
        samples = samples[are_many]
        are_rings = all(one.workspace.is_ring for one in every)
        self.draws_pairs = type(self.task) is RandomTarget and are_rings and bool(every)
        if self.draws_pairs:  # all arms at once, if arrays give the same as single numbers
            try:
                many = self.episodes(samples)
                rows = ArmColumns.of(many.body or self.body).rows(len(every))
                locks_at = np.broadcast_to(many.lock_steps, len(every)).tolist()
                alike = [
                    (ArmColumns.of(one.body), one.lock_steps) == (row, locks)
                    for one, row, locks in zip(every, rows, locks_at, strict=True)
                ]
                self.draws_pairs = all(alike) or (not many.body and not self.arms_differ)
            except (TypeError, ValueError, UserError):
                self.draws_pairs = False

    def make_room(self, episodes: Iterable[ReachSetup]) -> None:
        """Make room for the delays of these episodes."""
        for one in episodes:
            self.delay = max(self.delay, one.delay)
            self.vision_delay = max(self.vision_delay, one.vision_delay)
        self.are_senses_disturbed = bool(self.noises or self.delay)
        self.is_sight_disturbed = self.is_sight_disturbed or bool(self.vision_delay)

    def _possible_episode(self, numbers: NDArray[np.float64]) -> ReachSetup:
        """Return the setup of an episode; raise a `UserError` if it cannot be played."""
        one = self.episode(numbers, is_checked=True)
        one.task.check(one.workspace)
        one.draw_trial(np.random.default_rng(0), Options())
        if one.body != self.body:
            make_arm(self.engine, one.body, self.action.servo)
        return one

    def drawn(
        self, randoms: Sequence[np.random.Generator], context: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Return the numbers, (k, m), that k generators draw, with those of a context in place."""
        assert self.draws is not None
        numbers = self.draws.numbers(uniform_numbers(randoms, len(self.draws.strengths)))
        return numbers if context is None else np.where(np.isnan(context), numbers, context)

    def episodes_beyond(
        self, context: NDArray[np.float64], randoms: Sequence[np.random.Generator]
    ) -> dict[int, ReachSetup]:
        """Return the episodes, by row of the context, that are beyond what may be drawn.

        The generators stay as they are.  If there are several, an error names the row as the arm.
        """
        if self.draws is None:
            return {}
        low, high, whole = np.transpose([(s.low, s.high, s.whole) for s in self.draws.strengths])
        is_beyond = (context < low) | (context > high)
        is_beyond |= (context > np.floor(context)) & (whole > 0)
        episodes = {}
        for row in np.flatnonzero(is_beyond.any(axis=1)).tolist():
            numbers = self.drawn([deepcopy(randoms[row])], context[[row]])[0]
            try:
                for one, number in zip(self.draws.strengths, context[row].tolist(), strict=True):
                    accepted = f"a whole number from {one.low:g} to {one.high:g}"
                    is_listed = one.low <= number <= one.high and number.is_integer()
                    fine = not one.whole or is_listed or math.isnan(number)
                    require(fine, one.name, number, accepted)
                episodes[row] = episode = self._possible_episode(numbers)
                accepted = f"at most {self.farthest:g}, as the observation space has it"
                is_inside = self.layout.is_clipped or episode.farthest <= self.farthest
                require(is_inside, "the reach", episode.farthest, accepted)
            except UserError as error:
                whose = f" for arm {row}" if len(randoms) > 1 else ""
                drawn = self.draws.context(numbers)
                raise UserError(
                    f"options['context'] must be possible, got {drawn}{whose}: {error}"
                ) from error
        return episodes

    def episodes(self, numbers: NDArray[np.float64]) -> Episodes:
        """Return the episodes of k arms that have drawn `numbers`, (k, m)."""
        body: ArmColumns | None = None
        ring, senses, cursor = self.ring, self.parts, self.cursor
        lock_steps: Any = self.lock_steps
        if self.draws is not None:
            parts, lock_steps = self.draws.perturbations(numbers), -1
            senses = [self._placed(one) for one in senses_of(parts)]
            cursor = self.disturbance(_AT_LAST, senses).cursor
            if self.arms_differ:
                body = self._drawn_body(parts)
                ring = rings(body.segment_lengths, self.given_body.segment_lengths)
            for one in parts:
                if isinstance(one, LockedJoint):
                    steps = self._in_steps(one.time)
                    lock_steps = np.maximum(lock_steps, np.where(one.shown, steps, -1))
        locked = ArmColumns.of(body or self.body).lockable(len(numbers))
        locked &= np.reshape(lock_steps == 0, (-1, 1))
        return Episodes(body, ring, senses, cursor, lock_steps, locked if locked.any() else None)

    def _disturb_senses(self, changes: Sequence[Change], timed: Sequence[Timed]) -> None:
        """Set what disturbs the senses once all perturbations have their full strength."""
        self.parts = [self._placed(one) for one in senses_of(self.perturbations)]
        step = self.control_step
        self.is_timed = bool(timed)  #: whether perturbations begin or grow within an episode
        #: sorted control steps between which no timed perturbation changes much
        self.moments: Any = np.unique([n for one in timed for n in one.moments(step)] or [0])
        self.full = self.disturbance(int(self.moments[-1]))  #: at full strength
        self.cursor, self.noises = self.full.cursor, self.full.noises
        self.delay, self.vision_delay = self.full.delay, self.full.vision_delay
        self.are_senses_disturbed = bool(self.noises or self.delay)
        self.is_sight_disturbed = bool(self.noises or self.vision_delay or self.full.feedback)
        for kind, total in ((SensoryDelay, self.delay), (VisionDelay, self.vision_delay)):
            late = [one for one in changes if isinstance(one.untimed, kind) and one.untimed.seconds]
            if late and not total and self.draws is None:
                name = late[0].family.name if late[0].family else "delay"
                raise UserError(
                    f"{late[0].name} would delay nothing: delays are whole control steps of "
                    f"{1000 * step:g} ms, such as {name}-{1000 * step:g} or {name}-{2000 * step:g}"
                )

    def _check_loads(self, changes: Sequence[Change]) -> None:
        """Raise a `UserError` if more than hand mass and force field change within an episode."""
        every = [one.moments(self.control_step) for one in self.loads]
        # Between these control steps loads and fields change evenly: they are largest at the ends.
        corners = {moments[place] for moments in every for place in (0, 1, -1)}
        for body in map(self.body_after, sorted(corners)):
            same = replace(body, hand_mass=self.body.hand_mass, force_field=self.body.force_field)
            accepted = "of which only force-field and hand-mass change the body within an episode"
            is_fine = same == ArmColumns.of(self.body)
            require(is_fine, "perturbations", [one.name for one in changes], accepted)
            self.others.append(ArmParameters(**vars(body)))
            make_arm(self.engine, self.others[-1])

    def body_after(self, steps: Any) -> ArmColumns:
        """Return the arm after `steps` control steps, or n arms if `steps` is (n,)."""
        body = ArmColumns.of(self.unperturbed)
        for one in timed_parts(self.perturbations, steps, self.control_step):
            body = one.change_body(body)  # type: ignore[assignment]
        return body

    def is_loaded_after(self, steps: Any) -> Any:
        """Return whether a load or field changed in the last of `steps` control steps, (...)."""
        step = self.control_step
        changed = [one.share(steps, step) != one.share(steps - 1, step) for one in self.loads]
        return np.any(changed, axis=0)

    def disturbance(self, steps: Any, of: Sequence[Perturbation] | None = None) -> Disturbance:
        """Return the disturbance of the senses after `steps` control steps, a number or (n,).

        `of` are the perturbations that cause it, by default those of the setup.
        """
        parts = timed_parts(self.parts if of is None else of, steps, self.control_step)

        def delay(kind: type[Delay]) -> Any:
            seconds = sum(one.seconds for one in parts if isinstance(one, kind))
            late = self._in_steps(seconds)
            return late if late.ndim else int(late)

        noises = [one for one in parts if isinstance(one, Noise)]
        cursors = [one for one in parts if isinstance(one, Cursor)]
        cursor = Cursors(tuple(cursors)) if len(cursors) > 1 else next(iter(cursors), None)
        feedback = [one for one in parts if isinstance(one, Feedback)]
        return Disturbance(cursor, noises, delay(SensoryDelay), delay(VisionDelay), feedback)

    def _placed(self, one: Perturbation) -> Perturbation:
        """Return the perturbation; a cursor without a centre gets the task's start, or the base."""
        if isinstance(one, Timed):
            return replace(one, perturbation=self._placed(one.perturbation))
        if not isinstance(one, Cursor) or one.centre is not None:
            return one
        (x, y), (_, outer) = self.task.start or (0.0, 0.0), shared_ring(self.body, self.given_body)
        placed = copy(one)  # not `replace`, which forgets whether it is shown
        vars(placed)["centre"] = x * outer, y * outer
        return placed

    def _in_steps(self, seconds: Any) -> Any:
        """Return a time, or an array of times, in s as the nearest whole control steps."""
        return np.rint(np.divide(seconds, self.control_step)).astype(int)

    def _drawn_body(self, parts: Sequence[Perturbation]) -> ArmColumns:
        """Return the arm under drawn perturbations, without the checks that draws have passed."""
        arm: ArmParameters = ArmColumns.of(self.unperturbed)
        for one in parts:
            arm = one.change_body(arm)
        return ArmColumns.of(arm)

    def _change_arm(self, changes: Sequence[Change], is_checked: bool) -> None:
        """Apply the perturbations to the arm, and set when joints lock."""
        if is_checked:
            self.body = self.given_body = self.unperturbed
            for one in changes:
                self.body = _changed(one, self.body)
                if one.known:
                    self.given_body = _changed(one, self.given_body)
        else:
            self.body = self._drawn_body(self.perturbations)
        locks = [one for one in self.perturbations if isinstance(one, LockedJoint)]
        times = {one.time for one in locks if one.shown}
        if len(times) > 1:
            raise UserError(f"locked joints must lock at one time, got the times {sorted(times)}")
        #: control steps after which joints lock, or None
        self.lock_step = int(self._in_steps(times.pop())) if times else None

    @property
    def ring(self) -> tuple[Any, Any]:
        """Smallest and largest distance of targets from the base, segment lengths."""
        return self.workspace.inner, self.workspace.outer

    @property
    def lock_steps(self) -> int:
        """Control steps after which joints lock; -1 if none does."""
        return -1 if self.lock_step is None else self.lock_step

    def observe(
        self,
        seen: Seen,
        noises: Sequence[Noise],
        randoms: Sequence[np.random.Generator],
        look: Callable[[Any], NDArray[np.float64]] | None = None,
    ) -> NDArray[np.float32]:
        """Return observations of n arms, (n, …), with noise from the generator of each.

        If hands are hidden at times, `look` maps their positions, (n, 2), to those last seen.
        """
        for noise in noises:
            chosen = np.broadcast_to(noise.is_heard, len(randoms))

            def draw(count: int, chosen: NDArray[np.bool_] = chosen) -> NDArray[np.float64]:
                numbers = np.zeros((len(randoms), count))
                for arm in np.flatnonzero(chosen).tolist():
                    randoms[arm].standard_normal(out=numbers[arm])
                return numbers

            seen = noise.disturb(seen, draw)
            name = f"what {type(noise).__name__}.disturb returns"
            require(isinstance(seen, Seen), name, seen, "a changed Seen")
        if look is not None:
            seen = replace(seen, hand=look(seen.hand))
        speeds = relative_speeds(seen.joint_speeds, self.given_body.speed_limit)
        observation: NDArray[np.float32] = self.layout.encode(
            seen.joint_angles, speeds, hand=seen.hand, target=seen.target
        )
        return observation

    def draw_trial(self, random: np.random.Generator, options: Options) -> Trial:
        """Return a trial of the task with the options filled in.

        A given target does not move.  Posture and target are always drawn, so that giving one does
        not change the other.  If drawing fails, the trial of a fixed seed is returned.
        """
        try:
            trial = self._draw(random, options)
        except UserError:  # bad luck: the fixed seed worked when the setup was made
            trial = self._draw(np.random.default_rng(0), options)
        if self._is_own_task:
            trial = self._checked(trial)
        accepted = f"one whose paths have {self.path_length} places, as in its first trial"
        fine = len(trial.targets) == self.path_length or not self.path_length
        require(fine, "task", self.task, accepted)
        if options.target is None:
            return trial
        return Trial(options.joint_angles or trial.joint_angles, [options.target])

    def _draw(self, random: np.random.Generator, options: Options) -> Trial:
        """Return a trial of the task; draw again if a posture has no target in reach."""
        posture = options.joint_angles if options.target is None else None
        request = Request(self.workspace, random, options.trial, posture)
        for _ in range(_MOST_TRIALS):
            try:
                return self.task.draw(request)
            except NoTarget as error:
                reason = error
        raise reason

    def _checked(self, trial: Any) -> Trial:
        name, workspace = f"{type(self.task).__name__}.draw", self.workspace
        accepted = "a Trial(joint_angles, targets)"
        require(isinstance(trial, Trial), f"what {name} returns", trial, accepted)
        posture = require_finite_numbers(f"joint_angles of {name}", trial[0], self.joint_count)

        def is_reachable(point: tuple[float, ...]) -> bool:
            slack = REACH_TOLERANCE * workspace.outer
            return is_point(point) and math.dist(point, workspace.nearest(point)) <= slack

        ring = f"{workspace.inner:g} to {workspace.outer:g} from the base"
        accepted = f"a path, one or more points (x, y) that are {ring}"
        counts = range(1, sys.maxsize)
        path = require_rows(f"targets of {name}", trial[1], accepted, is_reachable, counts)
        return Trial(posture, [(x, y) for x, y in path])

    def check_options(self, options: dict[str, Any] | None, count: int | None = None) -> Options:
        """Return the options of a reset, checked; raise a `UserError` if one cannot be accepted.

        Options must be known and respect joint limits, reach and obstacles, and locked joints must
        leave a target in reach.  `count` is that of the arms of a vector.
        """
        options = {} if options is None else options
        accepted = "a mapping with 'joint_angles', 'target', 'trial' or 'context'"
        require(isinstance(options, Mapping), "options", options, accepted)
        for name in options:
            require_choice("options", name, Options._fields)
        posture, target, trial, context = map(options.get, Options._fields)
        checked = Options(
            None if posture is None else self._check_posture(posture),
            None if target is None else self.check_target("options['target']", target),
            None if trial is None else self._check_trial(trial),
            None if context is None else self._check_context(context, count),
        )
        if self.workspace.locked and posture is not None:
            try:
                self._draw(np.random.default_rng(0), checked)
            except NoTarget as error:
                name, accepted = "options['joint_angles']", "a posture with a target in reach"
                raise UserError(f"{name} must be {accepted}, got {checked.joint_angles}") from error
        return checked

    def _check_context(self, context: Any, count: int | None) -> NDArray[np.float64]:
        """Return the numbers of a context as in `Options`."""
        names = [one.name for one in self.draws.strengths] if self.draws else []
        name = "options['context']"
        require(isinstance(context, Mapping), name, context, "a mapping of numbers by name")
        numbers = np.full((count or 1, len(names)), np.nan)
        accepted = "a number" if count is None else f"a number, or {count} of them"
        for key, value in context.items():
            if str(key).startswith("_"):  # the masks of Gymnasium's vector infos
                continue
            require_choice(name, key, names)
            array = require_array(f"{name}[{key!r}]", value, accepted)
            fine = array.shape == () or array.shape == (count,)
            require(fine, f"{name}[{key!r}]", value, accepted)
            numbers[:, names.index(key)] = array
        return numbers

    def _check_posture(self, posture: ArrayLike) -> list[float]:
        name, body = "options['joint_angles']", self.body
        given = require_finite_numbers(name, posture, self.joint_count)
        angles = [math.remainder(angle, math.tau) for angle in given]
        for angle, (low, high) in zip(angles, body.joint_limits or (), strict=False):
            accepted = f"within the joint limits {body.joint_limits}"
            require(low <= angle <= high, name, angles, accepted)
        accepted = f"a posture in which the arm is clear of the obstacles {body.obstacles}"
        require(self.workspace.is_clear(angles), name, angles, accepted)
        return angles

    def check_target(self, name: str, target: ArrayLike) -> Point:
        """Return the target (x, y); raise a `UserError` unless it can be reached."""
        x, y = require_numbers(name, target, "2 finite numbers", is_point)
        clear = " and clear of the obstacles" if self.body.obstacles else ""
        accepted = f"between {self.workspace.inner:g} and {self.workspace.outer:g} from the base"
        require(self.workspace.contains((x, y)), name, (x, y), accepted + clear)
        return x, y

    def _check_trial(self, trial: Any) -> int:
        count = self.task.trial_count or 0
        accepted = f"a whole number from 0 to {count - 1}"
        if not count:
            accepted = f"left out, as {self.task} has no numbered trials"
        require(is_whole(trial) and 0 <= trial < count, "options['trial']", trial, accepted)
        return int(trial)


def _changes(perturbations: Any) -> list[Change]:
    """Return one perturbation, or several, as a list of changes."""
    if isinstance(perturbations, str | Mapping) or not isinstance(perturbations, Sequence):
        perturbations = (perturbations,)
    return [as_change(one) for one in perturbations]


def _changed(change: Change, body: ArmParameters) -> ArmParameters:
    """Return the arm under a perturbation; an error message names the perturbation."""
    try:
        changed = change.perturbation.change_body(body)
    except UserError as error:
        raise UserError(f"{change.name} is not possible for this arm: {error}") from error
    name = f"what {change.name}.change_body returns"
    accepted = "the changed ArmParameters, as from dataclasses.replace(body, ...)"
    require(isinstance(changed, ArmParameters), name, changed, accepted)
    return changed


class GoalSetup(ReachSetup):
    """The setup that is derived from the arguments of a goal environment."""

    def _perturb(self, changes: Sequence[Change], is_checked: bool = True) -> None:
        super()._perturb(changes, is_checked)
        if self.is_sight_disturbed or self.delay or self.task.advance == "reach":
            raise UserError(
                "a goal environment must have a reward that is a function of the observed goals: "
                f"no noise, no delay and no via points, got task={self.task}, "
                f"perturbations={self.perturbations}"
            )

    def __init__(self, arguments: ReachArguments, context_limits: Any = 1.0) -> None:
        super().__init__(arguments, context_limits)
        self.layout = replace(self.layout, is_clipped=False, has_goals=True)
        # Rounding may put a goal beyond the reach, by as much as is accepted of a target.
        farthest = self.farthest * (1 + REACH_TOLERANCE)
        self.plain_space = self.layout.goal_space(farthest)
        self.observation_space = self.layout.goal_space(farthest, self.context_limits)


class ReachEnvironment:
    """The common part of the single and the vector environment."""

    setup: ReachSetup
    observation_space: spaces.Space[Any]
    _arguments: Any
    _kind: type[ReachSetup]
    _of_all: ReachSetup  # from the next episode on; `setup` is that of the present one
    _draws: Draws | None  # of the present episode
    _numbers: NDArray[np.float64]  # drawn for the present episode
    _spec: EnvSpec | None = None

    parameters = property(attrgetter("setup.given_body"), doc="The arm that agents are given.")
    unperturbed = property(attrgetter("setup.unperturbed"), doc="The arm without perturbations.")
    engine = property(attrgetter("setup.engine"), doc="The engine that moves the arm.")
    control = property(attrgetter("setup.control"), doc="The control mode.")
    reach = property(attrgetter("setup.reach"), doc="Sum of the given segment lengths.")
    context_size = property(
        attrgetter("setup.layout.context_size"), doc="Number of observed context values."
    )
    success_distance = property(
        attrgetter("setup.success_distance"),
        doc="Largest distance to a reached target, segment lengths.",
    )

    @property
    def perturbations(self) -> Any:
        """The perturbations as they were given; setting them is `set_perturbations`."""
        return self._arguments.perturbations

    @perturbations.setter
    def perturbations(self, perturbations: Any) -> None:
        self.set_perturbations(perturbations)

    def set_perturbations(self, perturbations: Any) -> None:
        """Change the perturbations of later episodes; an observed context keeps its scale.

        What is then observed may be beyond ±1, and the observation space as wide.
        """
        old = self._of_all
        arguments = replace(
            self._arguments, perturbations=perturbations, observe_context=self._shown_scale
        )
        setup = self._kind(arguments, old.context_limits)
        accepted = "others that leave the observation space, but for the context, as it is"
        same = setup.plain_space == old.plain_space and setup.action == old.action
        require(same, "perturbations", perturbations, accepted)
        self._take(setup)
        self._arguments, self._of_all = arguments, setup

    def _take(self, setup: ReachSetup) -> None:
        """Take on the setup of later episodes; raise a `UserError` if that is not possible."""
        self.observation_space = setup.observation_space

    @property
    def _shown_scale(self) -> Any:
        """The perturbations whose ranges scale the observed context; False if it is not."""
        shown = self._arguments.observe_context
        return self._arguments.perturbations if shown is True else shown

    @property
    def context(self) -> dict[str, Any]:
        """The values drawn for the episode, by name: numbers, or arrays (n,) for n arms."""
        return self._draws.context(self._numbers) if self._draws else {}

    @property
    def context_scale(self) -> list[Any]:
        """The perturbations whose ranges scale the observed context, as `as_plain` has them."""
        if not self.context_size:
            return []
        return [as_plain(change) for change in _changes(self._shown_scale)]

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's specification, if `gym.make` made the environment.

        Setting it raises a `UserError` if a task given by name has another number of steps than the
        id: Gymnasium takes the time limit from the id alone.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        registered = gym.registry.get(spec.id) if spec else None
        if registered is not None:
            self._check_length(registered)
        if spec is not None:
            kept = spec.kwargs.keys() & {"task", "perturbations", "observe_context"}
            spec.kwargs = {**spec.kwargs, **{name: as_plain(spec.kwargs[name]) for name in kept}}
            # Gymnasium leaves a vector's spec as it was registered.
            spec.max_episode_steps = getattr(self, "max_episode_steps", spec.max_episode_steps)
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


def require_finite_numbers(name: str, value: ArrayLike, count: int) -> list[float]:
    """Return the value as `count` floats, or raise a `UserError` that names the argument."""

    def are_fine(numbers: tuple[float, ...]) -> bool:
        return len(numbers) == count and all(map(math.isfinite, numbers))

    return list(require_numbers(name, value, f"{count} finite numbers", are_fine))
