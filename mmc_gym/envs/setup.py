"""The setup of a reaching environment: everything that is derived from its arguments.

The single and the vector environment both use it.  It does not change while they run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from mmc_gym._errors import UserError, require
from mmc_gym.body import ArmParameters, make_arm
from mmc_gym.envs.arguments import ReachArguments
from mmc_gym.envs.arms import DELAYS, JOINT_NOISE, VISION_NOISE, Arms, Bools, Floats
from mmc_gym.envs.buffers import Noise
from mmc_gym.envs.cursor import CURSOR, Cursor
from mmc_gym.envs.episodes import Episodes
from mmc_gym.envs.motors import MOTORS, Motors
from mmc_gym.envs.names import as_changes, as_plain, as_task, environment_id
from mmc_gym.envs.reward import RewardSettings
from mmc_gym.envs.senses import SENSES, Senses
from mmc_gym.envs.trials import Options, Trials, check_context, check_names
from mmc_gym.envs.workspace import REACH_TOLERANCE, Workspace
from mmc_gym.geometry import wrap_angle
from mmc_gym.interface import ObservationLayout, Seen, action_meaning, relative_speeds

_TRIED = 10  # trials drawn of a user's own task when the environment is made


class State(NamedTuple):
    """Arrays of n arms: a compiled step reads them, and overwrites `speeds` and `observation`."""

    hands: Floats  #: positions of the hands, or of their cursors, (n, 2)
    targets: Floats  #: (n, 2)
    may_succeed: Bools  #: whether the target is the last one, (n,)
    speeds: Floats  #: of joints, fractions of the limit, a step earlier, (n, N)
    observation: Any  #: without noise; that of a goal environment is a mapping


class Episode(NamedTuple):
    """An episode of one arm."""

    numbers: Floats  #: that were drawn, (m,)
    arms: Arms  #: the arm once its perturbations have their full strength
    body: ArmParameters  #: the simulated arm, with all perturbations
    workspace: Workspace  #: where hand and target can be
    cursor: Cursor | None  #: that stands for the hand then, in numbers
    lock_step: int  #: control steps after which joints lock; -1: never
    unlock_step: int  #: control steps after which they are free again; -1: never

    @property
    def delays(self) -> dict[str, int]:
        """The delays of the columns of `DELAYS`, control steps."""
        return {name: int(self.arms.steps_of(name)[0]) for name in DELAYS}


class Limits(NamedTuple):
    """What holds for all episodes, whatever is drawn."""

    bodies: tuple[ArmParameters, ...]  #: that occur, the first one that of the first sample
    delays: Mapping[str, int]  #: the longest of each column of `DELAYS`, control steps
    farthest: float  #: distance from the base that the hand, or its cursor, never exceeds
    may_lock_in_flight: bool
    have_rings: bool  #: whether hands are drawn between two radii, but for arms with obstacles


class ReachSetup:
    """The setup that is derived from the arguments of a reaching environment."""

    def __init__(self, arguments: ReachArguments, context_limits: Any = 1.0) -> None:
        """Derive the setup; raise a `UserError` if the arguments do not fit together.

        The observed context is bounded by `context_limits`, or by more if the draws go beyond.
        """
        self.control, self.engine = arguments.control, arguments.engine
        self.success_distance = arguments.success_distance
        self.terminates = arguments.terminate_on_success  #: whether success ends an episode
        self.reward = RewardSettings(
            arguments.control_weight,
            arguments.precision_weight,
            arguments.smoothness_weight,
            is_sparse=arguments.reward_type == "sparse",
        )
        self.task = as_task(arguments.task)
        #: the name by which the task was given, or None
        self.task_name = arguments.task if isinstance(arguments.task, str) else None
        self.trials = Trials(self.task)
        changes = as_changes(arguments.perturbations)
        self.unperturbed = arguments.arm  #: the arm of the arguments
        self.control_step = self.unperturbed.control_step  #: its duration, s
        #: what each episode draws, and the arms of all episodes
        self.episodes = Episodes(changes, self.unperturbed, self.task.start)
        task = [] if arguments.task == "random" else [self.task_name or type(self.task).__name__]
        #: task and perturbations, for a picture; empty without any
        self.caption = ", ".join([*task, *(change.name for change in changes)])
        self.given_body = self.episodes.given_body  #: the arm with what is known of it
        self.action = action_meaning(self.control, self.given_body)  #: what actions mean
        lengths = self.given_body.segment_lengths
        self.joint_count, self.reach = len(lengths), sum(lengths)
        #: whether a cursor may stand for the hand
        self.has_cursor = bool(self.episodes.touched & CURSOR)
        self.is_timed = self.episodes.is_timed  #: whether anything changes within an episode
        #: whether the load or the force field does
        self.is_loaded = bool(self.episodes.in_flight & {"hand_mass", "force_field"})
        samples = self.episodes.samples()
        self.limits = self._try(samples)
        self.first = self.episode(samples[0])  #: the episode of the first sample; the only one
        is_drawn = self.episodes.is_drawn  # a given context may be beyond what is drawn
        no_delays = {name for name, steps in self.limits.delays.items() if not (steps or is_drawn)}
        #: the columns of `Arms` that differ between arms, or from those of the plain arm
        self.touched = self.episodes.touched - no_delays
        self.are_motors_disturbed = bool(self.touched & MOTORS)
        self.are_senses_disturbed = bool(self.touched & SENSES)
        self.bodies_differ = self.episodes.draws_body  #: whether bodies are drawn
        self.channel = self._check_channel()  #: curl of its ideal force, or None
        self.frame_rate = round(1 / self.control_step)  #: pictures a second, one each control step
        shown = arguments.observe_context
        #: what draws the numbers on whose scale the context is observed, or None
        self.scale = self.episodes if shown is True else None
        if shown and shown is not True:
            self.scale = Episodes(as_changes(shown), self.unperturbed)
        if self.scale is not None:
            accepted = "True, or perturbations from ranges with a width, such as 'rotation--60..60'"
            ranges = [change.name for change in self.scale.changes]
            has_width = all(each.low < each.high for each in self.scale.strengths)
            require(self.scale.is_drawn and has_width, "observe_context", ranges, accepted)
        #: largest absolute value, at least 1, of each number of the observed context
        largest = np.abs(self._shown(samples)).max(axis=0)
        self.context_limits = np.maximum(largest, np.float32(context_limits))
        may_exceed_limits = is_drawn or self.limits.farthest > self.reach
        may_exceed_limits |= bool(self.touched & (VISION_NOISE | JOINT_NOISE))
        #: order of the observed numbers; its `reach` is the sum of the given lengths
        self.layout = ObservationLayout(
            self.joint_count,
            self.reach,
            may_exceed_limits,
            context_size=len(self.context_limits),
        )
        self.plain_space: spaces.Space[Any] = self.layout.space()  #: without the context
        self.observation_space: spaces.Space[Any] = self.layout.space(self.context_limits)
        self.action_space = spaces.Box(-1.0, 1.0, (self.joint_count,), np.float32)

    def _try(self, samples: Floats) -> Limits:
        """Return the limits of all draws; raise a `UserError` if a sample is impossible."""
        bodies: dict[ArmParameters, None] = {}
        delays, farthest, locks, have_rings = dict.fromkeys(DELAYS, 0), 0.0, False, True
        for numbers in samples:
            try:
                episode = self._possible_episode(numbers, bodies)
            except UserError as error:
                if not self.episodes.is_drawn:
                    raise
                drawn = self.episodes.context(numbers).items()
                text = ", ".join(f"{name}={number:g}" for name, number in drawn)
                raise UserError(
                    f"perturbations must be possible whatever is drawn, got {text}: {error}"
                ) from error
            delays = {name: max(delays[name], steps) for name, steps in episode.delays.items()}
            farthest = max(farthest, self._farthest(numbers))
            locks |= episode.lock_step > 0 or episode.unlock_step > 0
            have_rings &= episode.workspace.is_ring or bool(episode.body.obstacles)
        self._check_delays(delays)
        same = {(body.joint_limits is None, body.control_step) for body in bodies}
        accepted = "with joint limits always or never"
        require(len(same) == 1, "perturbations", next(iter(bodies)), accepted)
        return Limits((*bodies,), delays, farthest, locks, have_rings)

    def _possible_episode(
        self, numbers: Floats, bodies: dict[ArmParameters, None] | None = None
    ) -> Episode:
        """Return an episode; raise a `UserError` if it cannot be played.

        Its bodies are noted in `bodies`, where those are that are known to be possible.
        """
        episode, bodies = self.episode(numbers), {} if bodies is None else bodies
        for body in (episode.body, *(self._loaded(numbers) if self.is_loaded else ())):
            if body not in bodies:
                make_arm(self.engine, body, self.action.servo)
            bodies[body] = None
        self.task.check(episode.workspace)
        for seed in range(_TRIED if self.trials.is_own else 1):
            self.trials.draw(episode.workspace, np.random.default_rng(seed), Options())
        return episode

    def episodes_beyond(
        self, context: Floats, randoms: Sequence[np.random.Generator], before: Floats | None
    ) -> dict[int, Episode]:
        """Return the episodes, by row of the context, that are beyond what may be drawn.

        `before` are the numbers of the episodes before, as `Episodes.numbers` takes them.  The
        generators stay as they are.  If there are several, an error names the row as the arm.
        """
        if not self.episodes.is_drawn:
            return {}
        strengths, episodes = self.episodes.strengths, {}
        low, high, whole = np.transpose([(each.low, each.high, each.whole) for each in strengths])
        is_beyond = (context < low) | (context > high)
        is_beyond |= (context > np.floor(context)) & (whole > 0)
        for row in np.flatnonzero(is_beyond.any(axis=1)).tolist():
            last = None if before is None else before[[row]]
            numbers = self.episodes.drawn([deepcopy(randoms[row])], context[[row]], last)[0]
            try:
                for each, number in zip(strengths, context[row].tolist(), strict=True):
                    accepted = f"a whole number from {each.low:g} to {each.high:g}"
                    is_listed = each.low <= number <= each.high and number.is_integer()
                    is_accepted = not each.whole or is_listed or math.isnan(number)
                    require(is_accepted, each.name, number, accepted)
                self.episodes.drawn_changes(numbers)  # their families check the numbers
                episodes[row] = self._possible_episode(numbers)
                farthest, limit = self._farthest(numbers), self.limits.farthest
                accepted = f"at most {limit:g}, as the observation space has it"
                is_inside = not self.layout.has_goals or farthest <= limit
                require(is_inside, "the reach", farthest, accepted)
            except UserError as error:
                whose = f" for arm {row}" if len(randoms) > 1 else ""
                drawn = self.episodes.context(numbers)
                raise UserError(
                    f"options['context'] must be possible, got {drawn}{whose}: {error}"
                ) from error
        return episodes

    def _loaded(self, numbers: Floats) -> list[ArmParameters]:
        """Return the bodies of an arm while loads and fields grow: they are largest at the ends."""
        ends = self.episodes.spans(numbers)
        steps = np.unique([step for first, last in ends for step in (first - 1, first, last)])
        arms = self.episodes.arms(np.tile(numbers, (len(steps), 1)), steps)
        return [arms.parameters(self.episodes.touched, row) for row in range(len(steps))]

    def _farthest(self, numbers: Floats) -> float:
        """Return the distance from the base that an arm's hand, or cursor, never exceeds."""
        moments = self.episodes.moments(numbers)
        arms = self.episodes.arms(np.tile(numbers, (len(moments), 1)), moments)
        reaches = np.add.reduce(arms.segment_lengths, axis=1)
        if self.has_cursor:
            cursor = Cursor.of(arms, self.episodes.touched)
            reaches = np.maximum(reaches, cursor.farthest(reaches))
        return float(reaches.max())

    def _check_delays(self, delays: Mapping[str, int]) -> None:
        """Raise a `UserError` for a delay that is rounded to none."""
        for column, steps in delays.items():
            parts = [part for part in self.episodes.parts if column in self.episodes.touches(part)]
            if not parts or steps or self.episodes.is_drawn:
                continue
            change, step = parts[0].change, 1000 * self.control_step
            if change.strength:
                name, is_in_ms = change.family.name, change.unit == "ms"
                such = f", such as {name}-{step:g} or {name}-{2 * step:g}" if is_in_ms else ""
                raise UserError(
                    f"{change.name} would delay nothing: delays are whole control steps of "
                    f"{step:g} ms{such}"
                )

    def _check_channel(self) -> float | None:
        if "channel" not in self.episodes.touched:
            return None
        accepted = "without a channel if any of them is drawn"
        names = [change.name for change in self.episodes.changes]
        require(not self.episodes.is_drawn, "perturbations", names, accepted)
        make_arm(self.engine, self.first.body).confine((0.0, 0.0), (1.0, 0.0))
        return float(self.first.arms.channel[0])

    def episode(self, numbers: Floats) -> Episode:
        """Return the episode of an arm that has drawn numbers, (m,)."""
        episodes = self.episodes
        arms = episodes.arms(numbers[None])
        body = arms.parameters(episodes.touched)
        lock_step, unlock_step = arms.lock_steps[:, 0].tolist()
        cursor = Cursor.of(arms, episodes.touched).row(0) if self.has_cursor else None
        at_all_times = None
        if self.is_timed and self.has_cursor:
            moments = episodes.moments(numbers)
            rows = np.tile(numbers, (len(moments), 1))
            at_all_times = Cursor.of(episodes.arms(rows, moments), episodes.touched)
        locked = body.lockable_joints if lock_step == 0 else ()
        workspace = Workspace(body, self.given_body, locked, cursor, at_all_times)
        return Episode(numbers, arms, body, workspace, cursor, lock_step, unlock_step)

    def observe(self, seen: Seen) -> NDArray[np.float32]:
        """Return observations of n arms, (n, …), of what they sense."""
        speeds = relative_speeds(seen.joint_speeds, self.given_body.speed_limit)
        observation: NDArray[np.float32] = self.layout.encode(
            seen.joint_angles, speeds, hand=seen.hand, target=seen.target
        )
        return observation

    def links(
        self, count: int, delays: Mapping[str, int]
    ) -> tuple[Noise, Motors | None, Senses | None]:
        """Return the random numbers, motors and senses of n arms; None where they are in order.

        `delays` are the longest of each column of `DELAYS`, control steps.
        """
        joints, layout, touched = self.joint_count, self.layout, self.touched
        motors = senses = None
        if self.are_motors_disturbed:
            holds = self.control == "joint_position"
            motors = Motors(count, joints, delays["action_delay"], touched, holds)
        if self.are_senses_disturbed:
            senses = Senses(count, joints, layout.limits, delays, touched, self.control_step)
        return Noise(count, joints, layout.size, touched), motors, senses

    def rest(self, postures: Floats) -> Floats:
        """Return actions, (n, N), under which arms at rest in postures, (n, N), stay there."""
        if self.control != "joint_position":
            return np.zeros_like(postures)
        return np.asarray(wrap_angle(postures) / math.pi, np.float64)

    def context_of(self, numbers: Floats) -> NDArray[np.float32]:
        """Return the context, (k, c), that k arms observe if they have drawn `numbers`, (k, m)."""
        return np.clip(self._shown(numbers), -self.context_limits, self.context_limits)

    def _shown(self, numbers: Floats) -> NDArray[np.float32]:
        """Return the context without its limits, (k, c), see `context_of`."""
        if self.scale is None:
            return np.zeros((len(numbers), 0), np.float32)
        if not self.episodes.is_drawn:
            shown = self.scale.shown_of(self.episodes.drawn_changes(np.zeros(0)))
            return np.tile(shown, (len(numbers), 1))
        if self.scale.is_like(self.episodes):
            return self.scale.shown(numbers)
        changes = map(self.episodes.drawn_changes, numbers)
        return np.stack([self.scale.shown_of(drawn) for drawn in changes])

    def check_options(self, options: dict[str, Any] | None, count: int | None = None) -> Options:
        """Return the options of a reset, checked; raise a `UserError` if one cannot be accepted.

        `count` is that of the arms of a vector.
        """
        named = check_names(options)
        checked = self.trials.check(named, self.first.workspace)
        if named.get("context") is None:
            return checked
        names = [strength.name for strength in self.episodes.strengths]
        return checked._replace(context=check_context(named["context"], names, count))


