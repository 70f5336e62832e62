"""An internal model of the own body that acts: parts in a line.

    observation → senses → body → locks, contacts → imagination → drive → action

- `senses`: where joints and target are, behind noise, and how late they are seen;
- `body`: lengths of the segments, and how the seen hand is turned;
- `locks`: joints that do not turn;
- `contacts` and `ways`: obstacles, once they are felt, and ways round them;
- `imagination`: in which posture to be at the target, found by an internal model;
- `drive`: what to ask of the servos on the way there.

The internal model is the MMC network (`mmc-body`) or damped least squares (`ik-body`).  What the
agents reach, they reach by all parts; the difference between the two is what is the network's
own.  Each part is a switch (`Parts`), for ablations.

Nothing of the perturbations is told.  Arms are a batch, (n, …); one arm is a batch of one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import require_number, spelt
from mmc_gym.agents.base import InternalModelAgent, Started, every, some, where
from mmc_gym.agents.body_model.body import Body, BodyEvidence
from mmc_gym.agents.body_model.contacts import Contacts
from mmc_gym.agents.body_model.drive import (
    Drive,
    command_of,
    commanded_turn,
    imagined_way,
    in_proportion,
    share_of_turn,
)
from mmc_gym.agents.body_model.imagination import (
    FOLLOW,
    NEAR,
    Arms,
    Imagination,
    LeastSquaresSolver,
    NetworkSolver,
    Solver,
    hand,
    within_reach,
)
from mmc_gym.agents.body_model.locks import PUSH, Locks
from mmc_gym.agents.body_model.senses import Bools, Delay, Points, PostureTrack, TargetTrack
from mmc_gym.agents.body_model.ways import Plan, Ways
from mmc_gym.agents.mmc import network_of_arm
from mmc_gym.interface import Observation, ReachInterface, Seen, Sensed
from mmc_gym.network import EuclideanNormalizer, LearnedNormalizer, MMCNetwork
from mmc_gym.network.chain import Floats, wrap_angle

LAG = 1.5
"""Control steps until the joints are where a command takes them."""
FARTHER = 0.3
"""A target that has moved by this is imagined anew, segment lengths."""
BACK = 0.3
"""Share by which arms that go round obstacles come back to their way in a control step."""
BETTER = 0.1
"""A newly imagined posture must be so much cheaper than the one that is followed, radians."""
CLEAR = 0.01
"""Noise of the joint angles below which the strength of joints shows, radians."""


@spelt
@dataclass(frozen=True)
class Parts:
    """Which parts an agent has, and how vigorous it is.

    Attributes:
        filters: whether noise is filtered, and the movement of a target foreseen.
        bridges_delay: whether the delay of the senses is estimated and bridged.
        identifies_body: whether lengths and a turned cursor are identified; else as told.
        finds_locks: whether locked joints are found.
        imagines: whether several models settle; else one, from the present posture.
        drives: whether the servos are inverted; else they are sent to the imagined posture.
        avoids: whether contacts are remembered, and ways round them imagined.
        vigour: 1 as fast as the servos allow, 0 as people move: slower, with a bell-shaped speed.

    Raises:
        UserError: for a vigour outside 0 to 1.
    """

    filters: bool = True
    bridges_delay: bool = True
    identifies_body: bool = True
    finds_locks: bool = True
    imagines: bool = True
    drives: bool = True
    avoids: bool = True
    vigour: float = 1.0

    def __post_init__(self) -> None:
        accepted = "a number between 0 and 1"
        require_number("vigour", self.vigour, accepted, lambda number: 0 <= number <= 1)


class BodyState(NamedTuple):
    """State of the agent: what each of its parts remembers.

    Attributes:
        looks: observations so far, (n, 1).
        posture, target, delay: of the senses.
        evidence: of the body.
        locks: of the joints.
        plan: where the arms go.
        imagined_for: the place of the hand for which it was imagined, (n,).
        drive: of the drive.
        contacts: of obstacles.
    """

    looks: Floats
    posture: PostureTrack
    target: TargetTrack
    delay: Delay
    evidence: BodyEvidence
    locks: Locks
    plan: Plan
    imagined_for: Points
    drive: Drive
    contacts: Contacts


class Intention(NamedTuple):
    """What an arm is to do.

    Attributes:
        joint_angles: where the joints are by now, radians, (n, N).
        plan: where they are to go.
        begins: whether a movement begins, (n,).
        changes: whether the plan is another one, of a movement that begins or goes on, (n,).
        aim: the place of the hand for which the movement was imagined, (n,).
    """

    joint_angles: Floats
    plan: Plan
    begins: Bools
    changes: Bools
    aim: Points


class BodyAgent(InternalModelAgent[BodyState]):
    """An agent with an internal model of its body, in parts, in a line."""

    def __init__(self, interface: ReachInterface, solver: Solver, parts: Parts = Parts()) -> None:
        """Make the agent; `solver` is its internal model.

        Raises:
            CannotActError: under torque control.
        """
        super().__init__(interface)
        self.parts = parts
        self.imagination = Imagination(interface, solver, parts.imagines)
        self.ways = Ways(self.imagination)

    @override
    def start(self, sensed: Sensed) -> BodyState:
        joint_angles, target = sensed.joint_angles, _point(sensed.target)
        still = np.zeros_like(joint_angles)
        return BodyState(
            looks=np.zeros((len(joint_angles), 1)),
            posture=PostureTrack.start(joint_angles, still),
            target=TargetTrack.start(target),
            delay=Delay.start(command_of(self.interface, joint_angles, joint_angles)),
            evidence=BodyEvidence.start(self.interface.segment_lengths, len(joint_angles)),
            locks=Locks.start(joint_angles),
            plan=Plan.start(joint_angles),
            imagined_for=target,
            drive=Drive.start(*joint_angles.shape),
            contacts=Contacts.start(*joint_angles.shape),
        )

    @override
    def predict(
        self,
        observation: Observation,
        state: BodyState | None = None,
        episode_start: Started = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], BodyState]:
        values = np.asarray(self.interface.layout.flatten(observation))
        batch = values.shape[:-1]
        seen = self.interface.see(values.reshape(-1, values.shape[-1]))
        state = self.resumed(state, seen, episode_start)
        state = self._sense(state, seen)
        state, body = self._know_body(state, seen)
        intended = self._imagine(state, body)
        joint_targets, state = self._drive(state, body, intended)
        action = self.interface.act(joint_targets, Sensed(intended.joint_angles, seen.target))
        return action.reshape(*batch, -1), state

    def _sense(self, state: BodyState, seen: Seen) -> BodyState:
        """Return the state after a look at posture and target."""
        looks, is_new = state.looks + 1, state.looks[:, 0] == 0
        has_new = some(is_new)
        if has_new and every(is_new):
            return state._replace(looks=looks)
        told, parts, step = self.interface, self.parts, self.interface.control_step
        before, place = state.posture, _point(seen.target)
        if parts.filters:
            posture = before.observed(seen.joint_angles, seen.joint_speeds, step)
            target = state.target.observed(place, step)
        else:
            turn = wrap_angle(seen.joint_angles - before.joint_angles)
            posture = before._replace(
                joint_angles=before.joint_angles + turn,
                turn=turn,
                speeds=seen.joint_speeds,
                age=before.age + 1,
            )
            jumps = np.abs(place - state.target.mean) > FARTHER
            target = state.target._replace(mean=place, has_jumped=jumps)
        delay, locks, contacts = state.delay, state.locks, state.contacts
        if parts.bridges_delay:
            delay = delay.observed(before, posture)
        asked = commanded_turn(told, before.joint_angles, delay.command_then())
        if parts.finds_locks:
            locks = locks.observed(
                posture,
                asked,
                delay.is_felt,
                lockable=told.lockable_joints,
                vigour=parts.vigour,
            )
        is_clear = (delay.late == 0) & (posture.deviation[:, 0] < CLEAR)
        drive = state.drive.observed(
            before.speeds,
            posture.speeds,
            posture.turn,
            is_clear=is_clear,
            recovers=target.is_moving,
            told=told,
        )
        if parts.avoids:
            lengths, counts = state.evidence.body.lengths, is_clear & ~locks.is_locked.any(axis=-1)
            contacts = contacts.observed(
                posture.joint_angles,
                posture.turn,
                before=before.turn,
                asked=asked,
                lengths=lengths,
                counts=counts,
            )
            drive = drive.recovered(contacts.is_new)
        after = state._replace(
            looks=looks,
            posture=posture,
            target=target,
            delay=delay,
            locks=locks,
            drive=drive,
            contacts=contacts,
        )
        return where(is_new, state._replace(looks=looks), after) if has_new else after

    def _know_body(self, state: BodyState, seen: Seen) -> tuple[BodyState, Body]:
        """Return the state after a look at the hand, and the body to go by."""
        if not self.parts.identifies_body:
            return state, state.evidence.body
        evidence = state.evidence.observed(seen.joint_angles, _point(seen.hand))
        return state._replace(evidence=evidence), evidence.best

    def _imagine(self, state: BodyState, body: Body) -> Intention:
        """Return where the joints are by now, and where they are to go."""
        told, locks, lengths = self.interface, state.locks, body.lengths
        now, goal = state.posture.joint_angles, state.plan.goal
        if some(state.delay.late):
            now = state.delay.run_forward(told, now)
        held = locks.is_locked if some(locks.is_locked) else None
        if held is not None:
            now = np.where(held, locks.place, now)
            goal = np.where(held, now, goal)
        seen = state.target.ahead(state.delay.late + LAG)
        aim = within_reach(body.felt(seen), lengths)

        misses = np.abs(hand(goal, lengths) - aim) > NEAR
        if some(misses):
            arms = Arms(goal, aim, lengths, held).of(misses)
            goal = goal.copy()
            goal[misses] = self.imagination.settle(arms, FOLLOW)
        begins = state.target.has_jumped | (state.looks[:, 0] == 1)
        begins |= state.contacts.is_new
        begins |= np.abs(aim - state.imagined_for) > FARTHER
        changes = begins | locks.has_changed.any(axis=-1)
        plan = state.plan.arrived(told, now)
        if some(changes):
            arms = Arms(now, aim, lengths, held)
            chosen = arms.of(changes)
            new, cost = self.imagination.best(chosen)
            kept = self.imagination.cost(chosen, goal[changes])
            goal = goal.copy()
            goal[changes] = np.where((cost < kept - BETTER)[:, None], new, goal[changes])
            plan = self.ways.planned(plan._replace(goal=goal), state.contacts, arms, changes)
        else:
            plan = plan._replace(goal=goal)
        is_second = plan.ahead < state.plan.ahead  # a leg of a way round
        imagined_for = np.where(changes | is_second, aim, state.imagined_for)
        return Intention(now, plan, begins | is_second, changes | is_second, imagined_for)

    def _straight(self, drive: Drive, intended: Intention) -> Floats:
        """Return by how much joints are to turn to go straight, as imagined, radians, (n, N)."""
        told, now, plan = self.interface, intended.joint_angles, intended.plan
        way = told.turn(plan.begin, plan.next)
        square = np.maximum((way * way).sum(axis=-1, keepdims=True), 1e-9)
        share = np.clip(((now - plan.begin) * way).sum(axis=-1, keepdims=True) / square, 0, 1)
        aside = plan.begin + share * way - now
        left = (1 - share) * way
        turn: Floats = in_proportion(drive.turn(left, 0.0, told), left) + BACK * aside
        return turn

    def _drive(self, state: BodyState, body: Body, intended: Intention) -> tuple[Floats, BodyState]:
        """Return joint targets, and the state after they were sent."""
        told, parts, drive, locks = self.interface, self.parts, state.drive, state.locks
        now, plan = intended.joint_angles, intended.plan
        left = told.turn(now, plan.next)
        joint_targets: Floats = now + left
        if parts.drives:
            moves: Floats | float = 0.0
            if some(state.target.is_moving):
                goes_on = state.target.is_moving & ~intended.changes & ~plan.is_indirect
                moves = np.where(goes_on[:, None], told.turn(state.plan.goal, plan.goal), 0.0)
            turn = drive.turn(left, moves, told)
            is_wary = state.contacts.met > 0
            if parts.vigour < 1:
                way = imagined_way(now, left, body.lengths)
                direct = np.abs(hand(plan.next, body.lengths) - hand(now, body.lengths))
                begins = intended.begins & ~state.target.is_moving  # which is followed, not reached
                drive = drive.began(begins, direct, left, told, parts.vigour)
                share = share_of_turn(way, drive.elapsed, drive.duration)[:, None]
                follows = state.target.is_moving & (drive.elapsed >= drive.duration)
                turn = np.where(follows[:, None], turn, in_proportion(turn, left * share))
            elif some(is_wary):
                turn = np.where(is_wary[:, None], self._straight(state.drive, intended), turn)
            noise = state.posture.deviation
            joint_targets, drive = drive.targets(now, turn, left, noise, told)
        if some(locks.is_locked):
            pushed = locks.place + PUSH * np.sign(locks.asked)
            joint_targets = np.where(locks.is_locked, pushed, joint_targets)
        command = command_of(told, now, joint_targets)
        return joint_targets, state._replace(
            delay=state.delay.sent(command, state.posture, told),
            drive=drive,
            plan=intended.plan,
            imagined_for=intended.aim,
        )


def _point(vectors: Floats) -> Points:
    """Return vectors (..., 2) as complex numbers, (...)."""
    points: Points = vectors.view(np.complex128)[..., 0]
    return points


def mmc_body(
    interface: ReachInterface,
    parts: Parts = Parts(),
    *,
    is_learned: bool = True,
    is_dynamic: bool = True,
) -> BodyAgent:
    """Return the agent whose internal model is the MMC network.

    Args:
        interface: of the environment.
        parts: of the agent.
        is_learned: whether the normalizer is the learned one, as in the paper; else Euclidean.
        is_dynamic: whether the network has velocities, as in the paper; else it is kinematic.
    """
    network = network_of_body(interface, is_learned=is_learned, is_dynamic=is_dynamic)
    return BodyAgent(interface, NetworkSolver(network), parts)


def network_of_body(
    interface: ReachInterface, *, is_learned: bool = True, is_dynamic: bool = True
) -> MMCNetwork:
    """Return the network that is the internal model of `mmc_body`."""
    joints = len(interface.segment_lengths)
    return network_of_arm(
        interface,
        damping=(0.55 if is_dynamic else 0.625) * (joints + 1),
        normalizer=LearnedNormalizer.shipped() if is_learned else EuclideanNormalizer(),
        dynamics="paper" if is_dynamic else "kinematic",
        velocity_damping=2.0,
    )


def ik_body(interface: ReachInterface, parts: Parts = Parts()) -> BodyAgent:
    """Return the agent whose internal model is damped least squares."""
    return BodyAgent(interface, LeastSquaresSolver(), parts)
