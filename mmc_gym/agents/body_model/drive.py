"""Drive: what is to be asked of the servos, so that joints turn as they are meant to.

**Model.**  A position servo asks for a speed proportional to what is left, up to its limit.  So in
a control step Δt a joint at q that is sent to c turns by about

    Δq = clip((1 − exp(−gain Δt)) (c − q), ±speed_limit Δt).

**Inverse.**  To turn by Δq, it is sent to q + Δq / (1 − exp(−gain Δt)).  With the way d left, a
joint that can brake with the acceleration a is to have the speed

    v = min(speed_limit, √(2 η a |d|), k |d|),        η < 1 for what the model leaves out,

beside that of a goal that moves, and Δq = v Δt.  How much a is, a joint shows when it is asked for
more than it can do.

**Vigour.**  Where that fast drive would go, people take their time, and the speed of their hand is
bell-shaped.  At a vigour below 1 a movement is given 1 − vigour of the time T that a person would
take, and its hand covers the way as minimum jerk would, by the time base of `network.time_base`: in
the k-th control step it goes the share σ_k of what is left of the imagined way.  A lock that is
found changes the way, but not the time: to begin anew would be to stop first.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import some
from mmc_gym.interface import ReachInterface
from mmc_gym.network.chain import Floats
from mmc_gym.network.time_base import share

Bools: TypeAlias = NDArray[np.bool_]

BRAKE = 0.6
"""η: share of a joint's acceleration that the drive counts on."""
GAIN = 30.0
"""k: speed for the way left, 1/s."""
STRONGEST, WEAKEST = 60.0, 2.0
"""Acceleration that joints are taken to have at first, and least, rad/s²."""
SHORT = 0.3
"""A joint that lacks more of the speed asked of it does what it can, rad/s."""
LEARNED, RISEN, RECOVERED = 0.4, 0.1, 0.03
"""Shares by which the acceleration follows what a joint shows; by which it rises, for other joints
may have helped; and by which it comes back."""

FULL = 0.8
"""A joint that is sent so far ahead is at full speed throughout a control step, radians."""
LONGEST = 3.0
"""No joint is sent farther ahead, radians: half a turn ahead is half a turn back."""

SHORTEST = 0.2
"""Duration of a human-like movement that has nowhere to go, s."""
AVERAGE_SPEED = 4.0
"""Growth of the way with the duration, segment lengths/s."""
PEAK = 15 / 8
"""Highest over mean speed of minimum jerk."""
SAMPLES = np.linspace(0.0, 1.0, 9)
"""Shares of a movement at which the hand is imagined, to measure its way."""


def expected_turn(interface: ReachInterface, joint_angles: Floats, joint_targets: Floats) -> Floats:
    """Return by how much servos turn joints towards targets in a control step, radians, (..., N).

    They go the short way round, or the way that joint limits leave.  Inertia and torque limits are
    left out: an arm that is heavy, or loaded, lags behind this.  Under `joint_delta` the target is
    never far ahead, and at full speed a joint turns by less; under `joint_velocity` it keeps the
    speed that it began the step with.

    >>> interface = ReachInterface((1.0, 1.0), "joint_position", 6.0, 12.0, 0.02)
    >>> expected_turn(interface, np.zeros(2), np.array([0.1, 2.0])).round(3).tolist()
    [0.021, 0.12]
    """
    return _turn_of(interface, interface.turn(joint_angles, joint_targets))


def command_of(interface: ReachInterface, joint_angles: Floats, joint_targets: Floats) -> Floats:
    """Return what servos get that are to turn joints, believed to be at these angles, to targets.

    Position control gets the targets.  Delta and velocity control get the turn that is left, and
    know nothing of the target: where they turn a joint to depends on where it is, not on where it
    was believed to be.
    """
    if interface.control == "joint_position":
        return joint_targets
    return interface.turn(joint_angles, joint_targets)


