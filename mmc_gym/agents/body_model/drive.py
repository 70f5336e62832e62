"""Drive: joint targets that make the servos turn the joints as wanted.

**Inverse.**  By the model of `commanded_turn`, the target q + Δq / (1 − exp(−gain Δt)) turns a
joint at q by Δq.  A joint that has the angle d left, and can brake with the acceleration a, should
move with the speed

    v = min(speed_limit, √(2 η a |d|), k |d|),        η < 1 for what the model leaves out,

relative to its goal, which may move, so Δq = v Δt.  The acceleration a is estimated whenever a
joint cannot follow its command.

**Vigour.**  People move more slowly, and the speed of their hand is bell-shaped.  At a vigour below
1 a movement takes 1 − vigour of the time T that a person would take.  Its hand covers the way as in
minimum jerk, with the time base of `network.time_base`: in the k-th control step it covers the
share σ_k of what is left of the imagined way.  A lock that is identified on the way changes the
way, but not the duration, because a new movement would begin with a stop.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mmc_gym.agents.base import any_true
from mmc_gym.agents.body_model.forward_model import (
    FAST_RATE,
    SIGMAS,
    Bools,
    bounded,
    full_turn,
    hand,
    turn_share,
)
from mmc_gym.agents.body_model.motors import Motors
from mmc_gym.agents.body_model.senses import LastStep
from mmc_gym.agents.planners import AVERAGE_SPEED, BASE_DURATION
from mmc_gym.geometry import Floats
from mmc_gym.interface import ReachInterface
from mmc_gym.network.time_base import share

BRAKE = 0.6  # η: share of a joint's acceleration that the drive counts on
GAIN = 30.0  # k: speed per angle left, 1/s
STRONGEST, WEAKEST = 60.0, 2.0  # first and least estimate of the acceleration of joints, rad/s²
LACKED_SPEED = 0.3  # a joint that lacks more of its commanded speed does what it can, rad/s
FALL_RATE, RISE_RATE = 0.4, 0.05  # rates of the estimate
FULL_LEAD = 0.8  # a target this far ahead keeps a joint at full speed for a control step, radians
LARGEST_LEAD = 3.0  # the farthest target ahead, radians: half a turn ahead is half a turn back

PEAK = 15 / 8  # ratio of highest and mean speed in minimum jerk
SAMPLES = np.linspace(0.0, 1.0, 9)  # shares of a movement at which its way is measured


class Drive(NamedTuple):
    """What the drive remembers of n arms with N joints, and of their present movement."""

    acceleration: Floats  # a, as estimated, rad/s², (n, N)
    lead: Floats  # how far ahead of the joints their last targets were
    elapsed: Floats  # control steps since the movement began, (n,)
    duration: Floats  # T (1 − vigour), (n,)

    @classmethod
    def start(cls, arms: int, joints: int) -> Drive:
        """Return the memory of arms that have not moved."""
        still, zero = np.zeros((arms, joints)), np.zeros(arms)
        return cls(np.full_like(still, STRONGEST), lead=still, elapsed=zero, duration=zero)

    def estimate_acceleration(
        self, step: LastStep, interface: ReachInterface, motors: Motors
    ) -> Drive:
        """Return the drive with its estimate of joints' accelerations after a control step.

        Only joints that lack much of their commanded speed show how fast they can accelerate: more
        than noise of their angles asks for.  Another cause may help a joint to accelerate.  Where
        one slows down whose motor is not as given, the command may be lost, and the estimate falls
        by `FAST_RATE`.
        """
        before, posture = step.before, step.after
        gain, limit, speeds = interface.servo_gain, interface.speed_limit, posture.speeds
        lacked = bounded(gain * self.lead, limit) - before.speeds
        lacks = bounded(gain * (self.lead - posture.turn), limit) - speeds
        if any_true(motors.is_learned):
            speed = step.commanded / interface.control_step
            lacked = np.where(motors.is_learned, speed - before.speeds, lacked)
            lacks = np.where(motors.is_learned, speed - speeds, lacks)
        least = LACKED_SPEED + gain * posture.deviation
        saturates = np.minimum(np.abs(lacked), np.abs(lacks)) > least
        saturates &= step.is_timely[:, None]
        if not any_true(saturates):
            return self
        saturates &= (np.abs(speeds) > LACKED_SPEED) | ~motors.differ  # a motor may not move it
        old = self.acceleration
        shown = (speeds - before.speeds) * np.sign(lacked) / interface.control_step
        change = np.clip(shown, WEAKEST, STRONGEST) - old
        fall = np.where(motors.differ & (shown < 0), FAST_RATE, FALL_RATE)
        rate = np.where(change > 0, RISE_RATE, fall)
        estimate = old + rate * change
        return self._replace(acceleration=np.where(saturates, estimate, old))

    def turn(self, left: Floats, goal_turn: Floats, interface: ReachInterface) -> Floats:
        """Return the turns in a control step to a goal `left` away that turns by `goal_turn`."""
        step = interface.control_step
        behind = left - goal_turn
        size = np.abs(behind)
        turn = step * np.sqrt((2 * BRAKE) * self.acceleration * size)
        turn = np.minimum(turn, min(GAIN * step, 1.0) * size)
        turn = np.minimum(turn, interface.speed_limit * step)
        return bounded(goal_turn + np.copysign(turn, behind), interface.speed_limit * step)

    def straight(
        self, begin: Floats, joint_angles: Floats, end: Floats, interface: ReachInterface
    ) -> Floats:
        """Return turns on, or back to, a straight way, at whose end all joints arrive together."""
        way = interface.turn(begin, end)
        along = ((joint_angles - begin) * way).sum(axis=-1, keepdims=True)
        square = (way * way).sum(axis=-1, keepdims=True)
        done = np.clip(along / np.maximum(square, 1e-9), 0, 1)
        aside = begin + done * way - joint_angles
        left = (1 - done) * way
        turn = self.turn(left, np.zeros_like(left), interface)
        return in_proportion(turn, left) + FAST_RATE * aside

    def time(
        self, begins: Bools, way: Floats, left: Floats, interface: ReachInterface, vigour: float
    ) -> Drive:
        """Count a control step, and set the duration of movements that begin.

        It depends on the straight way of the hand to its goal, (n,), and on the angles left.
        """
        human = BASE_DURATION + way / AVERAGE_SPEED
        human = np.maximum(human, PEAK * np.abs(left).max(axis=-1) / interface.speed_limit)
        duration = np.ceil((1 - vigour) * human / interface.control_step - 1e-9)
        return self._replace(
            elapsed=np.where(begins, 0.0, self.elapsed + 1),
            duration=np.where(begins, duration, self.duration),
        )

    def share_of_turn(self, joint_angles: Floats, left: Floats, lengths: Floats) -> Floats:
        """Return the share of the turn left at which the hand is as far as minimum jerk, (n,)."""
        postures = joint_angles[:, None] + SAMPLES[:, None] * left[:, None]
        steps = np.abs(np.diff(hand(postures, lengths[:, None]), axis=-1))
        way = np.concatenate([np.zeros((len(steps), 1)), np.cumsum(steps, axis=-1)], axis=-1)
        covered = share(self.elapsed + 1, np.maximum(self.duration, 1e-9)) * way[:, -1]
        arms, last = np.arange(len(way)), len(SAMPLES) - 2
        before = np.minimum((way[:, 1:] < covered[:, None]).sum(axis=-1), last)
        step = way[arms, before + 1] - way[arms, before]
        part = (covered - way[arms, before]) / np.maximum(step, 1e-9)
        return (before + np.clip(part, 0.0, 1.0)) / (last + 1)

    def invert_servos(
        self,
        turn: Floats,
        left: Floats,
        noise: Floats,
        interface: ReachInterface,
        motors: Motors,
        before: Floats,
    ) -> Floats:
        """Return how far ahead of the joints targets turn them by `turn`.

        Where the angle left may be mere noise (of this standard deviation, (n, N)), the target is
        the goal itself, because a servo that undoes noise in a control step follows the noise.
        """
        full = 0.97 * interface.speed_limit * interface.control_step
        lead = turn / turn_share(interface)
        lead = np.where(np.abs(turn) > full, np.sign(turn) * FULL_LEAD, lead)
        if any_true(noise):
            square = left * left
            trust = square / (square + (SIGMAS * noise) ** 2 + 1e-12)
            lead = np.where(noise > 0, left + trust * (lead - left), lead)
        if any_true(motors.is_learned):
            unit, part = full_turn(interface), turn_share(interface)
            if any_true(noise):
                turn = np.where(noise > 0, part * left + trust * (turn - part * left), turn)
            lead = np.where(motors.is_learned, motors.inverse(turn, before, unit) / part, lead)
        return lead

    def send(self, lead: Floats, interface: ReachInterface) -> Drive:
        """Return the drive after targets were sent that are so far ahead, as far as allowed."""
        is_limited = interface.control != "joint_position"  # the action is a lead, at most this one
        most = interface.max_joint_delta if is_limited else LARGEST_LEAD
        return self._replace(lead=bounded(lead, most))


def in_proportion(turn: Floats, way: Floats) -> Floats:
    """Return the longest turns along `way` in which no joint exceeds `turn`."""
    size = np.abs(way)
    part = np.divide(np.abs(turn), size, out=np.ones_like(size), where=size > 1e-9)
    return way * np.minimum(part.min(axis=-1, keepdims=True), 1.0)
