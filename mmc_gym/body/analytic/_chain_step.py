"""Compiled physics steps of planar chains: blocks of arms, side by side in lanes.

Segment j points along u_j = (cos θ_j, sin θ_j), and n_j = (−sin θ_j, cos θ_j) is across it.  A step
of duration h first moves and then pushes, as Chipmunk's does:

    θ' = θ + h ω,       the rods' centres meanwhile going straight on with their old velocities
    J'ᵀ μ (v' − v) = h Q,       Q the torques on the segments, μ the masses of the rods

where a rod's velocity v is that of rigid rods on pivots (J ω: each end moves by ω_j n_j against the
other) and what closes the pivots after the rods went straight instead of round (the lag of u_j).
It is the velocity-Verlet (SHAKE) step of the chain with the centripetal force of the new step
extrapolated from the last two, at the cost of an explicit step: no Coriolis term is written out.
Chipmunk, its pivots solved to the end and corrected by all of their error, does the same.

The torques are those of the servos, stops and locks.  Each joint asks for a velocity and has lowest
and highest impulses to get it: with q̇ = asked + z, the joint-space mass matrix M (`weigh`), and
the impulses that would give every joint what it asks for (`_need`, recursive Newton–Euler),

    λ = needed + M z,   lowest ≤ λ ≤ highest,   z = 0 where λ is inside,
    z ≤ 0 where it is at the highest and z ≥ 0 where it is at the lowest.

M is positive definite, so there is one solution; `limit` finds it by principal pivoting: guess
which joints are at a bound, solve, change the guess (Júdice & Pires 1994, Computers & Operations
Research 21, 587–596).  A joint thrown against its stop while the servo is at its bound is a second
kink of the same kind.

Lanes never mix and nothing is reassociated or fused, so an arm's numbers do not depend on its
neighbours, its lane or the machine's vector width.  Three things are there for the compiler, which
turns the loops over lanes into vector instructions only where it sees, or can check once before a
loop, that nothing it writes is read again: the records, whose fields do not overlap; the number of
lanes, an argument, as constant loops would be unrolled first; and the segments from the hand
inward, looked up in `inward`, as its checks before loops that run backward always fail.  Together
they make the steps two to four times as quick.
"""

from __future__ import annotations

import numpy as np

from mmc_gym.body.analytic._joint_bounds import guess, limit, release, weigh
from mmc_gym.body.analytic.kernel import LANES, SUMS, WORK, any_lane, compiled, inner, sine_cosine


@compiled
def step_blocks(  # type: ignore[no-untyped-def]
    state, output, rods, world, substeps, first, last
):
    """Simulate the blocks of `state` from `first` to before `last`; write `output`."""
    count = output.shape[0] // (3 * rods.shape[0] + 2)
    segments = rods.shape[0]
    work = np.zeros(segments, WORK)
    sums = np.zeros(1, SUMS)
    matrix = np.zeros((segments, segments, LANES))
    factor = np.zeros((segments, segments, LANES))
    inward = np.arange(segments - 1, -1, -1)
    for block in range(first, last):
        arms = state[block]
        lanes = min(LANES, count - block * LANES)
        _look(arms, work, lanes)
        release(work, lanes)
        for _ in range(substeps):
            _move(arms, work, sums[0], rods, world[0], lanes)
            _ask(arms, work, sums[0], rods, world[0], lanes)
            if _need(arms, work, sums[0], rods, world[0], inward, lanes):
                guess(arms, work, sums[0], world[0], lanes)
                weigh(work, sums[0], matrix, rods, inward, lanes)
                limit(work, sums[0], matrix, factor, inward, lanes)
            else:
                release(work, lanes)
            _turn(arms, work, sums[0], lanes)
        _read(arms, work, sums[0], output, rods, block, lanes)