class GoalSetup(ReachSetup):
    """The setup that is derived from the arguments of a goal environment."""

    def __init__(self, arguments: ReachArguments, context_limits: Any = 1.0) -> None:
        super().__init__(arguments, context_limits)
        if self.are_senses_disturbed or self.task.advance == "reach":
            raise UserError(
                "a goal environment must have a reward that is a function of the observed goals: "
                f"no disturbed senses and no via points, got task={self.task}, "
                f"perturbations={[change.name for change in self.episodes.changes]}"
            )
        self.layout = replace(self.layout, is_clipped=False, has_goals=True)
        # Rounding may put a goal beyond the reach, by as much as is accepted of a target.
        farthest = self.limits.farthest * (1 + REACH_TOLERANCE)
        self.plain_space = self.layout.goal_space(farthest)
        self.observation_space = self.layout.goal_space(farthest, self.context_limits)


class ReachEnvironment:
    """The common part of the single and the vector environment."""

    setup: ReachSetup  #: of the present episode
    observation_space: spaces.Space[Any]
    _next_setup: ReachSetup  # from the next episode on
    _arguments: Any
    _kind: type[ReachSetup]
    _numbers: Floats  # drawn for the present episode, (m,), or for those of n arms, (n, m)
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
        before, scale = self._next_setup, self._shown_scale
        changes = {"perturbations": perturbations, "observe_context": scale}
        arguments = replace(self._arguments, **changes)
        setup = self._kind(arguments, before.context_limits)
        accepted = "others that leave the observation space, but for the context, as it is"
        is_same = setup.plain_space == before.plain_space and setup.action == before.action
        require(is_same, "perturbations", perturbations, accepted)
        self._take(setup)
        self._arguments, self._next_setup = arguments, setup

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
        return self.setup.episodes.context(self._numbers)

    @property
    def context_scale(self) -> list[Any]:
        """The perturbations whose ranges scale the observed context, as `as_plain` has them."""
        if not self.context_size:
            return []
        return [as_plain(change) for change in as_changes(self._shown_scale)]

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
            names = spec.kwargs.keys() & {"task", "perturbations", "observe_context"}
            spec.kwargs = {**spec.kwargs, **{name: as_plain(spec.kwargs[name]) for name in names}}
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
