"""Which impulses of servos and stops are at their bounds, and what the joints then do.

`_chain_step` states the problem; the joints of all lanes are solved together, and those that
are done keep their solution while others go on.
"""

from __future__ import annotations

import numpy as np

from mmc_gym.body.analytic.kernel import any_lane, inner

FREE, AT_HIGHEST, AT_LOWEST, STOPPED_ABOVE, STOPPED_BELOW = 0.0, 1.0, -1.0, -2.0, 2.0
_TINY = 1e-12  # rad/s, and relative for impulses: what is not worth another guess


@inner
def weigh(work, sums, matrix, rods, inward, lanes):  # type: ignore[no-untyped-def]
    """Joint-space mass matrix: inertia and first moment of the arm beyond the later joint."""
    segments = work.shape[0]
    beyond = 0.0
    for k in range(lanes):
        sums.x[k] = 0.0
        sums.y[k] = 0.0
        sums.turn[k] = 0.0
    for j in inward:
        length, mass, centre = rods[j].length, rods[j].mass, rods[j].centre
        own = mass * centre * centre + rods[j].inertia + beyond * length * length
        moment = mass * centre + beyond * length
        beyond += mass
        w = work[j]
        for k in range(lanes):
            cosine, sine, x, y = w.cosine[k], w.sine[k], sums.x[k], sums.y[k]
            inertia = (sums.turn[k] + 2.0 * length * (cosine * x + sine * y)) + own
            sums.turn[k] = inertia
            sums.x[k] = x + moment * cosine
            sums.y[k] = y + moment * sine
            w.inertia[k] = inertia
            w.moment_x[k] = sums.x[k]
            w.moment_y[k] = sums.y[k]
    for j in range(segments):
        w = work[j]
        for k in range(lanes):
            matrix[j, j, k] = w.inertia[k]
            sums.x[k] = 0.0
            sums.y[k] = 0.0
        for m in range(segments - j, segments):
            i = inward[m]
            v = work[i]
            length = rods[i].length
            for k in range(lanes):
                x = sums.x[k] + length * v.cosine[k]
                y = sums.y[k] + length * v.sine[k]
                sums.x[k] = x
                sums.y[k] = y
                matrix[j, i, k] = w.inertia[k] + w.moment_x[k] * x + w.moment_y[k] * y
            for k in range(lanes):
                matrix[i, j, k] = matrix[j, i, k]


@inner
def release(work, lanes):  # type: ignore[no-untyped-def]
    for i in range(work.shape[0]):
        w = work[i]
        for k in range(lanes):
            w.bound[k] = FREE


@inner
def guess(arms, work, sums, world, lanes):  # type: ignore[no-untyped-def]
    """Which bounds bind: those of the last substep, or that the needed impulses pass.

    A torque servo is at its bound nearly always.  A lane that stays within its bounds, of which
    `sums.changed` counts those passed, keeps out of it: alone it would not have come here.
    """
    is_torque = world.is_torque > 0.0
    for k in range(lanes):
        sums.x[k] = 0.0
    for i in range(work.shape[0]):
        w = work[i]
        for k in range(lanes):
            sums.x[k] += abs(w.bound[k])
    for i in range(work.shape[0]):
        a, w = arms[i], work[i]
        for k in range(lanes):
            needed, lowest, highest = w.needed[k], w.lowest[k], w.highest[k]
            above, below = w.stop_above[k], w.stop_below[k]
            last, asked = w.bound[k], a.asked[k]
            new = AT_HIGHEST if needed > highest else FREE
            new = AT_LOWEST if needed < lowest else new
            pushed = AT_HIGHEST if asked > 0.0 else AT_LOWEST
            new = pushed if is_torque else new
            new = last if sums.x[k] > 0.0 else new
            new = FREE if (new == AT_HIGHEST) & (highest == np.inf) else new
            new = FREE if (new == AT_LOWEST) & (lowest == -np.inf) else new
            new = FREE if (new == STOPPED_ABOVE) & (above == np.inf) else new
            new = FREE if (new == STOPPED_BELOW) & (below == -np.inf) else new
            w.bound[k] = new if sums.changed[k] > 0.0 else FREE


@inner
def limit(work, sums, matrix, factor, inward, lanes):  # type: ignore[no-untyped-def]
    """By how much each joint's velocity has to differ from the wanted one, `excess`."""
    segments = work.shape[0]
    for attempt in range(10 * segments + 50):
        _prescribe(work, sums, matrix, factor, lanes)
        _solve(work, sums, factor, inward, lanes)
        # Changing all wrong guesses at once is quick and may cycle; one at a time never does.
        if not _revise(work, sums, matrix, attempt > segments + 5, lanes):
            break