@inner
def _look(arms, work, lanes):  # type: ignore[no-untyped-def]
    for i in range(arms.shape[0]):
        a, w = arms[i], work[i]
        for k in range(lanes):
            w.sine[k], w.cosine[k] = sine_cosine(a.angle[k])


@inner
def _move(arms, work, sums, rods, world, lanes):  # type: ignore[no-untyped-def]
    """Turn the segments; what the hand feels of the force field goes to `sums` x, y and turn."""
    h = world.substep
    rate = 1.0 / h
    segments = arms.shape[0]
    for k in range(lanes):
        sums.x[k] = 0.0
        sums.y[k] = 0.0
    for i in range(segments):
        a, w = arms[i], work[i]
        length = rods[i].length
        carried = rods[i].centre if i == segments - 1 else length
        for k in range(lanes):
            speed, sine, cosine = a.speed[k], w.sine[k], w.cosine[k]
            lag_x, lag_y = a.lag_x[k], a.lag_y[k]
            sums.x[k] += carried * lag_x - length * sine * speed
            sums.y[k] += carried * lag_y + length * cosine * speed
            angle = a.angle[k] + h * speed
            new_sine, new_cosine = sine_cosine(angle)
            new_lag_x = (new_cosine - cosine) * rate + speed * sine
            new_lag_y = (new_sine - sine) * rate - speed * cosine
            w.free_x[k] = lag_x - new_lag_x - sine * speed
            w.free_y[k] = lag_y - new_lag_y + cosine * speed
            a.lag_x[k] = new_lag_x
            a.lag_y[k] = new_lag_y
            a.angle[k] = angle
            w.load_x[k] = cosine
            w.load_y[k] = sine
            w.sine[k] = new_sine
            w.cosine[k] = new_cosine
    w = work[segments - 1]
    reach = rods[segments - 1].length - rods[segments - 1].centre
    xx, xy = h * world.field[0, 0], h * world.field[0, 1]
    yx, yy = h * world.field[1, 0], h * world.field[1, 1]
    for k in range(lanes):
        x, y = sums.x[k], sums.y[k]
        push_x, push_y = xx * x + xy * y, yx * x + yy * y
        sums.turn[k] = reach * (w.load_x[k] * push_y - w.load_y[k] * push_x)
        sums.x[k] = push_x
        sums.y[k] = push_y


@inner
def _ask(arms, work, sums, rods, world, lanes):  # type: ignore[no-untyped-def]
    """What each joint wants, with which impulses, and how much faster its stop would let it be."""
    fastest, gain, stop, rate = world.speed_limit, world.gain, world.stop_gain, 1.0 / world.substep
    is_position = world.is_position > 0.0
    for k in range(lanes):
        sums.angle[k] = 0.0
    for i in range(arms.shape[0]):
        a, w = arms[i], work[i]
        least, most = rods[i].lowest_angle, rods[i].highest_angle
        for k in range(lanes):
            angle = a.angle[k] - sums.angle[k]
            sums.angle[k] = a.angle[k]
            wanted = gain * (a.asked[k] - angle) if is_position else a.asked[k]
            wanted = fastest if wanted > fastest else wanted
            wanted = -fastest if wanted < -fastest else wanted
            limit, held = a.limit[k], a.held[k]
            above = stop * (most - angle) if angle > most else np.inf
            below = stop * (least - angle) if angle < least else -np.inf
            lowest = -np.inf if wanted > above else -limit
            highest = np.inf if wanted < below else limit
            wanted = above if wanted > above else wanted
            wanted = below if wanted < below else wanted
            locked = held == held
            wanted = rate * (held - angle) if locked else wanted
            w.wanted[k] = wanted
            w.lowest[k] = -np.inf if locked else lowest
            w.highest[k] = np.inf if locked else highest
            w.stop_above[k] = above - wanted
            w.stop_below[k] = below - wanted


