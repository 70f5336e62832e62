"""Agents with an internal model of their body, made of parts.

    observation → senses → body → imagination → obstacles → drive → motors → action

- `senses`: where the joints and the target are, despite noise, and how late they are seen;
- `body`: segment lengths, a turned cursor, and joints that are locked;
- `imagination`: a posture with the hand at the target, from an internal model;
- `obstacles`: remembered once they are felt, and routes round them;
- `drive`: joint targets on the way there;
- `motors`: what commands really do to joints, and which command turns them as they should;
- `regulator`: the best commands near the target;
- `stuck`: joint sensors that the hand or speeds contradict;
- `memory`: what is learned from movement to movement, if anything.

The internal model is the MMC network (`mmc-body`) or damped least squares (`ik-body`).  The two
agents share all other parts, so only a difference between them is due to the network.  Each part
can be switched off (`Parts`), for ablations.  Perturbations are not given.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym.agents.base import FeedbackAgent, all_true, any_true, of_arms, where
from mmc_gym.agents.body_model import spatial
from mmc_gym.agents.body_model.body import Body, BodyEvidence, Locks
from mmc_gym.agents.body_model.drive import FULL_LEAD, STRONGEST, Drive, in_proportion
from mmc_gym.agents.body_model.forward_model import (
    SAME,
    SMALL,
    Bools,
    Response,
    as_points,
    as_vectors,
    command_of,
    full_turn,
    hand,
    to_hand,
    turn_share,
)
from mmc_gym.agents.body_model.imagination import (
    Imagination,
    InternalModel,
    ReachProblem,
    least_squares,
    settle_network,
    within_reach,
)
from mmc_gym.agents.body_model.memory import Memory
from mmc_gym.agents.body_model.motors import Motors
from mmc_gym.agents.body_model.obstacles import Contacts, RoadMap, Route
from mmc_gym.agents.body_model.parts import ALL_PARTS, Parts
from mmc_gym.agents.body_model.regulator import Regulator, regulates
from mmc_gym.agents.body_model.senses import LONGEST_DELAY, LastStep, Senses
from mmc_gym.agents.body_model.stuck import Drift, Stuck
from mmc_gym.agents.mmc import network_of_arm
from mmc_gym.geometry import Floats
from mmc_gym.interface import ReachInterface, Seen, Sensed
from mmc_gym.network import LearnedNormalizer, MMCNetwork

LAG = 1.5  # control steps until the joints are where a command takes them
AT_LIMIT = 0.05  # a joint nearer to its limit may be stopped by it, radians
FARTHER = 0.3  # movement of a target after which a new posture is imagined, segment lengths
BETWEEN = -1  # looks of a state between two movements


class BodyState(NamedTuple):
    """State of the agent: the number of observations so far, and that of each part."""

    looks: Floats  # (n,)
    senses: Senses
    evidence: BodyEvidence
    locks: Locks
    contacts: Contacts
    route: Route
    motors: Motors
    regulator: Regulator
    stuck: Stuck
    drift: Drift
    drive: Drive
    memory: Memory
    response: Response


class BodyAgent(FeedbackAgent[BodyState]):
    """An agent with an internal model of its body."""

    def __init__(
        self,
        interface: ReachInterface,
        model: InternalModel,
        parts: Parts,
        subjects: Sequence[Parts] = (),
    ) -> None:
        """Make the agent of an internal model.  It cannot act under torque control.

        `subjects` have their own rate and retention, one for each arm of a batch.
        """
        super().__init__(interface)
        self.parts, self.subjects = parts, subjects
        self.has_own_act = type(interface).act is not ReachInterface.act
        # A movement that begins slowly shows how late it is too late to learn motors from it.
        self.finds_faults = (
            parts.finds_motors and parts.drives and parts.vigour == 1 and not parts.learns
        )
        self.has_servos = not (self.has_own_act or interface.has_drive)
        self.finds_motors = self.finds_faults and self.has_servos
        # Squared distances from each joint to the hand of a stretched arm.
        self._levers = np.cumsum(interface.segment_lengths[::-1])[::-1] ** 2
        self.imagination = Imagination(interface, model, parts.imagines)
        self.road_map = RoadMap(self.imagination)

    @override
    def start(self, sensed: Sensed) -> BodyState:
        joint_angles = sensed.joint_angles
        arms, joints = joint_angles.shape
        return BodyState(
            looks=np.zeros(arms),
            senses=Senses.start(self.interface, sensed),
            evidence=BodyEvidence.start(self.interface.segment_lengths, arms),
            locks=Locks.start(joint_angles),
            contacts=Contacts.start(arms, joints),
            route=Route.start(joint_angles, as_points(sensed.target)),
            motors=Motors.start(arms, joints),
            regulator=Regulator.start(arms, joints),
            stuck=Stuck.start(sensed),
            drift=Drift.start(sensed),
            drive=Drive.start(arms, joints),
            memory=Memory.start(arms, joints, self.parts, self.subjects),
            response=Response.start(arms, joints, LONGEST_DELAY if self.has_own_act else 0),
        )

    @property
    @override
    def learns(self) -> bool:
        return self.parts.learns

    @override
    def between_trials(self, state: BodyState | None, rest: float = 0.0) -> BodyState | None:
        if state is None or not self.learns:
            return None
        evidence = state.evidence
        learned = state.memory.keep(evidence.body, evidence.given_body.lengths, self.parts, rest)
        return state._replace(looks=np.full_like(state.looks, BETWEEN), memory=learned)

    @override
    def respond(self, state: BodyState, seen: Seen) -> tuple[NDArray[np.float32], BodyState]:
        if any_true(begins := state.senses.begin_anew(seen, self.interface)):
            state = state._replace(looks=np.where(begins, BETWEEN, state.looks))
        if self.learns or any_true(state.looks == BETWEEN):
            state = self._begin_movements(state, seen)
        lost = seen.lost if self.parts.filters else None
        if lost is not None:
            step = self.interface.control_step
            offset = state.stuck.offset - state.drift.offset
            seen = state.senses.complete(seen, lost, offset, step)
        if self.finds_faults:
            state, seen = self._correct(state, seen)
        state = self._observe(state, seen)
        angles, speeds, before = self._predict_now(state, seen)
        problem = self._forecast(state, angles)
        state = state._replace(route=self._plan_route(state, problem))
        joint_targets, state = self._drive(state, problem, before)
        now = Seen(problem.joint_angles, seen.target, speeds, seen.hand)
        action = self.interface.act(joint_targets, now)
        if self.learns:
            action = state.memory.disturbed(action, state.looks)
        if self.has_own_act:
            action, response = state.response.send(action, self.finds_faults)
            state = state._replace(response=response)
        return action, state

    def _correct(self, state: BodyState, seen: Seen) -> tuple[BodyState, Seen]:
        """Return the state, and what is seen, with sensors corrected that drift or are stuck."""
        posture, step = state.senses.posture, self.interface.control_step
        drift, seen = state.drift.correct(state.stuck.speeds, seen, step, posture.is_clear)
        stuck = state.stuck.feel(seen, step, np.where(posture.is_clear, 0.0, posture.deviation))
        doubted = stuck.doubted(state.stuck)
        if any_true(doubted):
            senses, delay, model = state.senses, state.senses.delay, state.evidence.best.hand_model
            counts = (state.looks > 0) & delay.is_felt & delay.is_seen & (delay.lag == 0)
            counts &= ~senses.is_hidden
            commanded = senses.commanded if self.has_servos else None
            noise = senses.target.noise
            compared = stuck.compare(model, posture.joint_angles, commanded, counts, noise)
            stuck = where(doubted, compared, stuck)
            if any_true(stuck.is_stuck):
                seen = stuck.corrected(seen, state.stuck, step)
        return state._replace(stuck=stuck, drift=drift), seen

    def _begin_movements(self, state: BodyState, seen: Seen) -> BodyState:
        """Return the state with new movements begun from what was learned in earlier ones."""
        between = state.looks == BETWEEN
        if any_true(between):
            fresh = self.start(seen)._replace(memory=state.memory)
            state = where(between, fresh, state)
        begins, given_lengths = state.looks == 0, state.evidence.given_body.lengths
        places = as_points(seen.hand), as_points(seen.target)
        memory = state.memory.begin_movement(begins, *places, seen.joint_angles, given_lengths)
        return state._replace(memory=memory)

    def _body(self, state: BodyState, best: Body) -> Body:
        """Return the body to act on, from the best hypothesis."""
        given_lengths = state.evidence.given_body.lengths
        return state.memory.body(best, given_lengths, self.parts) if self.learns else best

    def _observe(self, state: BodyState, seen: Seen) -> BodyState:
        """Update what is seen and identified; `start` has entered the first posture and target.

        Only lengths and cursor are identified from a single observation.  They come last, so that
        the last control step is compared with the body as it was known then.
        """
        is_first, looks = state.looks == 0, state.looks + 1
        if any_true(is_first):
            first = state._replace(looks=looks, senses=state.senses.look(seen))
            state = first if all_true(is_first) else self._compare_step(state, seen, looks)
            state = where(is_first, first, state)
        else:
            state = self._compare_step(state, seen, looks)
        is_hidden, after = state.senses.is_hidden, self._identify_body(state)
        return where(is_hidden, state, after) if any_true(is_hidden) else after

    def _compare_step(self, state: BodyState, seen: Seen, looks: Floats) -> BodyState:
        """Compare the last control step with its command.

        The order matters, because each step rules out the causes before it: late senses show the
        effect of an older command; joints that do not turn are locked; joints that turn slowly bear
        a load; an obstacle stops one point of the arm, and then no load slowed the joints.
        """
        motors, drive = state.motors, state.drive
        senses, step = state.senses.update(seen, self.interface, self.parts, motors)
        response, locks, regulator = state.response, state.locks, state.regulator
        if self.finds_motors:
            motors, drive = self._identify_motors(motors, drive, step)
            regulator = self._learn_commands(regulator, step, motors)
        if self.has_own_act:
            delay = senses.delay
            before = state.senses.posture.speeds
            counts = delay.is_felt[:, None] & self._turn_freely(seen.joint_angles)
            response = response.observe(before, seen.joint_speeds, delay.late, counts)
        if self.parts.finds_locks:
            locks = locks.identify(step, self.parts.vigour)
            if any_true(locks.is_locked):  # nothing is learned of motors whose joints are locked
                motors = where(locks.is_locked, Motors.start(*locks.is_locked.shape), motors)
        drive = drive.estimate_acceleration(step, self.interface, motors)
        contacts = state.contacts
        if self.parts.avoids:
            counts = step.is_timely & ~locks.is_locked.any(axis=-1)
            lengths = self._body(state, state.evidence.best).lengths
            if any_true(locks.has_changed):  # a new lock stopped the arm
                begins = np.any(locks.has_changed & locks.is_locked, axis=-1)
                contacts = where(begins, Contacts.start(*locks.is_locked.shape), contacts)
            contacts = contacts.locate(step, lengths, counts, self.interface.control_step)
            if any_true(contacts.is_new):
                is_new = contacts.is_new[:, None]
                strength = np.where(is_new, STRONGEST, drive.acceleration)
                drive = drive._replace(acceleration=strength)
        return state._replace(
            looks=looks,
            senses=senses,
            locks=locks,
            contacts=contacts,
            motors=motors,
            drive=drive,
            response=response,
            regulator=regulator,
        )

    def _turn_freely(self, joint_angles: Floats) -> Bools:
        """Return which joints, (n, N), are too far from their limits to be stopped by them."""
        low, high = np.transpose(self.interface.joint_limits or ((-np.inf, np.inf),))
        is_free: Bools = (joint_angles > low + AT_LIMIT) & (joint_angles < high - AT_LIMIT)
        return is_free

    def _identify_motors(
        self, motors: Motors, drive: Drive, step: LastStep
    ) -> tuple[Motors, Drive]:
        """Return the motors after a control step, and the drive, anew where other motors act."""
        unit, strength = full_turn(self.interface), self._strength(drive)
        before, turn = step.before.turn / unit, step.after.turn / unit
        commanded = step.as_given / unit
        after = motors.observe(before, commanded, turn, strength, step.is_felt[:, None])
        begins = after.is_learned & ~motors.is_learned
        if any_true(begins):
            strength = np.where(begins, STRONGEST, drive.acceleration)
            drive = drive._replace(acceleration=strength)
        return after, drive

    def _strength(self, drive: Drive) -> Floats:
        """Return how much joints can change their turn in a control step, full turns, (n, N)."""
        interface = self.interface
        return drive.acceleration * interface.control_step**2 / full_turn(interface)

    def _learn_commands(self, regulator: Regulator, step: LastStep, motors: Motors) -> Regulator:
        """Return the regulator after a control step, if the arm was felt to move in it."""
        unit, limit, is_felt = full_turn(self.interface), self.interface.speed_limit, step.is_felt
        after = regulator.observe(
            before=step.before.speeds / limit,
            commanded=step.as_given / unit,
            after=step.after.speeds / limit,
            turn=step.after.turn / unit,
            differs=motors.clearly_differ,
        )
        if all_true(is_felt):
            return after
        return where(is_felt, after, regulator._replace(last=after.last))

    def _identify_body(self, state: BodyState) -> BodyState:
        if not self.parts.identifies_body:
            return state
        hands, joint_angles = state.senses.hand, state.senses.of_hand
        if self.learns:
            hands = state.memory.as_given(hands, joint_angles)
        # Within a movement, agents that learn follow no change: they act on what they believe.
        follows, mirrors = self.parts.follows_changes and not self.learns, not self.learns
        posture = state.senses.posture
        blur = (posture.doubt * self._levers).sum(axis=-1) if any_true(posture.noise) else 0.0
        evidence = state.evidence.add(joint_angles, hands, follows, mirrors, blur)
        return state._replace(evidence=evidence)

    def _predict_now(self, state: BodyState, seen: Seen) -> tuple[Floats, Floats, Floats]:
        """Return angles, speeds and last turns of the joints now, corrected for noise and delay."""
        posture, speeds = state.senses.posture, seen.joint_speeds
        angles, turn = posture.joint_angles, posture.turn
        delay, interface = state.senses.delay, self.interface
        if not all_true(posture.is_clear):
            hand, columns = self._body(state, state.evidence.best).hand_model(angles)
            error, noise = as_vectors(state.senses.hand) - hand, state.senses.target.noise
            tells = ~posture.is_clear[:, 0] & (delay.lag == 0) & ~state.senses.is_hidden
            by_hand = posture.by_hand(error, columns, noise)
            angles = np.where(tells[:, None], by_hand, angles)
        if not any_true(delay.late):
            return angles, speeds, turn
        if not self.has_own_act:
            angles, turn = delay.run_forward(interface, angles, turn, state.motors)
            return angles, speeds, turn
        step = interface.control_step
        return *state.response.run_forward(angles, speeds, delay.late, step), turn

    def _forecast(self, state: BodyState, now: Floats) -> ReachProblem:
        """Return the task: the posture now, and where the hand should be once the command acts."""
        delay, locks = state.senses.delay, state.locks
        held = locks.is_locked if any_true(locks.is_locked) else None
        if held is not None:
            now = np.where(held, locks.place, now)
        ahead = delay.late + delay.lag + LAG
        body = self._body(state, state.evidence.after(ahead))
        aim = body.felt(state.senses.target.predict(ahead))
        aim = within_reach(state.memory.aimed(aim) if self.learns else aim, body.lengths)
        return ReachProblem(now, aim, body.lengths, held)

    def _plan_route(self, state: BodyState, problem: ReachProblem) -> Route:
        """Return the routes of the arms: as planned before, or to a newly imagined posture."""
        begins = state.senses.target.has_jumped | (state.looks == 1) | state.contacts.is_new
        begins |= np.abs(problem.aim - state.route.aim) > FARTHER
        is_new = begins | state.locks.has_changed.any(axis=-1)
        goal = self.imagination.follow(state.route.goal, problem)
        route = state.route.advance(self.interface, problem.joint_angles)
        if any_true(is_new):
            goal = goal.copy()
            goal[is_new] = self.imagination.improve(goal[is_new], problem.of(is_new))
            route = route._replace(goal=goal)
            route = self.road_map.plan(route, state.contacts, problem, is_new)
            goal = route.goal
        is_next_leg = route.ahead < state.route.ahead
        is_new = is_new | is_next_leg
        aim = np.where(is_new, problem.aim, route.aim)
        goal_turn = np.zeros(goal.shape)
        is_moving = state.senses.target.is_moving | state.evidence.change.is_on
        if any_true(is_moving):
            follows = is_moving & ~is_new & (route.ahead == 0)
            turn = self.interface.turn(state.route.goal, goal)
            goal_turn = np.where(follows[:, None], turn, goal_turn)
        begins |= is_next_leg
        return route._replace(goal=goal, aim=aim, goal_turn=goal_turn, begins=begins)

    def _drive(
        self, state: BodyState, problem: ReachProblem, before: Floats
    ) -> tuple[Floats, BodyState]:
        """Return joint targets, and the state after they were sent.

        Joints turned by `before` in the last control step, radians, (n, N).
        """
        interface, now = self.interface, problem.joint_angles
        left = interface.turn(now, state.route.next)
        if self.parts.drives and not interface.has_drive:
            state = self._invert_servos(state, problem, left, before)
            joint_targets = now + state.drive.lead
        else:
            joint_targets = now + left
        if problem.held is not None:
            # A drive of the environment would move other joints, too, against a joint pushed.
            push = 0.0 if interface.has_drive else FULL_LEAD
            pushed = state.locks.place + push * np.sign(state.locks.commanded)
            joint_targets = np.where(problem.held, pushed, joint_targets)
        command = command_of(interface, now, joint_targets)
        senses = state.senses.record(command, interface, state.motors)
        return joint_targets, state._replace(senses=senses)

    def _invert_servos(
        self, state: BodyState, problem: ReachProblem, left: Floats, before: Floats
    ) -> BodyState:
        """Return the state after targets make the servos turn the joints as they should."""
        memory, doubt = state.memory, self._doubt(state)
        turn, drive = self._turn(state, problem, left)
        if self.learns:
            is_early = 2 * drive.elapsed <= drive.duration
            turn, memory = memory.record_drift(problem, is_early).correct_drift(turn, problem)
        late = state.senses.delay.late[:, None]
        if any_true(late):  # the last turn is too uncertain: as if joints turned so already
            before = np.where(late > 0, turn, before)
        lead = drive.invert_servos(turn, left, np.sqrt(doubt), self.interface, state.motors, before)
        regulator = state.regulator
        if self.finds_motors and any_true(acts := self._regulates(state, left, doubt)):
            lead, regulator = self._regulate(state, problem, left, lead, np.flatnonzero(acts))
        drive = drive.send(lead, self.interface)
        return state._replace(drive=drive, memory=memory, regulator=regulator)

    def _doubt(self, state: BodyState) -> Floats:
        """Return the variance of the joint angles, radians², (n, N) or (n, 1).

        If they are filtered, it is more than the filter takes it for where the hand errs by more
        than that explains.
        """
        posture = state.senses.posture
        if all_true(posture.is_clear):
            return posture.noise
        explained = (posture.doubt * self._levers).sum(axis=-1) + 2 * state.senses.target.noise
        ratio = state.evidence.scatter / (explained + SAME**2)
        filtered = posture.doubt * np.maximum(1.0, ratio)[:, None]
        return np.where(posture.is_clear, posture.noise, filtered)

    def _regulates(self, state: BodyState, left: Floats, doubt: Floats) -> Bools:
        """Return which arms the regulator commands, (n,): only those seen as they are, in time.

        Noisy angles are filtered; then motors must err by more than the `doubt` that is left, see
        `_doubt`.
        """
        senses, unit = state.senses, full_turn(self.interface)
        strength = self._strength(state.drive)
        acts = regulates(left / unit, strength, state.motors, state.locks.is_locked)
        is_exact = senses.posture.deviation[:, 0] < SMALL
        if not all_true(is_clear := senses.posture.is_clear[:, 0]):
            errs_more = state.motors.error * unit**2 > doubt.mean(axis=-1)
            is_exact = np.where(is_clear, is_exact, errs_more)
        acts &= (senses.delay.late == 0) & is_exact
        return acts & ~state.stuck.contradicts & state.evidence.explains_hand

    def _regulate(
        self,
        state: BodyState,
        problem: ReachProblem,
        left: Floats,
        lead: Floats,
        arms: NDArray[np.intp],
    ) -> tuple[Floats, Regulator]:
        """Return leads, radians, and the regulator, after it commanded these arms, (m,).

        A lead is how far a target is ahead of its joint; other arms keep theirs, of `lead`, (n, N).
        """
        unit, regulator, problem = full_turn(self.interface), state.regulator, problem.of(arms)
        left, goal_turn = left[arms], state.route.goal_turn[arms]
        speeds = state.senses.posture.speeds[arms] / self.interface.speed_limit
        jacobian = as_vectors(1j * to_hand(problem.joint_angles, problem.lengths))
        angles = ((left - goal_turn) / unit, speeds, goal_turn / unit)
        turn, after = of_arms(regulator, arms).command(*angles, jacobian, problem.held)
        best = turn * (unit / turn_share(self.interface))
        if problem.held is not None:
            best = np.where(problem.held, 0.0, best)
        lead, value = lead.copy(), regulator.value.copy()
        lead[arms], value[arms] = best, after.value
        return lead, regulator._replace(value=value)

    def _turn(self, state: BodyState, problem: ReachProblem, left: Floats) -> tuple[Floats, Drive]:
        """Return how far joints should turn in this control step, and the drive."""
        route, drive = state.route, state.drive
        turn = drive.turn(left, route.goal_turn, self.interface)
        if self.parts.vigour < 1:
            return self._human_turn(turn, state, problem, left)
        located = state.contacts.located[:, None]
        if any_true(located):  # arms that know obstacles keep to the planned route
            now = problem.joint_angles
            straight = drive.straight(route.begin, now, route.next, self.interface)
            turn = np.where(located > 0, straight, turn)
        return turn, drive

    def _human_turn(
        self, turn: Floats, state: BodyState, problem: ReachProblem, left: Floats
    ) -> tuple[Floats, Drive]:
        """Return the part of a turn that a movement of human speed makes now, and the drive."""
        now, lengths, route = problem.joint_angles, problem.lengths, state.route
        is_moving = state.senses.target.is_moving
        way = np.abs(hand(route.next, lengths) - hand(now, lengths))
        begins = route.begins & ~is_moving  # a moving target is followed, not reached
        drive = state.drive.time(begins, way, left, self.interface, self.parts.vigour)
        human = in_proportion(turn, left * drive.share_of_turn(now, left, lengths)[:, None])
        follows = is_moving & (drive.elapsed >= drive.duration)
        return np.where(follows[:, None], turn, human), drive


def mmc_body(
    interface: ReachInterface,
    parts: Parts = ALL_PARTS,
    subjects: Sequence[Parts] = (),
    **settings: Any,
) -> BodyAgent | spatial.SpatialBodyAgent:
    """Return the agent whose internal model is the MMC network, see `network_of_body`."""
    if interface.arm is not None:
        return spatial.SpatialBodyAgent(interface, spatial.settle_network, parts)
    network = network_of_body(interface, **settings)
    return BodyAgent(interface, partial(settle_network, network), parts, subjects)


def network_of_body(interface: ReachInterface, **settings: Any) -> MMCNetwork:
    """Return the network of `mmc_body`: the paper's, but with less damping, so it settles sooner.

    `settings` are of `MMCNetwork`.  How soon it settles matters to `body_model.imagination`.
    """
    body: dict[str, Any] = {
        "damping": 0.55 * (len(interface.segment_lengths) + 1),
        "normalizer": LearnedNormalizer.shipped(),
        "dynamics": "paper",
        "velocity_damping": 2.0,
    }
    return network_of_arm(interface, **{**body, **settings})


def ik_body(
    interface: ReachInterface, parts: Parts = ALL_PARTS, subjects: Sequence[Parts] = ()
) -> BodyAgent | spatial.SpatialBodyAgent:
    """Return the agent whose internal model is damped least squares."""
    if interface.arm is not None:
        return spatial.SpatialBodyAgent(interface, spatial.least_squares, parts)
    return BodyAgent(interface, least_squares, parts, subjects)