@inner
def _prescribe(work, sums, matrix, factor, lanes):  # type: ignore[no-untyped-def]
    """Equations for the joints at a bound; the others keep the wanted velocity or their stop's."""
    segments = work.shape[0]
    for i in range(segments):
        w = work[i]
        for k in range(lanes):
            bound, below, above = w.bound[k], w.stop_below[k], w.stop_above[k]
            lowest, highest = w.lowest[k], w.highest[k]
            stop = below if bound > 0.0 else above
            impulse = highest if bound > 0.0 else lowest
            w.excess[k] = stop if abs(bound) == 2.0 else 0.0
            w.right[k] = impulse - w.needed[k]
    for i in range(segments):
        w = work[i]
        for k in range(lanes):
            sums.x[k] = w.right[k]
        for j in range(segments):
            v = work[j]
            same = 1.0 if i == j else 0.0
            for k in range(lanes):
                entry = matrix[i, j, k]
                sums.x[k] -= entry * v.excess[k]
                both = (abs(w.bound[k]) == 1.0) & (abs(v.bound[k]) == 1.0)
                factor[i, j, k] = entry if both else same
        for k in range(lanes):
            excess, right = w.excess[k], sums.x[k]
            w.right[k] = right if abs(w.bound[k]) == 1.0 else excess


@inner
def _solve(work, sums, factor, inward, lanes):  # type: ignore[no-untyped-def]
    """Solve factor · excess = right by L D Lᵀ."""
    segments = work.shape[0]
    for j in range(segments):
        v = work[j]
        for k in range(lanes):
            v.inverse[k] = 1.0 / factor[j, j, k]
        for i in range(j + 1, segments):
            w = work[i]
            for k in range(lanes):
                ratio = factor[i, j, k] * v.inverse[k]
                sums.x[k] = ratio
                w.right[k] -= ratio * v.right[k]
            for m in range(j + 1, i + 1):
                for k in range(lanes):
                    factor[i, m, k] -= sums.x[k] * factor[m, j, k]
    for i in inward:
        w = work[i]
        for k in range(lanes):
            sums.x[k] = w.right[k]
        for j in range(i + 1, segments):
            v = work[j]
            for k in range(lanes):
                sums.x[k] -= factor[j, i, k] * v.excess[k]
        for k in range(lanes):
            w.excess[k] = sums.x[k] * w.inverse[k]


@inner
def _revise(work, sums, matrix, one_by_one, lanes):  # type: ignore[no-untyped-def]
    """Change the guesses that the solution contradicts; were there any?"""
    segments = work.shape[0]
    single = 1.0 if one_by_one else 0.0
    for k in range(lanes):
        sums.changed[k] = 0.0
        sums.turn[k] = 0.0
    for i in range(segments):
        w = work[i]
        for k in range(lanes):
            sums.x[k] = w.needed[k]
        for j in range(segments):
            v = work[j]
            for k in range(lanes):
                sums.x[k] += matrix[i, j, k] * v.excess[k]
        for k in range(lanes):
            bound, excess, impulse = w.bound[k], w.excess[k], sums.x[k]
            lowest, highest, below, above = (
                w.lowest[k],
                w.highest[k],
                w.stop_below[k],
                w.stop_above[k],
            )
            slack = 1e-9 * abs(impulse)
            new = bound
            new = AT_HIGHEST if (bound == FREE) & (impulse > highest + slack) else new
            new = AT_LOWEST if (bound == FREE) & (impulse < lowest - slack) else new
            new = FREE if (bound == AT_HIGHEST) & (excess > _TINY) else new
            new = FREE if (bound == AT_LOWEST) & (excess < -_TINY) else new
            new = STOPPED_BELOW if (bound == AT_HIGHEST) & (excess < below - _TINY) else new
            new = STOPPED_ABOVE if (bound == AT_LOWEST) & (excess > above + _TINY) else new
            new = AT_HIGHEST if (bound == STOPPED_BELOW) & (impulse < highest - slack) else new
            new = AT_LOWEST if (bound == STOPPED_ABOVE) & (impulse > lowest + slack) else new
            changed = sums.changed[k]
            new = bound if changed > 0.0 else new
            w.bound[k] = new
            sums.changed[k] = single if new != bound else changed
            sums.turn[k] += 1.0 if new != bound else 0.0
    return any_lane(sums.turn, lanes)
