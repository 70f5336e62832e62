"""Memory: what is identified in one movement is believed in the next ones, and forgotten.

A belief x has the lengths of the segments, as differences from the given ones, the turn φ of the
cursor about the place where a movement begins, and the angle δ by which the hand leaves the
intended way, as in a field of forces.  It is the sum of states that learn and forget at their own
rates.  With what a movement shows beyond the belief, e, and a rest of t seconds after it,

    x_i ← A_i^t (A_i x_i + B_i e),        x = Σ x_i,      A_i retention, B_i rate

in the notation of Smith et al. (2006); a second of rest counts as much as a movement.  Within the
movement the agent acts on x + Σ B_i e for lengths and cursor, so for B = 1 and A = 0 it learns all
within a movement and keeps nothing.

Evidence about the body is gathered in the coordinates of the belief, in which the body is as given
if the belief is right: a hand seen at x counts as x̃ = e^{−iφ}(x − c) − Σ Δℓ_j u_j.  The angle δ is
that of Σ v w̄ over the first half of a movement, where w is the displacement of the hand that a
command intends, and v the one that follows.  Commands correct it in advance, intending w e^{−iδr},
where r is the share of the way that is left, so that the hand ends at the target.

By default a belief holds in all directions, and is learned from errors of any size.  As observed in
people, there may be one for each direction θ of the target: what a movement towards θ' shows counts
at θ by exp(−(θ − θ')²/2σ²), and an angle above a largest error counts as that (`Parts.width` is σ).

Subjects may be noisy.  The aim of a movement is turned about its begin by an angle that is drawn
for the movement, and each command is multiplied by 1 + s z, with a standard normal z for each joint
and control step.  Draws follow from the subject's seed and the numbers of movement and step.

Literature: Smith, Ghazizadeh & Shadmehr (2006), PLoS Biol. 4, e179.  Krakauer et al. (2000), J.
Neurosci. 20, 8916–8924 (directions).  Kim et al. (2018), Commun. Biol. 1, 19 (the largest error).
van Beers (2009), Neuron 63, 406–417, and Harris & Wolpert (1998), Nature 394, 780–784 (noise).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import any_true, where
from mmc_gym.agents.body_model.body import Body
from mmc_gym.agents.body_model.forward_model import (
    Bools,
    Points,
    hand,
    pull_hand,
    to_hand,
    unit_vectors,
)
from mmc_gym.agents.body_model.imagination import ReachProblem
from mmc_gym.agents.body_model.parts import Parts
from mmc_gym.geometry import Floats

FIRM = 0.05  # damping of the correction, segment lengths
DIRECTIONS = 144  # that have a belief each, if it does not hold in all


class Memory(NamedTuple):
    """Beliefs, and what has been seen of the present movement."""

    # x_i: N differences of lengths, φ and δ in radians, (n, states, directions, N + 2)
    states: Floats
    towards: NDArray[np.int64]  # number of the direction of the present movement, (n,)
    shift: Points  # c of the cursor that is believed, (n,)
    begin: Points  # where the hand was when the movement began
    place: Points  # where it was in the last control step
    intended: Points  # w of the last command, without the correction
    drift: Points  # Σ v w̄
    rate: Floats  # B of each state, (n, states)
    retention: Floats  # A, likewise
    noise: Floats  # standard deviations of plans, radians, and of commands, a share, (n, 2)
    draw: NDArray[np.int64]  # seed of the noise, and number of the movement, (n, 2)
    plan: Points  # the turn by which the present movement is aimed off

    @classmethod
    def start(cls, arms: int, joints: int, parts: Parts, subjects: Sequence[Parts] = ()) -> Memory:
        """Return the memory of arms, one of each of the `subjects`, that believe the given body."""
        directions = DIRECTIONS if math.isfinite(parts.width) else 1
        states = np.zeros((arms, len(parts.rate), directions, joints + 2))
        learners = subjects if len(subjects) == arms else [parts] * arms
        shape = arms, len(parts.rate)
        rate = np.array([learner.rate for learner in learners]).reshape(shape)
        retention = np.array([learner.retention for learner in learners]).reshape(shape)
        noise = [
            (math.radians(learner.planning_noise), learner.motor_noise) for learner in learners
        ]
        spread = np.array(noise).reshape(arms, 2)
        draws = [(learner.noise_seed, 0) for learner in learners]
        draw = np.array(draws, np.int64).reshape(arms, 2)
        towards, origin = np.zeros(arms, np.int64), np.zeros(arms, complex)
        places = origin, origin, origin, origin, origin
        return cls(states, towards, *places, rate, retention, spread, draw, origin + 1)

    @property
    def belief(self) -> Floats:
        """The belief x in the direction of the movement, (n, N + 2)."""
        belief: Floats = self.states[np.arange(len(self.states)), :, self.towards].sum(axis=1)
        return belief

    @property
    def turn(self) -> Points:
        """e^{iφ} of the cursor that is believed."""
        turn: Points = np.exp(1j * self.belief[:, -2])
        return turn

    def begin_movement(
        self,
        begins: Bools,
        seen: Points,
        target: Points,
        joint_angles: Floats,
        given_lengths: Floats,
    ) -> Memory:
        """Return the memory where movements begin (`begins`, (n,)) with the hand `seen` there."""
        if not any_true(begins):
            return self
        directions = self.states.shape[2]
        place = np.rint(np.angle(target - seen) / (2 * np.pi) * directions)
        new = self._replace(towards=place.astype(np.int64) % directions)
        felt = hand(joint_angles, given_lengths + new.belief[:, :-2])
        shift, zero = seen - new.turn * felt, np.zeros_like(felt)
        new = new._replace(shift=shift, begin=felt, place=felt, intended=zero, drift=zero)
        if any_true(self.noise):
            draw = self.draw + np.array([0, 1])
            angle = self.noise[:, 0] * _normal(draw, np.zeros(len(draw)), 1)[:, 0]
            new = new._replace(draw=draw, plan=np.exp(1j * angle))
        return where(begins, new, self)

    def aimed(self, aim: Points) -> Points:
        """Return where a movement is planned to end, for an aim."""
        return self.begin + (aim - self.begin) * self.plan if any_true(self.noise) else aim

    def disturbed(self, action: NDArray[np.float32], looks: Floats) -> NDArray[np.float32]:
        """Return a command with its noise, in the control step of so many looks, (n,)."""
        if not any_true(self.noise[:, 1]):
            return action
        noisy = action * (1 + self.noise[:, 1:] * _normal(self.draw, looks, action.shape[-1]))
        return np.clip(noisy, -1, 1).astype(np.float32)

    def as_given(self, seen: Points, joint_angles: Floats) -> Points:
        """Return where a hand of the given body would be if this one is seen here: x̃."""
        added = (self.belief[:, :-2] * unit_vectors(joint_angles)).sum(axis=-1)
        return (seen - self.shift) * self.turn.conj() - added

    def body(self, beyond: Body, given_lengths: Floats, parts: Parts) -> Body:
        """Return the body to act on: the belief, and a share of what is identified beyond it."""
        rate = self.rate.sum(axis=1) * _share(beyond.turn, parts)
        longer = beyond.lengths - given_lengths
        lengths = given_lengths + self.belief[:, :-2] + rate[:, None] * longer
        part = np.exp(1j * rate * np.angle(beyond.turn))
        # What is identified turns about the place where the movement began, and may be shifted.
        begin = self.begin
        shift = rate * (beyond.shift - begin * (1 - beyond.turn)) + begin * (1 - part)
        return Body(lengths, self.turn * part, self.turn * shift + self.shift, beyond.is_mirrored)

    def record_drift(self, problem: ReachProblem, is_early: Bools) -> Memory:
        """Return the memory after a control step, which counts for δ if `is_early`, (n,)."""
        place = hand(problem.joint_angles, problem.lengths)
        drift = self.drift + is_early * (place - self.place) * self.intended.conj()
        return self._replace(place=place, drift=drift)

    def correct_drift(self, turn: Floats, problem: ReachProblem) -> tuple[Floats, Memory]:
        """Return turns that take the hand where `turn` would without drift, and the memory."""
        joint_angles, aim, lengths, held = problem
        levers = to_hand(joint_angles, lengths)
        intended = (1j * levers * turn).sum(axis=-1)
        left = np.abs(aim - self.place) / np.maximum(np.abs(aim - self.begin), 1e-9)
        against = np.exp(-1j * self.belief[:, -1] * np.minimum(left, 1.0))
        more = pull_hand(levers, intended * (against - 1), FIRM, held)
        return turn + more, self._replace(intended=intended)

    def keep(self, beyond: Body, given_lengths: Floats, parts: Parts, rest: float) -> Memory:
        """Return the memory for the next movement after a rest of so many seconds."""
        turns = beyond.turn, self.drift
        turn, drift = (np.angle(turn) * _share(turn, parts) for turn in turns)
        lengths = (beyond.lengths - given_lengths) * _share(beyond.turn, parts)[:, None]
        error = np.concatenate([lengths, turn[:, None], drift[:, None]], axis=-1)
        count = self.states.shape[2]
        away = (np.arange(count) - self.towards[:, None] + count // 2) % count - count // 2
        near = np.exp(-((away * 360 / count / parts.width) ** 2) / 2)
        error = near[:, None, :, None] * error[:, None, None]
        retention, rate = self.retention[..., None, None], self.rate[..., None, None]
        learned = retention * self.states + rate * error
        return self._replace(states=retention**rest * learned)


def _normal(draw: NDArray[np.int64], step: Floats, count: int) -> Floats:
    """Return standard normal numbers of each arm for a control step of its movement, (n, count)."""
    rows = zip(draw, step, strict=True)
    seeds = ((*map(int, arm_draw), int(arm_step)) for arm_draw, arm_step in rows)
    return np.array([np.random.default_rng(seed).standard_normal(count) for seed in seeds])


def _share(turn: Points, parts: Parts) -> Floats:
    """Return the share of an error that counts, by its angle."""
    most = math.radians(parts.largest_error)
    return np.minimum(1.0, most / np.maximum(np.abs(np.angle(turn)), 1e-9))