def commanded_turn(interface: ReachInterface, joint_angles: Floats, commands: Floats) -> Floats:
    """Return by how much servos with these commands turn joints in a control step, (..., N)."""
    if interface.control == "joint_position":
        return expected_turn(interface, joint_angles, commands)
    return _turn_of(interface, commands)


def _turn_of(interface: ReachInterface, left: Floats) -> Floats:
    """Return the turn in a control step of joints that are to turn by what is left, (..., N)."""
    most = interface.max_joint_delta
    if interface.control == "joint_position":
        most = interface.speed_limit * interface.control_step / _turn_share(interface)
    return _turn_share(interface) * _bounded(left, most)


def _bounded(values: Floats, most: float) -> Floats:
    """Return values between ±most: np.clip takes twice as long for few arms."""
    bounded: Floats = np.minimum(np.maximum(values, -most), most)
    return bounded


def _turn_share(interface: ReachInterface) -> float:
    """Return the share of the angle asked for that a servo turns a joint in a control step."""
    gain, step = interface.servo_gain, interface.control_step
    return gain * step if interface.control == "joint_velocity" else 1 - math.exp(-gain * step)


class Drive(NamedTuple):
    """The memory of the drive.

    Attributes:
        acceleration: a, rad/s², (n, N).
        lead: by how much joints were sent ahead last, radians, (n, N).
        elapsed: control steps since the movement began, (n,).
        duration: T (1 − vigour), control steps, (n,).
    """

    acceleration: Floats
    lead: Floats
    elapsed: Floats
    duration: Floats

    @classmethod
    def start(cls, arms: int, joints: int) -> Drive:
        """Return the memory of arms that have not moved."""
        still, zero = np.zeros((arms, joints)), np.zeros(arms)
        return cls(np.full_like(still, STRONGEST), still, zero, zero)

    def observed(
        self,
        before: Floats,
        speeds: Floats,
        turn: Floats,
        *,
        is_clear: Bools,
        recovers: Bools,
        told: ReachInterface,
    ) -> Drive:
        """Return the memory after another look at the joints.

        Args:
            before: speeds of the joints at the last look, rad/s, (n, N).
            speeds: of the joints, rad/s, (n, N).
            turn: by how much they turned since the last look, radians, (n, N).
            is_clear: whether they are seen in time and without noise, (n,).
            recovers: whether joints that can do more would show it, (n,).
            told: of the arm.
        """
        gain, most = told.servo_gain, told.speed_limit
        lacked = _bounded(gain * self.lead, most) - before
        lacks = _bounded(gain * (self.lead - turn), most) - speeds
        saturates = (np.minimum(np.abs(lacked), np.abs(lacks)) > SHORT) & is_clear[:, None]
        if not some(saturates) and not some(recovers):
            return self
        gained = (speeds - before) * np.sign(lacked) / told.control_step
        old = self.acceleration
        shown = np.clip(gained, WEAKEST, STRONGEST) - old
        shown = old + np.where(shown > 0, RISEN, LEARNED) * shown
        idle = old + RECOVERED * recovers[:, None] * (STRONGEST - old)
        return self._replace(acceleration=np.where(saturates, shown, idle))

    def recovered(self, arms: Bools) -> Drive:
        """Return the memory in which joints of some arms (n,) are as strong as at first."""
        if not some(arms):
            return self
        return self._replace(acceleration=np.where(arms[:, None], STRONGEST, self.acceleration))

    def began(
        self, begins: Bools, way: Floats, left: Floats, told: ReachInterface, vigour: float
    ) -> Drive:
        """Return the memory a control step later, with a new movement where one begins.

        Args:
            begins: whether one does, (n,).
            way: of the hand, segment lengths, (n,).
            left: what the joints are to turn, radians, (n, N).
            told: of the arm.
            vigour: below 1.
        """
        farthest = np.abs(left).max(axis=-1)
        human = np.maximum(SHORTEST + way / AVERAGE_SPEED, PEAK * farthest / told.speed_limit)
        duration = np.ceil((1 - vigour) * human / told.control_step - 1e-9)
        return self._replace(
            elapsed=np.where(begins, 0.0, self.elapsed + 1),
            duration=np.where(begins, duration, self.duration),
        )

    def turn(self, left: Floats, moves: Floats | float, told: ReachInterface) -> Floats:
        """Return by how much joints are to turn now at most, radians, (n, N).

        Args:
            left: to the goal, radians, (n, N).
            moves: by how much the goal moves in a control step, radians, (n, N), or 0.
            told: of the arm.
        """
        step = told.control_step
        behind = left - moves
        size = np.abs(behind)
        turn = step * np.sqrt((2 * BRAKE) * self.acceleration * size)
        turn = np.minimum(turn, min(GAIN * step, 1.0) * size)
        turn = np.minimum(turn, told.speed_limit * step)
        return _bounded(moves + np.copysign(turn, behind), told.speed_limit * step)

    def targets(
        self, joint_angles: Floats, turn: Floats, left: Floats, noise: Floats, told: ReachInterface
    ) -> tuple[Floats, Drive]:
        """Return joint targets that make joints turn so, radians, (n, N), and the memory.

        What is left may be no more than noise.  Then the servos are left to themselves: undoing
        noise within a control step would be to follow it.

        Args:
            joint_angles: where the joints are, radians, (n, N).
            turn: by how much they are to turn in this control step, radians, (n, N).
            left: what is left to the goal, radians, (n, N).
            noise: standard deviation of the joint angles, radians, (n, 1).
            told: of the arm.
        """
        full = 0.97 * told.speed_limit * told.control_step
        lead = np.where(np.abs(turn) > full, np.sign(turn) * FULL, turn / _turn_share(told))
        if some(noise):
            square = left * left
            trust = square / (square + (3 * noise) ** 2 + 1e-12)
            lead = left + trust * (lead - left)
        lead = _bounded(lead, LONGEST)
        return joint_angles + lead, self._replace(lead=lead)


