"""Agents with an internal model of their body, made of parts.

    observation → senses → body → imagination → obstacles → drive → action

- `senses`: where the joints and the target are, despite noise, and how late they are seen;
- `body`: segment lengths, a turned cursor, and joints that are locked;
- `imagination`: a posture with the hand at the target, found by an internal model;
- `obstacles`: remembered once they are felt, and ways round them;
- `drive`: joint targets on the way there;
- `memory`: what is learned from movement to movement, if anything.

The internal model is the MMC network (`mmc-body`) or damped least squares (`ik-body`).  The two
agents share all other parts, so only a difference between them is due to the network.  Each part
can be switched off (`Parts`), for ablations.

Perturbations are not given.  Arrays lead with the batch, (n, …); a single arm is a batch of one.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym.agents.base import FeedbackAgent, every, some, where
from mmc_gym.agents.body_model import spatial
from mmc_gym.agents.body_model.arm import Points, command_of, commanded_turn, hand
from mmc_gym.agents.body_model.body import PUSH, Body, BodyEvidence, Locks
from mmc_gym.agents.body_model.drive import STRONGEST, Drive, in_proportion
from mmc_gym.agents.body_model.imagination import (
    Imagination,
    ReachProblem,
    Solver,
    least_squares,
    settled_network,
    within_reach,
)
from mmc_gym.agents.body_model.memory import Memory
from mmc_gym.agents.body_model.obstacles import Contacts, Plan, Ways
from mmc_gym.agents.body_model.parts import ALL_PARTS, Parts
from mmc_gym.agents.body_model.senses import Delay, PostureTrack, TargetTrack
from mmc_gym.agents.mmc import network_of_arm
from mmc_gym.geometry import Floats
from mmc_gym.interface import ReachInterface, Seen, Sensed
from mmc_gym.network import LearnedNormalizer, MMCNetwork

LAG = 1.5  # control steps until the joints are where a command takes them
FARTHER = 0.3  # movement of a target after which a new posture is imagined, segment lengths
CLEAR = 0.01  # noise of the joint angles below which forces on the joints can be seen, radians
BETWEEN = -1  # looks of a state between two movements


class BodyState(NamedTuple):
    """State of the agent: the number of observations so far, and the memory of each part."""

    looks: Floats  # (n,)
    posture: PostureTrack
    target: TargetTrack
    delay: Delay
    evidence: BodyEvidence
    locks: Locks
    contacts: Contacts
    plan: Plan
    drive: Drive
    memory: Memory


class BodyAgent(FeedbackAgent[BodyState]):
    """An agent with an internal model of its body."""

    def __init__(self, interface: ReachInterface, solver: Solver, parts: Parts = ALL_PARTS) -> None:
        """Make the agent; `solver` is its internal model.  It cannot act under torque control."""
        super().__init__(interface)
        self.parts = parts
        self.imagination = Imagination(interface, solver, parts.imagines)
        self.ways = Ways(self.imagination)

    @override
    def start(self, sensed: Sensed) -> BodyState:
        joint_angles, target = sensed.joint_angles, _points(sensed.target)
        arms, joints = joint_angles.shape
        return BodyState(
            looks=np.zeros(arms),
            posture=PostureTrack.start(joint_angles, np.zeros_like(joint_angles)),
            target=TargetTrack.start(target),
            delay=Delay.start(command_of(self.interface, joint_angles, joint_angles)),
            evidence=BodyEvidence.start(self.interface.segment_lengths, arms),
            locks=Locks.start(joint_angles),
            contacts=Contacts.start(arms, joints),
            plan=Plan.start(joint_angles, target),
            drive=Drive.start(arms, joints),
            memory=Memory.start(arms, joints, self.parts),
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
        kept = state.memory.kept(evidence.body, evidence.given.lengths, self.parts, rest)
        return state._replace(looks=np.full_like(state.looks, BETWEEN), memory=kept)

    @override
    def respond(self, state: BodyState, seen: Seen) -> tuple[NDArray[np.float32], BodyState]:
        if self.learns:
            state = self._remembered(state, seen)
        state = self._sense(state, seen)
        problem = self._forecast(state)
        plan = self._plan(state, problem)
        joint_targets, state = self._drive(state, problem, plan)
        # Late or noisy joint angles are corrected, speeds are as seen.
        now = Seen(problem.joint_angles, seen.target, seen.joint_speeds, seen.hand)
        return self.interface.act(joint_targets, now), state

    def _remembered(self, state: BodyState, seen: Seen) -> BodyState:
        """Let movements begin with what was learned in those before."""
        between = state.looks == BETWEEN
        if some(between):
            state = where(between, self.start(seen)._replace(memory=state.memory), state)
        begins, given = state.looks == 0, state.evidence.given.lengths
        places = _points(seen.hand), _points(seen.target)
        memory = state.memory.begun(begins, *places, seen.joint_angles, given)
        return state._replace(memory=memory)

    def _body(self, state: BodyState) -> Body:
        """Return the body to act on."""
        best = state.evidence.best
        if not self.learns:
            return best
        return state.memory.body(best, state.evidence.given.lengths, self.parts)

    def _sense(self, state: BodyState, seen: Seen) -> BodyState:
        """Update the memory of the parts; `start` has entered the first observation already."""
        is_first = state.looks == 0
        state = state._replace(looks=state.looks + 1)
        if not every(is_first):
            after = self._feel(self._look(state, seen), state.posture)
            state = where(is_first, state, after) if some(is_first) else after
        if self.parts.identifies_body:
            hands = _points(seen.hand)
            if self.learns:
                hands = state.memory.as_given(hands, seen.joint_angles)
            evidence = state.evidence.observed(seen.joint_angles, hands)
            state = state._replace(evidence=evidence)
        return state

    def _look(self, state: BodyState, seen: Seen) -> BodyState:
        """Update the estimates of posture, target and delay."""
        posture, target = state.posture, state.target
        if self.parts.filters:
            step = self.interface.control_step
            posture = posture.observed(seen.joint_angles, seen.joint_speeds, step)
            target = target.observed(_points(seen.target), step)
        else:
            posture = posture.unfiltered(seen.joint_angles, seen.joint_speeds)
            target = target.unfiltered(_points(seen.target))
        delay = state.delay.observed(state.posture, posture)
        if not self.parts.bridges_delay:  # locks still need to know when a movement is felt
            delay = delay._replace(late=state.delay.late)
        return state._replace(posture=posture, target=target, delay=delay)

    def _feel(self, state: BodyState, before: PostureTrack) -> BodyState:
        """Compare the movement with the last command.

        Joints that do not turn are locked, those that turn slowly bear a load, and obstacles stop
        some point of the arm.
        """
        interface, parts, posture, locks = self.interface, self.parts, state.posture, state.locks
        asked = commanded_turn(interface, before.joint_angles, state.delay.command_then())
        if parts.finds_locks:
            lockable, is_felt = interface.lockable_joints, state.delay.is_felt
            locks = locks.observed(posture, asked, is_felt, lockable, parts.vigour)
        is_clear = (state.delay.late == 0) & (posture.deviation[:, 0] < CLEAR)
        recovers = state.target.is_moving
        drive = state.drive.observed(before, posture, is_clear, recovers, interface)
        contacts = state.contacts
        if parts.avoids:
            counts = is_clear & ~locks.is_locked.any(axis=-1)
            lengths = self._body(state).lengths
            contacts = contacts.observed(before, posture, asked, lengths, counts)
            # An obstacle slowed the joints, not a load.
            strength = np.where(contacts.is_new[:, None], STRONGEST, drive.acceleration)
            drive = drive._replace(acceleration=strength)
        return state._replace(locks=locks, drive=drive, contacts=contacts)

    def _forecast(self, state: BodyState) -> ReachProblem:
        """Predict where the joints are now, and where the hand should be when a command acts."""
        now, locks, late = state.posture.joint_angles, state.locks, state.delay.late
        if some(late):
            now = state.delay.run_forward(self.interface, now)
        held = locks.is_locked if some(locks.is_locked) else None
        if held is not None:
            now = np.where(held, locks.place, now)
        body = self._body(state)
        aim = within_reach(body.felt(state.target.ahead(late + LAG)), body.lengths)
        return ReachProblem(now, aim, body.lengths, held)

    def _plan(self, state: BodyState, problem: ReachProblem) -> Plan:
        """Return where arms should go: as planned before, or to a newly imagined posture."""
        begins = state.target.has_jumped | (state.looks == 1) | state.contacts.is_new
        begins |= np.abs(problem.aim - state.plan.aim) > FARTHER
        is_new = begins | state.locks.has_changed.any(axis=-1)
        goal = self.imagination.followed(state.plan.goal, problem)
        plan = state.plan.arrived(self.interface, problem.joint_angles)._replace(goal=goal)
        if some(is_new):
            plan = plan._replace(goal=goal.copy())
            plan.goal[is_new] = self.imagination.improved(goal[is_new], problem.of(is_new))
            plan = self.ways.planned(plan, state.contacts, problem, is_new)
        is_next_leg = plan.ahead < state.plan.ahead
        is_new = is_new | is_next_leg
        aim = np.where(is_new, problem.aim, plan.aim)
        return plan._replace(aim=aim, begins=begins | is_next_leg, is_new=is_new)

    def _drive(
        self, state: BodyState, problem: ReachProblem, plan: Plan
    ) -> tuple[Floats, BodyState]:
        """Return joint targets, and the state after they were sent."""
        interface, now = self.interface, problem.joint_angles
        drive, locks = state.drive, state.locks
        left = interface.turn(now, plan.next)
        joint_targets: Floats = now + left
        if self.parts.drives and not interface.has_drive:
            turn, drive = self._turn(state, problem, plan, left)
            if self.learns:
                is_early = 2 * drive.elapsed <= drive.duration
                memory = state.memory.moved(now, problem.lengths, is_early)
                turn, memory = memory.corrected(
                    turn, now, problem.aim, problem.lengths, problem.held
                )
                state = state._replace(memory=memory)
            noise = state.posture.deviation
            joint_targets, drive = drive.targets(now, turn, left, noise, interface)
        if some(locks.is_locked):
            # A drive of the environment would move other joints, too, against a joint pushed.
            push = 0.0 if interface.has_drive else PUSH
            pushed = locks.place + push * np.sign(locks.asked)
            joint_targets = np.where(locks.is_locked, pushed, joint_targets)
        command = command_of(interface, now, joint_targets)
        delay = state.delay.sent(command, state.posture, interface)
        return joint_targets, state._replace(delay=delay, drive=drive, plan=plan)

    def _turn(
        self, state: BodyState, problem: ReachProblem, plan: Plan, left: Floats
    ) -> tuple[Floats, Drive]:
        """Return how far joints should turn in this control step, and the drive."""
        interface, drive, met = self.interface, state.drive, state.contacts.met
        moves: Floats | float = 0.0
        if some(state.target.is_moving):
            follows = state.target.is_moving & ~plan.is_new & (plan.ahead == 0)
            moves = np.where(follows[:, None], interface.turn(state.plan.goal, plan.goal), 0.0)
        turn = drive.turn(left, moves, interface)
        if self.parts.vigour < 1:
            return self._human_turn(turn, state, problem, plan, left)
        if some(met):  # arms that know obstacles keep to the way they planned
            straight = drive.straight(plan.begin, problem.joint_angles, plan.next, interface)
            turn = np.where((met > 0)[:, None], straight, turn)
        return turn, drive

    def _human_turn(
        self, turn: Floats, state: BodyState, problem: ReachProblem, plan: Plan, left: Floats
    ) -> tuple[Floats, Drive]:
        """Return as much of a turn as a slower movement makes in this step, and the drive."""
        now, lengths, is_moving = problem.joint_angles, problem.lengths, state.target.is_moving
        way = np.abs(hand(plan.next, lengths) - hand(now, lengths))
        begins = plan.begins & ~is_moving  # a moving target is followed, not reached
        drive = state.drive.timed(begins, way, left, self.interface, self.parts.vigour)
        human = in_proportion(turn, left * drive.share_of_turn(now, left, lengths)[:, None])
        follows = is_moving & (drive.elapsed >= drive.duration)
        return np.where(follows[:, None], turn, human), drive


def _points(vectors: Floats) -> Points:
    """Return vectors (..., 2) as complex numbers, (...)."""
    return vectors.view(np.complex128)[..., 0]


def mmc_body(
    interface: ReachInterface, parts: Parts = ALL_PARTS, **settings: Any
) -> BodyAgent | spatial.SpatialBodyAgent:
    """Return the agent whose internal model is the MMC network, see `network_of_body`."""
    if interface.arm is not None:
        return spatial.SpatialBodyAgent(interface, spatial.settled_network, parts)
    network = network_of_body(interface, **settings)
    return BodyAgent(interface, partial(settled_network, network), parts)


def network_of_body(interface: ReachInterface, **settings: Any) -> MMCNetwork:
    """Return the internal model of `mmc_body`: the paper's, but for other settings of `MMCNetwork`.

    With less damping than the paper's it settles sooner (`body_model.imagination`).
    """
    body: dict[str, Any] = {
        "damping": 0.55 * (len(interface.segment_lengths) + 1),
        "normalizer": LearnedNormalizer.shipped(),
        "dynamics": "paper",
        "velocity_damping": 2.0,
    }
    return network_of_arm(interface, **{**body, **settings})


def ik_body(
    interface: ReachInterface, parts: Parts = ALL_PARTS
) -> BodyAgent | spatial.SpatialBodyAgent:
    """Return the agent whose internal model is damped least squares."""
    if interface.arm is not None:
        return spatial.SpatialBodyAgent(interface, spatial.least_squares, parts)
    return BodyAgent(interface, least_squares, parts)