@inner
def _need(arms, work, sums, rods, world, inward, lanes):  # type: ignore[no-untyped-def]
    """Impulses that give every joint the wanted velocity; are there any out of bounds?"""
    segments = arms.shape[0]
    fall_x, fall_y = world.substep * world.gravity[0], world.substep * world.gravity[1]
    last = work[segments - 1]
    for k in range(lanes):
        last.right[k] = sums.turn[k]
        last.moment_x[k] = sums.x[k]
        last.moment_y[k] = sums.y[k]
        sums.x[k] = 0.0
        sums.y[k] = 0.0
        sums.turn[k] = 0.0
    for i in range(segments):
        w = work[i]
        length, mass, centre = rods[i].length, rods[i].mass, rods[i].centre
        for k in range(lanes):
            turn = sums.turn[k] + w.wanted[k]
            change_x = -w.sine[k] * turn - w.free_x[k]
            change_y = w.cosine[k] * turn - w.free_y[k]
            w.load_x[k] = mass * ((sums.x[k] + centre * change_x) - fall_x)
            w.load_y[k] = mass * ((sums.y[k] + centre * change_y) - fall_y)
            sums.x[k] += length * change_x
            sums.y[k] += length * change_y
            sums.turn[k] = turn
            w.turn[k] = turn
    for k in range(lanes):
        last.load_x[k] -= last.moment_x[k]
        last.load_y[k] -= last.moment_y[k]
        sums.turn[k] = -last.right[k]
        sums.x[k] = 0.0
        sums.y[k] = 0.0
        sums.changed[k] = 0.0
    for i in inward:
        a, w = arms[i], work[i]
        length, centre, inertia = rods[i].length, rods[i].centre, rods[i].inertia
        for k in range(lanes):
            load_x, load_y = w.load_x[k], w.load_y[k]
            push_x = length * sums.x[k] + centre * load_x
            push_y = length * sums.y[k] + centre * load_y
            torque = w.cosine[k] * push_y - w.sine[k] * push_x
            needed = sums.turn[k] + torque + inertia * (w.turn[k] - a.speed[k])
            sums.turn[k] = needed
            sums.x[k] += load_x
            sums.y[k] += load_y
            w.needed[k] = needed
            w.excess[k] = 0.0
            beyond = (needed > w.highest[k]) | (needed < w.lowest[k])
            sums.changed[k] += 1.0 if beyond else 0.0
    return any_lane(sums.changed, lanes)


@inner
def _turn(arms, work, sums, lanes):  # type: ignore[no-untyped-def]
    """Give the segments the velocities that the joints have found."""
    for k in range(lanes):
        sums.turn[k] = 0.0
    for i in range(arms.shape[0]):
        a, w = arms[i], work[i]
        for k in range(lanes):
            speed = sums.turn[k] + (w.wanted[k] + w.excess[k])
            sums.turn[k] = speed
            a.speed[k] = speed


@inner
def _read(arms, work, sums, output, rods, block, lanes):  # type: ignore[no-untyped-def]
    """Write what the arms show: segment angles, joint angles, joint velocities, hands."""
    segments = arms.shape[0]
    size = output.shape[0] // (3 * segments + 2) * segments
    for k in range(lanes):
        sums.x[k] = 0.0
        sums.y[k] = 0.0
    for i in range(segments):
        w = work[i]
        length = rods[i].length
        for k in range(lanes):
            sums.x[k] += length * w.cosine[k]
            sums.y[k] += length * w.sine[k]
    for k in range(lanes):
        arm = block * LANES + k
        parent_angle = parent_speed = 0.0
        for i in range(segments):
            angle, speed = arms[i].angle[k], arms[i].speed[k]
            at = arm * segments + i
            output[at] = angle
            output[size + at] = angle - parent_angle
            output[2 * size + at] = speed - parent_speed
            parent_angle, parent_speed = angle, speed
        output[3 * size + 2 * arm] = sums.x[k]
        output[3 * size + 2 * arm + 1] = sums.y[k]
