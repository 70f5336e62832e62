"""Regulator: the best commands near the target, by what commands have lately done.

**Estimate.**  Before a control step joints have the speeds v.  A command asks them to turn by u, as
by `commanded_turn`; the one before asked for u₋.  They turn by t, and then have the speeds v′.  All
are in full turns, speeds in full turns in a control step:

    x = (1, v, u₋, u),     v′ = A x,     t = T x

Strength, lag, pushes, loads, and joints that move each other are all in A and T.  They follow by
recursive least squares that forget.  All joints have the same regressors x, so one matrix of sums
serves all,

    S = Σ λ^k x xᵀ,     R = Σ λ^k x (v′ − A₀ x, t − T₀ x)ᵀ
    (A, T)ᵀ = (A₀, T₀)ᵀ + (S + Λ)⁻¹ R

with k the age of a control step, and A₀ and T₀ of the given servo.  What is learned far from the
target, where torque is at its limit, fades by λ in a control step.

**Command.**  Let joints have the angles d left to their goals, and J be the Jacobian of the hand.
With z = (d, 1, v, u₋) and z′ = F z + B u the linear-quadratic regulator minimises the sum of

    |J d|² + ε |d|² + ρ |u − u₋|²

over all control steps to come; speeds and turns are relative to those of the goals.  So what does
not move the hand is corrected less (Todorov & Jordan 2002).  Changes of the command cost, not its
size, so a steady push leaves no steady error.  P, the cost to come as a quadratic form in z, begins
as the identity, and gets one step of Riccati's equation whenever the regulator commands.  Q and C
are the parts of the cost in z alone, and between u and z:

    K = (ρ + BᵀP B)⁻¹ (BᵀP F + C),     P ← Q + FᵀP F − (BᵀP F + C)ᵀ K
    u = −K z

**Caution.**  Noise that adds to commands needs none.  But where commands are lost, held or
repeated, the error r of a joint's turn grows with the change of its command,

    E r² = σ² + κ (u − u₋)²

Such noise adds κ p to the cost ρ of the change, where p is the entry of P for the angle left of the
joint (Todorov 2005).  κ follows by regression over the last control steps, less its standard error.

Literature: Todorov & Jordan (2002), Nat. Neurosci. 5, 1226–1235.  Todorov (2005), Neural Comput.
17, 1084–1108.  Anderson & Moore (1990), Optimal control: linear quadratic methods.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from mmc_gym.agents.base import any_true
from mmc_gym.agents.body_model.forward_model import KEEP, KEEP_LONG, Bools
from mmc_gym.agents.body_model.motors import Motors
from mmc_gym.geometry import Floats

# What the given servo makes of v and of u, as shares in v′ and in t: A₀ and T₀.
GIVEN_OF_SPEED, GIVEN_OF_COMMAND = (0.19, 0.3), (0.77, 0.65)
RIDGE = 0.1  # Λ, in full turns squared
LEAST = 1e-9  # spread of the changes that is as good as none, full turns⁴
SHOWN = 0.7  # share of the changes of a turn lately seen that a motor can make again
SMOOTH = 0.05  # ρ where κ is 0, segment lengths²
POSTURE = 0.1  # ε, segment lengths²
NEAR = 7.0  # control steps in which a joint at rest could gain the angle left as its turn


def regulates(left: Floats, strength: Floats, motors: Motors, is_locked: Bools) -> Bools:
    """Return which arms, (n,), have motors unlike the given servo, and are near their goals.

    Joints have the angles `left` to these, and can change their turn in a control step by
    `strength`, as far as is known, both in full turns, (n, N).  Noise of commands and loose gears
    look like weak motors, so what joints were seen to do counts, too.
    """
    differs = motors.clearly_differ
    if not any_true(differs):
        return differs
    strength = np.maximum(strength, SHOWN * motors.shown_change)
    is_near = np.abs(left) < NEAR * strength
    acts: Bools = differs & np.all(is_near | is_locked, axis=-1)
    return acts


class Regulator(NamedTuple):
    """Sums over the control steps of n arms with N joints, and the cost to come, in full turns."""

    squares: Floats  # S, (n, 3 N + 1, 3 N + 1)
    products: Floats  # R, (n, 3 N + 1, 2 N)
    last: Floats  # u₋, (n, N)
    value: Floats  # P, (n, 3 N + 1, 3 N + 1)
    fit: Floats  # (A, T)ᵀ, as given until motors differ, (n, 3 N + 1, 2 N)
    errors: Floats  # Σ y yᵀ of y = (1, (u − u₋)², r²), (n, N, 3, 3)

    @classmethod
    def start(cls, arms: int, joints: int) -> Regulator:
        """Return what is known before a movement."""
        size = 3 * joints + 1
        return cls(
            squares=np.zeros((arms, size, size)),
            products=np.zeros((arms, size, 2 * joints)),
            last=np.zeros((arms, joints)),
            value=np.tile(np.eye(size), (arms, 1, 1)),
            fit=np.tile(_given(joints), (arms, 1, 1)),
            errors=np.zeros((arms, joints, 3, 3)),
        )

    def observe(
        self,
        before: Floats,
        commanded: Floats,
        after: Floats,
        turn: Floats,
        differs: Bools,
    ) -> Regulator:
        """Return it after a control step, all in full turns, (n, N).

        Joints had the speeds `before` and `after` it, and turned by `turn`.  A and T follow where a
        motor `differs` from the given servo, (n,).
        """
        x = np.concatenate([np.ones_like(before[:, :1]), before, self.last, commanded], axis=-1)
        # By elements: a product of matrices may round otherwise in another batch.
        given = [
            of_speed * before + of_command * commanded
            for of_speed, of_command in zip(GIVEN_OF_SPEED, GIVEN_OF_COMMAND, strict=True)
        ]
        error = np.concatenate([after - given[0], turn - given[1]], axis=-1)
        squares = KEEP_LONG * self.squares + x[..., None] * x[:, None]
        products = KEEP_LONG * self.products + x[..., None] * error[:, None]
        y = np.ones((*turn.shape, 3))
        y[..., 1] = (commanded - self.last) ** 2
        y[..., 2] = (turn - (self.fit[..., turn.shape[1] :] * x[..., None]).sum(axis=1)) ** 2
        errors = KEEP * self.errors + y[..., None] * y[..., None, :]
        fit = self.fit
        if any_true(differs):
            ridge, fit = RIDGE * np.eye(x.shape[1]), fit.copy()
            change = np.linalg.solve(squares[differs] + ridge, products[differs])
            fit[differs] = _given(turn.shape[1]) + change
        return Regulator(squares, products, commanded, self.value, fit, errors)

    @property
    def doubt(self) -> Floats:
        """κ: how much the square error of a turn grows with that of a command's change, (n, N)."""
        count = np.maximum(self.errors[..., 0, 0], 1.0)
        means = self.errors[..., 0] / count[..., None]
        about_means = self.errors - count[..., None, None] * means[..., None] * means[..., None, :]
        of_change, both, of_error = (about_means[..., i, j] for i, j in ((1, 1), (1, 2), (2, 2)))
        slope = both / (of_change + LEAST)
        variance = (of_error - slope * both) / (of_change + LEAST) / count
        doubt: Floats = np.maximum(slope - np.sqrt(np.maximum(variance, 0.0)), 0.0)
        return doubt

    def command(
        self, left: Floats, speeds: Floats, goal_turn: Floats, jacobian: Floats, held: Bools | None
    ) -> tuple[Floats, Regulator]:
        """Return the turns to be asked for, (n, N), and the regulator after Riccati's step.

        Joints with these speeds are `left` away from goals that turn by `goal_turn`, all in full
        turns.  Row i of the Jacobian, (n, N, 2), is for joint i.  `held` joints do not turn: they
        get u₋ again.
        """
        arms, joints = left.shape
        size = 3 * joints + 1
        eye, fit = np.eye(joints), self.fit
        if held is not None:
            fit = np.where(np.tile(held, 2)[:, None], 0.0, fit)
        # z′ = F z + B u for z = (d, 1, v, u₋), where turns and speeds are relative to the goals'.
        d, v, last = slice(joints), slice(joints + 1, 2 * joints + 1), slice(2 * joints + 1, size)
        model = np.zeros((arms, size, size + joints))
        model[:, d, d] = eye
        model[:, d, joints:] = -np.swapaxes(fit[..., joints:], -1, -2)
        model[:, joints, joints] = 1.0
        model[:, v, joints:] = np.swapaxes(fit[..., :joints], -1, -2)
        model[:, last, size:] = eye
        model[..., joints] += (model[..., v] @ goal_turn[..., None])[..., 0]
        model[:, d, joints] += goal_turn
        model[:, v, joints] -= goal_turn
        if held is not None:
            model[..., size:] *= ~held[:, None]
        forward, effect = model[..., :size], model[..., size:]

        caution = self.doubt * np.diagonal(self.value, axis1=-2, axis2=-1)[:, d]
        smooth = (SMOOTH + caution)[..., None] * eye
        ahead = np.swapaxes(effect, -1, -2) @ self.value
        response = ahead @ forward
        response[..., last] -= smooth
        gain = np.linalg.solve(ahead @ effect + smooth, response)
        value = np.swapaxes(forward, -1, -2) @ self.value @ forward
        value -= np.swapaxes(response, -1, -2) @ gain
        value[:, d, d] += jacobian @ np.swapaxes(jacobian, -1, -2) + POSTURE * eye
        value[:, last, last] += smooth
        value = (value + np.swapaxes(value, -1, -2)) / 2
        state = np.concatenate([left, np.ones((arms, 1)), speeds - goal_turn, self.last], axis=-1)
        return -(gain @ state[..., None])[..., 0], self._replace(value=value)


@cache
def _given(joints: int) -> Floats:
    """Return what the given servos make of (1, v, u₋, u): (A₀, T₀)ᵀ, (3 N + 1, 2 N)."""
    given = [np.kron(of, np.eye(joints)) for of in (GIVEN_OF_SPEED, (0, 0), GIVEN_OF_COMMAND)]
    return np.concatenate([np.zeros((1, 2 * joints)), *given])
