"""Your own learner over trials: where to aim, and what an error teaches.

The arm is moved by the drive of the body agent, at the speed of people.  The movement is not
corrected while it lasts, so that what is learned shows in its direction.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym.agents.base import Agent, Started, where
from mmc_gym.agents.body_model.agent import BodyAgent, BodyState, mmc_body
from mmc_gym.agents.body_model.forward_model import Points, as_points, as_vectors, hand
from mmc_gym.agents.body_model.parts import Parts
from mmc_gym.geometry import Floats
from mmc_gym.interface import CannotActError, Observation, ReachInterface, Seen

WAITING = 0.02  # a target nearer to the hand is no target yet, segment lengths


class Movement(NamedTuple):
    """A movement that goes on, of n arms; points as complex numbers, segment lengths."""

    body: BodyState
    begin: Points  # where the hand was felt, (n,)
    seen_at_begin: Points  # where it, or its cursor, was seen
    aim: Points  # where the hand goes
    target: Points
    seen: Points  # where hand or cursor was seen last, or when the hand was fastest
    felt: Points  # where the hand was felt last
    fastest: Floats  # its largest displacement in a control step


class LearnerState(NamedTuple):
    """What n learners know, and the movement that goes on, if any."""

    learned: tuple[Any, ...]  # whatever `learn` returns, of each
    randoms: tuple[np.random.Generator, ...]  # of noise
    noise: Floats  # how noisy each is, 1 without a spread, (n,)
    movement: Movement | None = None


class TrialLearner(Agent[LearnerState]):
    """A learner that aims, moves, sees its error, and learns from it.

    It is made for an environment, and given to `run_experiment` as a class.  Its state is whatever
    you like; directions are in degrees, counter-clockwise.

        class Mine(TrialLearner):
            def aim(self, target, state):
                return target - state

            def learn(self, error, state):
                return 0.98 * state + 0.2 * error
    """

    initial: Any = 0.0  #: the state before the first trial
    #: standard deviation of the planned direction, degrees (van Beers 2009)
    planning_noise: float = 0.0
    #: that of each command, as a share of it (Harris & Wolpert 1998)
    motor_noise: float = 0.0
    #: whether it learns from the error at the hand's peak speed, if that is seen, not at the end: a
    #: servo undoes what a field does on the way
    sees_peak: bool = False
    noise_spread: float = 0.0  #: how subjects differ in both: standard deviation, as a share
    vigour: float = 0.0  #: 0 as people move, 1 as fast as servos allow

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        """Make learners for an environment; raise a `CannotActError` if it has no planar arm."""
        parts = Parts(vigour=self.vigour, identifies_body=False)
        body = mmc_body(ReachInterface.of(env), parts)
        if not isinstance(body, BodyAgent):
            raise CannotActError("env must have an arm in the plane for a TrialLearner")
        self.body = body
        self._lengths = np.array(body.interface.segment_lengths)

    @abstractmethod
    def aim(self, target: float, state: Any) -> float:
        """Return the direction to move in, for a target in the direction `target`."""

    @abstractmethod
    def learn(self, error: float, state: Any) -> Any:
        """Return the state for the next trial.

        `error` is the direction of hand or cursor at the end less that of the target, or of the
        instructed aim, from −180 to 180; 0.0 if the cursor was hidden.
        """

    def rest(self, seconds: float, state: Any) -> Any:
        """Return the state after a rest between trials; by default the same."""
        del seconds
        return state

    def first(self, random: np.random.Generator) -> Any:
        """Return a subject's state before its first trial, `initial`; may draw what is its own."""
        del random
        return self.initial

    @override
    def begin(self, seeds: Sequence[int]) -> LearnerState:
        randoms = tuple(np.random.default_rng(seed) for seed in seeds)
        noise = np.ones(len(randoms))
        if self.noise_spread:  # else nothing is drawn
            noise += [self.noise_spread * random.standard_normal() for random in randoms]
        return LearnerState(tuple(map(self.first, randoms)), randoms, np.maximum(noise, 0.0))

    @override
    def between_trials(self, state: LearnerState | None, rest: float = 0.0) -> LearnerState | None:
        if state is None or state.movement is None:
            return state
        of = state.movement
        moved, way = of.seen - of.seen_at_begin, of.target - of.seen_at_begin
        is_seen = np.abs(moved) > WAITING
        errors = np.where(is_seen, np.degrees(np.angle(moved * way.conj())), 0.0).tolist()
        learned = (self.learn(*pair) for pair in zip(errors, state.learned, strict=True))
        after = tuple(self.rest(rest, subject) if rest else subject for subject in learned)
        return LearnerState(after, state.randoms, state.noise)

    @override
    def predict(
        self,
        observation: Observation,
        state: LearnerState | None = None,
        episode_start: Started = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], LearnerState]:
        interface = self.body.interface
        seen = interface.look(observation)
        batch, rows = seen.joint_angles.shape[:-1], seen.in_rows()
        if state is None:
            state = self.begin(range(len(rows.joint_angles)))
        movement = state.movement
        if movement is None:
            movement = self._begin_movement(rows)
        elif np.any(episode_start):  # a new episode, whose learner knows nothing
            starts = np.ones(len(rows.joint_angles), bool)
            starts &= np.asarray(episode_start, bool).reshape(-1)
            subjects = zip(starts, state.learned, state.randoms, strict=True)
            learned = tuple(
                self.first(random) if is_new else before for is_new, before, random in subjects
            )
            state = state._replace(learned=learned)
            movement = where(starts, self._begin_movement(rows), movement)
        of = self._with_aim(movement, state, rows)
        felt = hand(rows.joint_angles, self._lengths)
        aimed = Seen(rows.joint_angles, as_vectors(of.aim), rows.joint_speeds, as_vectors(felt))
        action, body = self.body.respond(of.body, aimed)
        if self.motor_noise:
            scale = self.motor_noise * state.noise[:, None]
            normal = [random.standard_normal(action.shape[-1]) for random in state.randoms]
            action = np.clip(action * (1 + scale * normal), -1, 1)
        last, speed = as_points(rows.hand).copy(), np.abs(felt - of.felt)
        if self.sees_peak:
            is_unseen = np.abs(of.seen - of.seen_at_begin) < WAITING
            last = np.where((speed > of.fastest) | is_unseen, last, of.seen)
        fastest = np.maximum(speed, of.fastest)
        moved = of._replace(body=body, seen=last, felt=felt, fastest=fastest)
        action = interface.checked_action(action, rows.joint_angles.shape[:-1])
        return action.reshape(*batch, action.shape[-1]), state._replace(movement=moved)

    def _begin_movement(self, rows: Seen) -> Movement:
        felt, seen = hand(rows.joint_angles, self._lengths), as_points(rows.hand).copy()
        still = Seen(rows.joint_angles, as_vectors(felt), rows.joint_speeds, as_vectors(felt))
        rest = np.zeros(len(felt))
        return Movement(self.body.start(still), felt, seen, felt, seen, seen, felt, rest)

    def _with_aim(self, of: Movement, state: LearnerState, rows: Seen) -> Movement:
        """Return the movement with the aim of arms whose target has just appeared."""
        target = as_points(rows.target).copy()
        way = target - of.seen_at_begin
        appears = (np.abs(way) > WAITING) & (of.aim == of.begin)
        if not appears.any():
            return of
        aim = of.aim.copy()
        for arm in np.flatnonzero(appears):
            planned = self.aim(float(np.degrees(np.angle(way[arm]))), state.learned[arm])
            noise = self.planning_noise * state.noise[arm]
            planned += noise * state.randoms[arm].standard_normal()
            aim[arm] = of.begin[arm] + np.abs(way[arm]) * np.exp(1j * np.radians(planned))
        return of._replace(aim=aim, target=np.where(appears, target, of.target))