def in_proportion(turn: Floats, way: Floats) -> Floats:
    """Return turns along a way, radians, (n, N), of which no joint turns by more than `turn`."""
    size = np.abs(way)
    part = np.divide(np.abs(turn), size, out=np.ones_like(size), where=size > 1e-9)
    along: Floats = way * np.minimum(part.min(axis=-1, keepdims=True), 1.0)
    return along


def imagined_way(joint_angles: Floats, left: Floats, lengths: Floats) -> Floats:
    """Return how far the hand has come at each of `SAMPLES` of a movement, (n, SAMPLES).

    The joints turn together, from these angles (n, N) by what is left (n, N).
    """
    along = joint_angles[:, None] + SAMPLES[:, None] * left[:, None]
    hands = (lengths[:, None] * np.exp(1j * np.cumsum(along, axis=-1))).sum(axis=-1)
    steps = np.abs(np.diff(hands, axis=-1))
    return np.concatenate([np.zeros((len(steps), 1)), np.cumsum(steps, axis=-1)], axis=-1)


def share_of_turn(way: Floats, elapsed: Floats, duration: Floats) -> Floats:
    """Return the share of a movement after which the hand has come as far as minimum jerk, (n,).

    Args:
        way: see `imagined_way`, (n, SAMPLES).
        elapsed: control steps since it began, (n,).
        duration: control steps that it takes, (n,).
    """
    wanted = share(elapsed + 1, np.maximum(duration, 1e-9)) * way[:, -1]
    arms, last = np.arange(len(way)), len(SAMPLES) - 2
    before = np.minimum((way[:, 1:] < wanted[:, None]).sum(axis=-1), last)
    step = way[arms, before + 1] - way[arms, before]
    part = (wanted - way[arms, before]) / np.maximum(step, 1e-9)
    result: Floats = (before + np.clip(part, 0.0, 1.0)) / (last + 1)
    return result
