"""Bell-shaped movements: a time base sets the gain of every iteration of the kinematic network.

With the end effector R held at the target, an iteration of the network with damping d is

    v ← v − g ∂₂∂₂ᵀ v,     L ← normalize(L)          g = 1/d, the rows that are held left out

and the distance of the hand decays exponentially: fastest at first, then ever slower.  Here g
varies in time, so that the hand follows a time base ξ, the minimum-jerk course of a movement
that takes T iterations (Flash and Hogan 1985),

    ξ(τ) = 10 τ³ − 15 τ⁴ + 6 τ⁵,     τ = k/T

A terminal attractor ẋ = Γ (R − x) with Γ = ξ̇/(1 − ξ) reaches R at ξ = 1 from any start, with a
bell-shaped speed (Zak 1988; Morasso, Sanguineti and Spada 1997; Tsuji et al. 2002).  In
iterations it is a rule for the step of the hand x = ΣL:

    |x_k − x_{k−1}| = σ_k |R − x_{k−1}|,     σ_k = (ξ_k − ξ_{k−1}) / (1 − ξ_{k−1})

The rule is about the length of the step, not about the remaining distance: a path that begins
sideways would need large steps to come nearer, and its speed would have a second peak.

The linear part of the network moves the hand by the slow mode, of eigenvalue 2.  It covers the
share 2g of the distance, so that g = σ/2, or d = 2/σ.  Normalization makes the hand slower than
that, by a factor that depends on the posture.  So g = σ/2 is a first guess.  A few secant steps
correct it until the hand's step has the wanted length.  They repeat only the normalization, because
the factor of g stays the same.  g is at most 2/(2 + (N + 1)), which damps the slow modes,
of eigenvalue 2, and the fast ones, N + 1, equally well.  If this is too little, as with a folded or
stretched arm, the hand arrives late.  The network's own damping has no effect.

Literature: Flash & Hogan (1985), J. Neurosci. 5, 1688–1703.  Zak (1988), Phys. Lett. A 133, 18–22.
Morasso, Sanguineti & Spada (1997), Neurocomputing 15, 411–434.  Tsuji et al. (2002), IEEE Trans.
Syst. Man Cybern. C 32, 426–439.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import require, require_array
from mmc_gym.geometry import Floats
from mmc_gym.network.chain import matrices_of, triangle_products
from mmc_gym.network.model import MMCNetwork, MMCState
from mmc_gym.network.normalizers import product

CORRECTIONS = 4  #: steps that correct the gain of an iteration


def minimum_jerk(phase: ArrayLike) -> NDArray[np.float64]:
    """Return the time base ξ, the share of a minimum-jerk movement that is covered at a phase.

    The phase is time / duration; before 0 the movement has not begun, after 1 it is over.
    """
    phase = np.clip(require_array("phase", phase).astype(np.float64), 0.0, 1.0)
    covered: NDArray[np.float64] = phase**3 * (10 - 15 * phase + 6 * phase**2)
    return covered


def share(iteration: ArrayLike, duration: ArrayLike) -> NDArray[np.float64]:
    """Return σ, the share of the remaining distance that the hand covers in an iteration.

    It is 1 after `duration` iterations, T, of the movement or of each: the hand then covers the
    rest as fast as the network can.  Iterations are counted from 1.

    >>> share([1, 2, 3, 4, 5], duration=4).round(4).tolist()
    [0.1035, 0.4423, 0.793, 1.0, 1.0]
    """
    duration, number = np.asarray(duration, np.float64), np.asarray(iteration, np.float64)
    are_durations = bool(((duration > 0) & (duration < np.inf)).all())
    require(are_durations, "duration", duration.tolist(), "positive and finite")
    remaining = 1 - minimum_jerk((number - 1) / duration)
    covered = minimum_jerk(number / duration) - minimum_jerk((number - 1) / duration)
    return np.divide(covered, remaining, out=np.ones_like(remaining), where=remaining > 0)


def timed_step(
    network: MMCNetwork, state: MMCState, target: ArrayLike, share: ArrayLike
) -> MMCState:
    """Return the state after an iteration in which the hand covers a share of its distance.

    The network is kinematic and synchronous.  Targets of the end effector are (..., 2), and shares
    σ, between 0 and 1, for all arms or each, (...).

    >>> network = MMCNetwork()
    >>> state = network.state_from_joint_angles([0.3, 0.6, 0.6])
    >>> for iteration in range(1, 51):
    ...     state = timed_step(network, state, [-1.0, 1.5], share(iteration, duration=50))
    >>> state.end_effector.round(2).tolist()
    [-0.98, 1.5]
    """
    is_plain = network.dynamics == "kinematic" and network.schedule == "synchronous"
    require(is_plain, "network", network, "kinematic and synchronous to follow a time base")
    state = network.hold(state, network.inverse(target))
    count, batch = network.segment_count, state.batch_shape
    values = state.values.reshape(len(state.values), 2, -1)
    accepted = f"between 0 and 1, for all arms or each, {batch}"
    shares = require_array("share", share, accepted).astype(values.dtype)
    are_shares = shares.shape in ((), batch) and bool(((shares >= 0) & (shares <= 1)).all())
    require(are_shares, "share", share, accepted)
    shares = np.broadcast_to(shares, batch).reshape(-1)
    vectors, products, _, change = matrices_of(values)
    product(-_coupling(count).astype(values.dtype), vectors, products)  # the change is −∂₂∂₂ᵀ v
    lengths = np.array(network.segment_lengths, dtype=values.dtype)[:, None]
    hand = values[:count].sum(axis=0)
    step_length = shares * np.hypot(*(values[-1] - hand))

    def segments_with(gain: Floats) -> Floats:
        segments: Floats = values[:count] + gain * change[:count]
        network.normalizer.normalize_rows(segments, lengths)
        return segments

    def hand_step(gain: Floats) -> Floats:
        x, y = segments_with(gain).sum(axis=0) - hand
        return np.hypot(x, y)

    largest = 2 / (count + 3)
    gain = _solve(hand_step, step_length, np.minimum(shares / 2, largest), largest)
    following = values + gain * change
    following[:count] = segments_with(gain)
    return MMCState(following.reshape(state.values.shape), count)


def _solve(
    function: Callable[[Floats], Floats], goal: Floats, first: Floats, largest: float
) -> Floats:
    """Return the argument in [0, largest] at which an increasing function has the value `goal`.

    The function is 0 at 0.  As long as all its values are too small, the next guess is proportional
    to the goal.  Then it is on the line between the best points below and above.
    """
    tiny = np.finfo(goal.dtype).tiny
    below, value_below = np.zeros_like(goal), np.zeros_like(goal)
    above, value_above = np.full_like(goal, largest), np.full_like(goal, np.inf)
    guess = first
    for _ in range(CORRECTIONS):
        value = function(guess)
        is_small = value < goal
        below, value_below = np.where(is_small, [guess, value], [below, value_below])
        above, value_above = np.where(is_small, [above, value_above], [guess, value])
        is_bracketed = np.isfinite(value_above)
        rise = np.maximum(np.where(is_bracketed, value_above - value_below, 1.0), tiny)
        on_line = below + (goal - value_below) * (above - below) / rise
        least = np.maximum(goal * 1e-6, tiny)  # the quotient is 1e6 at most, and never 0/0
        proportional = guess * (goal / np.maximum(value, least))
        guess = np.clip(np.where(is_bracketed, on_line, proportional), below, above)
    return guess


@lru_cache(maxsize=16)
def _coupling(segment_count: int) -> NDArray[np.float64]:
    """Return ∂₂∂₂ᵀ with the row of R, which is held, set to zero."""
    coupling = triangle_products(segment_count)
    coupling[-1] = 0.0
    return coupling
