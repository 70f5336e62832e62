"""The impulse that a viscous field gives the hand in a physics step, implicitly.

A field F pushes the hand with F · (its velocity).  Its impulse p over a substep h is that of the
mean of the hand's velocity before and after the substep (the midpoint rule),

    p = h F (v + Λ p / 2),     Λ = J M⁻¹ Jᵀ the mobility of the hand,

so that a field across the velocity turns it and does no work.  The way of the arm within a substep
is neglected.  At joint speeds of 0.5 rad/s a slack arm in a curl field of 120 keeps its energy for
2 s to within 2 % in the median and 10 % at worst; at 500 it may gain several times as much.

v is the mean velocity without the field.  Without it the joint speeds would become q̇ − M⁻¹ c,
where c are the impulses that inertia and gravity demand of the joints.  The velocities are those of
the rods, which go straight on in a substep and then close the pivots.  M is inverted over the
joints that yield: those whose servo gave its largest torque a substep before.  What a servo holds
moves as the servo wants, whatever the push.

The analytic engine computes the same in its kernel.
"""

from __future__ import annotations

import numpy as np

from mmc_gym.body.base import Floats
from mmc_gym.body.parameters import ArmParameters

_LEFT = np.array([-1.0, 1.0])  # (y, x) times this is (x, y) turned left by a right angle


class HandField:
    """The force field of an arm, acting on its hand; or on the hands of many equal arms at once."""

    def __init__(self, parameters: ArmParameters) -> None:
        """Prepare for arms with these parameters, which have a force field."""
        count, lengths = len(parameters.segment_lengths), np.array(parameters.segment_lengths)
        masses, centres, inertias = np.array(parameters.rods).T
        self._half = parameters.substep / 2 * np.array(parameters.force_field)
        self._substep, self._gravity = parameters.substep, np.array(parameters.gravity)
        # Row j: how far the centre of rod j moves along each segment.
        self._levers = np.tril(np.tile(lengths, (count, 1)), -1) + np.diag(centres)
        self._weighted = self._levers.T * masses
        self._products, self._inertias = self._weighted @ self._levers, np.diag(inertias)
        self._lengths, self._reach = lengths[:, None], lengths[-1] - centres[-1]
        # A joint turns all segments from its own on: sums of these are what acts on the joint.
        self._from_here_on, self._same = np.triu(np.ones((count, count))), np.eye(count)

    def impulses(self, motion: Floats, yields: Floats) -> Floats:
        """Return the impulse (x, y) on the hand, and its moment about the last segment's centre.

        Args:
            motion: of the segments before the substep: centre of gravity (x, y), angle, velocity of
                the centre (x, y) and angular velocity, (..., N, 6).
            yields: 1 for each joint that gives way to a push, 0 for one that is held, (..., N).

        Returns:
            Impulse and moment, (..., 3).
        """
        centres, velocities, speeds = motion[..., :2], motion[..., 3:5], motion[..., 5:]
        angles = motion[..., 2:3] + self._substep * speeds
        along = np.concatenate([np.cos(angles), np.sin(angles)], axis=-1)
        across = along[..., ::-1] * _LEFT
        # Before the substep rods move on their own.  After it they are rigid rods on pivots: they
        # turn with `speeds`, and `closing` takes them from where they were to their pivots.
        turning = speeds * across
        closing = (self._levers @ along - centres) / self._substep
        velocity = closing[..., -1, :] + self._reach * turning[..., -1, :]
        velocity = (velocity + self._lengths[:, 0] @ turning)[..., None]  # twice the mean
        if yields.any():
            changes = self._levers @ turning + closing - 2 * velocities
            changes -= self._substep * self._gravity
            mobility, lost = self._give_way(along, across, changes, yields)
            push = np.linalg.solve(
                np.eye(2) - self._half @ mobility, self._half @ (velocity - lost)
            )
        else:
            push = self._half @ velocity
        moment = self._reach * (across[..., -1:, :] @ push)
        return np.concatenate([push, moment], axis=-2)[..., 0]

    def _give_way(
        self, along: Floats, across: Floats, changes: Floats, yields: Floats
    ) -> tuple[Floats, Floats]:
        """Return the mobility Λ of the hand, (..., 2, 2), and the velocity J M⁻¹ c, (..., 2, 1).

        Args:
            along: directions of the segments, (..., N, 2).
            across: directions in which their ends move, (..., N, 2).
            changes: of the velocities of the rods' centres, if no joint changes its speed,
                (..., N, 2).
            yields: as for `impulses`.
        """
        weights = self._products * (along @ along.swapaxes(-1, -2)) + self._inertias
        masses = self._from_here_on @ weights @ self._from_here_on.T
        # A joint that is held has no equation but 1 · 0 = 0.
        row, column = yields[..., :, None], yields[..., None, :]
        masses = row * masses * column + (1 - row) * self._same
        sides = [self._lengths * across, across * (self._weighted @ changes)]
        right = row * (self._from_here_on @ np.concatenate(sides, axis=-1))  # J, and c in two parts
        solved = right[..., :2].swapaxes(-1, -2) @ np.linalg.solve(masses, right)
        return solved[..., :2], solved[..., 2:3] + solved[..., 3:]
