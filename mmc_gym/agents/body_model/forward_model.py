"""The forward model: where a posture takes the hand, and a command the joints.

In this folder arrays lead with n arms, each of N joints.  Joint angles, turns and segment lengths
are (n, N); angles are in radians, speeds in rad/s, times in control steps.  Points and vectors of
the plane are complex numbers x + iy, (n,), because multiplication rotates them.  Exceptions are
stated.

**Response.**  Of an interface with an `act` of its own no servo is known.  For each joint it is
fitted by least squares how the speed s′ of one control step follows from the speed s and the
action u of the step before,

    s′ = a s + b u + c.

Until a movement is seen, a = 1 and b = c = 0.  With the actions that were sent since, angles and
speeds that are seen late give those of now.  An action that is smaller by c / b undoes the push c.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.geometry import Floats, damped_least_squares
from mmc_gym.interface import ReachInterface

Points: TypeAlias = NDArray[np.complexfloating]
Bools: TypeAlias = NDArray[np.bool_]

RATE = 0.1  # rate at which running means follow what is seen, in a control step
FAST_RATE = 0.2  # that of means that must follow sooner
KEEP, KEEP_LONG = 0.95, 0.98  # shares of sums that are left after a control step
SMALL = 2e-3  # a difference that does not matter to reaching, radians or segment lengths
SAME = 1e-5  # resolution of what is seen (float32), radians or segment lengths
EXACT = 2 * 0.006**2  # negligible square error of the hand, segment lengths²
SIGMAS = 3.0  # number of standard deviations from which on an error is unlikely
BETTER, CLEARLY = 0.6, 0.25  # ratios of square errors at which a model is better, and clearly so
NOISE_OF_SPEEDS = 15.0  # what noise of the joint angles may add to speeds, 1/s
REST_TURN, WEAK = 0.004, 0.12  # a joint rests that turns by less, radians, or by a smaller share
JUMP = 0.15  # movement of a hand or target that is not steady, segment lengths

RESPONSE_RIDGE = np.diag([1e-6, 1e-6, 1e-3])  # weights of a = 1, b = 0 and c = 0
LEAST_EFFECT = 0.01  # square of b that is as good as none, (rad/s)²
STEADY = np.array([1.0, 0.0, 0.0])


def as_points(vectors: Floats) -> Points:
    """Return vectors (..., 2) as points, (...)."""
    return np.ascontiguousarray(vectors, np.float64).view(np.complex128)[..., 0]


def as_vectors(points: Points) -> Floats:
    """Return points (...) as vectors, (..., 2)."""
    return np.ascontiguousarray(points).view(np.float64).reshape(*points.shape, 2)


def squared(points: Points) -> Floats:
    """Return |z|²."""
    return points.real**2 + points.imag**2


def unit_vectors(joint_angles: Floats) -> Points:
    """Return the direction of each segment as a unit vector, (..., N)."""
    return np.exp(1j * np.add.accumulate(joint_angles, axis=-1))


def hand(joint_angles: Floats, lengths: Floats) -> Points:
    """Return the position of the hand, (...), for joint angles and lengths (..., N)."""
    return (lengths * unit_vectors(joint_angles)).sum(axis=-1)


def to_hand(joint_angles: Floats, lengths: Floats) -> Points:
    """Return the vectors from each joint to the hand, (..., N); the first is the hand itself."""
    segments = lengths * unit_vectors(joint_angles)
    return np.add.accumulate(segments[..., ::-1], axis=-1)[..., ::-1]


def pull_hand(levers: Points, error: Points, damping: float, held: Bools | None) -> Floats:
    """Return the turns (..., N) that move the hand by `error` (...); `held` joints do not turn."""
    if held is not None:
        levers = np.where(held, 0, levers)
    jacobian = np.swapaxes(as_vectors(1j * levers), -1, -2)
    return damped_least_squares(jacobian, as_vectors(error), damping)


def command_of(interface: ReachInterface, joint_angles: Floats, joint_targets: Floats) -> Floats:
    """Return the command that the servos get, (..., N).

    Under position control it is the target.  Under delta and velocity control it is the turn from
    the believed joint angles, so where a joint ends depends on its true angle.
    """
    if interface.control == "joint_position":
        return joint_targets
    return interface.turn(joint_angles, joint_targets)


def commanded_turn(interface: ReachInterface, joint_angles: Floats, commands: Floats) -> Floats:
    """Return how far commands turn joints in a control step, radians, (..., N).

    The speed of a position servo is proportional to the angle left, up to a limit.  In a control
    step Δt it turns a joint at q with the target c by about

        Δq = clip((1 − exp(−gain Δt)) (c − q), ±speed_limit Δt).

    Inertia and torque limits are left out, so a heavy or loaded arm lags behind.  Under
    `joint_delta` a target is never far ahead, so joints stay below full speed.  Under
    `joint_velocity` a joint keeps one speed during the step.

    >>> interface = ReachInterface((1.0, 1.0), "joint_position", 6.0, 12.0, 0.02)
    >>> commanded_turn(interface, np.zeros(2), np.array([0.1, 2.0])).round(3).tolist()
    [0.021, 0.12]
    """
    part, left, most = turn_share(interface), commands, interface.max_joint_delta
    if interface.control == "joint_position":
        left = interface.turn(joint_angles, commands)
        most = interface.speed_limit * interface.control_step / part
    return part * bounded(left, most)


def turn_share(interface: ReachInterface) -> float:
    """Return the share of the angle left that a servo turns a joint in a control step."""
    gain, step = interface.servo_gain, interface.control_step
    return gain * step if interface.control == "joint_velocity" else 1 - math.exp(-gain * step)


def full_turn(interface: ReachInterface) -> float:
    """Return how far a joint turns in a control step at full speed, radians."""
    return interface.speed_limit * interface.control_step


def turn_by_speeds(before: Floats, after: Floats, control_step: float) -> Floats:
    """Return how far joints turn in a control step, radians, from their speeds before and after."""
    turn: Floats = control_step / 2 * (before + after)
    return turn


def error_of_turn(before: Floats, after: Floats, control_step: float) -> Floats:
    """Return the largest error of `turn_by_speeds`, radians: the speed may change at any time."""
    error: Floats = control_step / 2 * np.abs(after - before)
    return error


def bounded(values: Floats, most: float | Floats) -> Floats:
    """Return values clipped to ±most: np.clip takes twice as long for few arms."""
    return np.minimum(np.maximum(values, -most), most)


class Response(NamedTuple):
    """What was seen of the response of n arms with N joints."""

    actions: Floats  # those sent, the latest last, (n, longest delay + 1, N)
    squares: Floats  # Σ x xᵀ of x = (s, u, 1), (n, N, 3, 3)
    products: Floats  # Σ x (s′ − s), (n, N, 3)

    @classmethod
    def start(cls, arms: int, joints: int, longest: int) -> Response:
        """Return the response before any action."""
        actions, sums = np.zeros((arms, longest + 1, joints)), np.zeros((arms, joints, 3))
        return cls(actions, np.zeros((*sums.shape, 3)), sums)

    def observe(self, before: Floats, speeds: Floats, late: Floats, counts: Bools) -> Response:
        """Return it after speeds were seen, `late` control steps (n,); joints (n, N) count."""
        steps, arms = late.astype(np.intp), np.arange(len(late))
        x = np.stack([before, self.actions[arms, -1 - steps], np.ones_like(before)], axis=-1)
        x *= counts[..., None]
        squares = self.squares + x[..., :, None] * x[..., None, :]
        products = self.products + x * (speeds - before)[..., None]
        return self._replace(squares=squares, products=products)

    @property
    def fit(self) -> Floats:
        """a, b and c of each joint, three arrays (n, N)."""
        change = np.linalg.solve(self.squares + RESPONSE_RIDGE, self.products[..., None])
        return np.moveaxis(STEADY + change[..., 0], -1, 0)

    def send(self, action: NDArray[Any], undoes: bool) -> tuple[NDArray[Any], Response]:
        """Return actions, and the response after they are sent, if there is one for each joint.

        If it `undoes` pushes, they are other than these actions, but within ±1 if these are.
        """
        if np.shape(action) != self.actions[:, 0].shape:
            return action, self
        if undoes:
            _, gain, push = self.fit
            undone = action - gain * push / (gain * gain + LEAST_EFFECT)
            largest = np.maximum(1.0, np.abs(action).max(axis=-1, keepdims=True))
            action = bounded(undone, largest).astype(action.dtype)
        actions = np.concatenate([self.actions[:, 1:], action[:, None]], axis=1)
        return action, self._replace(actions=actions)

    def run_forward(
        self, joint_angles: Floats, speeds: Floats, late: Floats, control_step: float
    ) -> tuple[Floats, Floats]:
        """Return joint angles and speeds of now, from those of `late` control steps, (n,), ago."""
        keep, gain, push = self.fit
        for back in range(int(late.max()), 0, -1):
            is_due = (back <= late)[:, None]
            after = keep * speeds + gain * self.actions[:, -back] + push
            after = np.where(is_due, after, speeds)
            turn = np.where(is_due, turn_by_speeds(speeds, after, control_step), 0.0)
            joint_angles, speeds = joint_angles + turn, after
        return joint_angles, speeds
