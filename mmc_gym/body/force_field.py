"""The impulse that a viscous field gives the hand in a physics step, implicitly.

A field F pushes the hand with F · (its velocity).  Its impulse p over a substep h is that of the
mean of the hand's velocity before and after the substep (the midpoint rule),

    p = h F (v + J z / 2),     M z = Jᵀ p − c,

where z are the changes of the joint speeds, so that (M − Jᵀ h F J / 2) z = Jᵀ h F v − c.  A field
across the velocity turns it and does no work.  The movement of the arm within a substep is
neglected.  At joint speeds of 0.5 rad/s a slack arm in a curl field of 120 keeps its energy for 2 s
to within 2 % in the median and 10 % at worst; in the strongest field that is accepted, 160
(`ArmParameters.strongest_field`), to within 4 % and 15 %.

v is the mean velocity if no joint changes its speed.  c are the impulses that inertia and gravity
then demand of the joints.  The velocities are those of the rods, which go straight on in a substep
and then close the pivots.  Only joints that yield change their speed: those whose servo gave its
largest torque a substep before.  What a servo holds moves as the servo wants, whatever the push.

The analytic engine computes the same in its kernel, from the mobility J M⁻¹ Jᵀ of the hand.
"""

from __future__ import annotations

import numpy as np

from mmc_gym.body.base import Floats
from mmc_gym.body.parameters import ArmParameters

_LEFT = np.array([-1.0, 1.0])  # (y, x) times this is (x, y) turned left by a right angle


class HandField:
    """The force field on the hand of an arm, or on the hands of many equal arms at once."""

    def __init__(self, parameters: ArmParameters) -> None:
        """Prepare for arms with these parameters; `force_field` must not be None."""
        count, lengths = len(parameters.segment_lengths), np.array(parameters.segment_lengths)
        masses, centres, inertias = np.array(parameters.rods).T
        self._half = parameters.substep / 2 * np.array(parameters.force_field)
        self._substep = parameters.substep
        self._fall = parameters.substep * np.array(parameters.gravity)
        # Row j: how far the centre of rod j moves along each segment.
        self._levers = np.tril(np.tile(lengths, (count, 1)), -1) + np.diag(centres)
        self._weighted = self._levers.T * masses
        self._products, self._inertias = self._weighted @ self._levers, np.diag(inertias)
        self._lengths, self._reach = lengths[:, None], lengths[-1] - centres[-1]
        # A joint turns all segments from its own on.
        self._turned, self._same = np.tril(np.ones((count, count))), np.eye(count)

    def impulses(self, motion: Floats, yields: Floats) -> Floats:
        """Return the impulse (x, y) on the hand, and its moment about the last segment's centre.

        Args:
            motion: of each segment before the substep: centre of gravity (x, y), angle, velocity of
                the centre (x, y) and angular velocity, (..., N, 6).
            yields: 1 for each joint that yields to a push, 0 for each that is held, (..., N).
        """
        centres, velocities, speeds = motion[..., :2], motion[..., 3:5], motion[..., 5:]
        angles = motion[..., 2:3] + self._substep * speeds
        along = np.concatenate([np.cos(angles), np.sin(angles)], axis=-1)
        across = along[..., ::-1] * _LEFT
        # Before the substep rods move on their own.  After it they are rigid rods on pivots, which
        # turn with `speeds`.  The sum of a rod's two velocities follows from where its centre gets.
        turning = speeds * across
        sums = (self._levers @ (along + self._substep * turning) - centres) / self._substep
        velocity = (sums[..., -1, :] + 2 * self._reach * turning[..., -1, :])[..., None]
        push = self._half @ velocity
        if yields.any():
            # M, c and J here are those of the segments; `turned` goes from joints to segments.
            jacobian = self._lengths * across
            masses = self._products * (along @ along.swapaxes(-1, -2)) + self._inertias
            loads = self._weighted @ (sums - 2 * velocities - self._fall)
            pushed = self._lengths * push.swapaxes(-1, -2) - loads
            right = (across * pushed).sum(axis=-1, keepdims=True)  # Jᵀ p − c with z = 0
            masses -= jacobian @ self._half @ jacobian.swapaxes(-1, -2)
            turned = self._turned * yields[..., None, :]
            back = turned.swapaxes(-1, -2)
            # A joint that is held has no equation but 1 · z = 0.
            held = self._same * (1 - yields)[..., None, :]
            changes = turned @ np.linalg.solve(back @ masses @ turned + held, back @ right)
            push = push + self._half @ (jacobian.swapaxes(-1, -2) @ changes)
        moment = self._reach * (across[..., -1:, :] @ push)
        return np.concatenate([push, moment], axis=-2)[..., 0]
