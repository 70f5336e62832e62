"""Compiled physics steps of planar chains: blocks of arms, side by side in lanes.

Segment j points along u_j = (cos θ_j, sin θ_j), and n_j = (−sin θ_j, cos θ_j) is across it.  A step
of duration h first moves and then pushes, as Chipmunk's does:

    θ' = θ + h ω,       the rods' centres meanwhile going straight on with their old velocities
    J'ᵀ μ (v' − v) = h Q,       Q the torques on the segments, μ the masses of the rods

A rod's velocity v has two parts: that of rigid rods on pivots (J ω: each end moves by ω_j n_j
against the other), and what closes the pivots after the rods went straight instead of round (the
lag of u_j).  This is the velocity-Verlet (SHAKE) step of the chain with the centripetal force of
the new step extrapolated from the last two, at the cost of an explicit step: no Coriolis term is
written out.  Chipmunk does the same once its pivots are solved to the end and corrected by all of
their error.

The torques are those of the servos, stops and locks.  Each joint asks for a velocity and has lowest
and highest impulses to get it.  With q̇ = asked + z, the joint-space mass matrix M (`_weigh`), and
the impulses that would give every joint what it asks for (`_need`, recursive Newton–Euler),

    λ = needed + M z,   lowest ≤ λ ≤ highest,   z = 0 where λ is inside,
    z ≤ 0 where it is at the highest and z ≥ 0 where it is at the lowest.

M is positive definite, so there is one solution.  `_limit` finds it by principal pivoting: guess
which joints are at a bound, solve, change the guess (Júdice & Pires 1994, Computers & Operations
Research 21, 587–596).  A joint thrown against its stop while the servo is at its bound is a second
kink of the same kind.  The joints of all lanes are solved together, and lanes that are done keep
their solution while others go on.

Lanes never mix and nothing is reassociated or fused, so that an arm's numbers do not depend on its
neighbours, its lane or the machine's vector width.  Three things make the steps two to four times
as quick, because the compiler turns loops over lanes into vector instructions only if it sees, or
can check once before a loop, that nothing it writes is read again: records, whose fields do not
overlap; the number of lanes as an argument, because constant loops would be unrolled first; and
segments from the hand inward looked up in `inward`, because its checks fail for loops that run
backward.

Functions that are called from Python are `compiled`, those that they call are `inner`.  numba keeps
the former between processes until this file changes, which is why they all stand in it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mmc_gym._compiling import compiled, inner
from mmc_gym.body.parameters import ArmParameters, Servo

# What binds a joint: nothing, a bound of its servo, or its stop while the servo is at a bound.
FREE, AT_HIGHEST, AT_LOWEST, STOPPED_ABOVE, STOPPED_BELOW = 0.0, 1.0, -1.0, -2.0, 2.0
LANES = 32  # arms in a block
_TINY = 1e-12  # rad/s: less is not worth another guess
_STOP_RATE = -60 * math.log(0.9)  # a stop corrects 10 % of its error in 1/60 s, pymunk's default


def _record(names: str, lanes: tuple[int, ...] = (LANES,)) -> np.dtype[np.void]:
    return np.dtype([(name, np.float64, lanes) for name in names.split()])


# What an arm remembers, per segment and the joint before it: `lag` is the part of the velocity of
# u_j that closes the pivots; `asked` is what the servo is to do, with at most the impulse `limit`;
# `held` is the angle of a locked joint, or nan; `yields` is 1 where the servo gave all it could.
STATE = _record("angle speed lag_x lag_y asked limit held yields")
# What one physics step works with, per segment, and for all of them.
WORK = _record(
    "sine cosine free_x free_y wanted turn lowest highest stop_above stop_below load_x load_y "
    "needed bound moment_x moment_y inertia right inverse excess"
)
SUMS = _record("x y turn angle changed mobility_xx mobility_xy mobility_yy velocity_x velocity_y")
# The segments, each with the joint before it, and what is common to them.
RODS = _record("length mass centre inertia lowest_angle highest_angle", lanes=())
SCALARS = _record("substep speed_limit torque_limit gain stop_gain is_position is_torque", lanes=())
WORLD = np.dtype([*SCALARS.descr, ("gravity", np.float64, (2,)), ("field", np.float64, (2, 2))])


def make_rods(parameters: ArmParameters) -> NDArray[np.void]:
    """Return `RODS`, one record per segment."""
    count = len(parameters.segment_lengths)
    rods = np.zeros(count, RODS)
    rods["length"] = parameters.segment_lengths
    rods["mass"], rods["centre"], rods["inertia"] = zip(*parameters.rods)
    limits = parameters.joint_limits or ((-math.inf, math.inf),) * count
    rods["lowest_angle"], rods["highest_angle"] = zip(*limits)
    return rods


def make_world(parameters: ArmParameters, servo: Servo) -> NDArray[np.void]:
    """Return `WORLD`, one record of what is common to all segments."""
    world, substep = np.zeros(1, WORLD), parameters.substep
    world["substep"] = substep
    world["speed_limit"] = parameters.speed_limit
    world["torque_limit"] = parameters.torque_limit
    world["gain"] = -math.expm1(-parameters.servo_gain * substep) / substep
    world["stop_gain"] = -math.expm1(-_STOP_RATE * substep) / substep
    world["is_position"] = servo == "position"
    world["is_torque"] = servo == "torque"
    world["gravity"] = parameters.gravity
    if parameters.force_field is not None:
        world["field"] = parameters.force_field
    return world


@inner
def _sine_cosine(angle):
    """Return sine and cosine to an ulp or so, in arithmetic alone: the same in every lane.

    The polynomials and the three parts of π/2 are those of fdlibm (Sun Microsystems, 1993), good
    for angles up to 1e6.
    """
    quarter = np.floor(angle * 0.6366197723675814 + 0.5)
    x = angle - quarter * 1.57079632673412561417
    x = (x - quarter * 6.07710050630396597660e-11) - quarter * 2.02226624879595063154e-21
    z = x * x
    s = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    s = 2.75573137070700676789e-06 + z * s
    s = -1.98412698298579493134e-04 + z * s
    s = 8.33333333332248946124e-03 + z * s
    s = -1.66666666666666324348e-01 + z * s
    s = x + x * z * s
    c = 2.08757232129817482790e-09 + z * -1.13596475577881948265e-11
    c = -2.75573143513906633035e-07 + z * c
    c = 2.48015872894767294178e-05 + z * c
    c = -1.38888888888741095749e-03 + z * c
    c = 4.16666666666666019037e-02 + z * c
    c = (1.0 - 0.5 * z) + z * z * c
    quarter -= 4.0 * np.floor(0.25 * quarter)
    odd = quarter - 2.0 * np.floor(0.5 * quarter) > 0.5
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if quarter > 1.5 else sine
    cosine = -cosine if abs(quarter - 1.5) < 1.0 else cosine
    return sine, cosine


@inner
def _any_lane(counts, lanes):
    total = 0.0
    for k in range(lanes):
        total += counts[k]
    return total > 0.0


@compiled
def place(state, output, rods, world, chosen, postures, speeds):
    """Place the chosen arms; their servos hold the posture, stop the joints or are slack."""
    segments = rods.shape[0]
    count = output.shape[0] // (5 * segments + 2)
    size = count * segments
    turned = 3 * size + 2 * count
    is_position, is_torque = world[0].is_position > 0.0, world[0].is_torque > 0.0
    for row in range(chosen.shape[0]):
        arm = chosen[row]
        block, k = arm // LANES, arm % LANES
        angle = speed = x = y = parent_angle = parent_speed = 0.0
        for i in range(segments):
            a = state[block, i]
            angle += postures[row, i]
            speed += speeds[row, i]
            a.angle[k] = angle
            a.speed[k] = speed
            a.lag_x[k] = 0.0
            a.lag_y[k] = 0.0
            a.held[k] = np.nan
            a.yields[k] = 1.0
            a.limit[k] = 0.0 if is_torque else world[0].substep * world[0].torque_limit
            least, most = rods[i].lowest_angle, rods[i].highest_angle
            if not is_position:
                a.asked[k] = 0.0
            elif np.isfinite(least):
                a.asked[k] = min(max(postures[row, i], least), most)
            else:
                a.asked[k] = angle - parent_angle
            sine, cosine = _sine_cosine(angle)
            x += rods[i].length * cosine
            y += rods[i].length * sine
            at = arm * segments + i
            output[at] = angle
            output[size + at] = angle - parent_angle
            output[2 * size + at] = speed - parent_speed
            sine, cosine = _sine_cosine(angle - parent_angle)
            output[turned + at] = cosine
            output[turned + size + at] = sine
            parent_angle, parent_speed = angle, speed
        output[3 * size + 2 * arm] = x
        output[3 * size + 2 * arm + 1] = y


@compiled
def command(state, output, rods, world, values):
    """Hand one value per joint and arm to the servos."""
    segments = rods.shape[0]
    count = values.shape[0]
    size = count * segments
    w = world[0]
    for arm in range(count):
        block, k = arm // LANES, arm % LANES
        for i in range(segments):
            a = state[block, i]
            value = values[arm, i]
            if w.is_torque > 0.0:
                a.asked[k] = w.speed_limit if value >= 0.0 else -w.speed_limit
                a.limit[k] = w.substep * min(abs(value), w.torque_limit)
            elif w.is_position > 0.0:
                if np.isfinite(rods[i].lowest_angle):
                    a.asked[k] = min(max(value, rods[i].lowest_angle), rods[i].highest_angle)
                else:
                    angle = output[size + arm * segments + i]
                    way = value - angle
                    turns = np.rint(way / (2.0 * np.pi))
                    a.asked[k] = angle + (way - turns * (2.0 * np.pi))
            else:
                a.asked[k] = value


@compiled
def step_blocks(state, output, rods, world, substeps, first, last):
    """Simulate the blocks of `state` from `first` to before `last`; write `output`."""
    count = output.shape[0] // (5 * rods.shape[0] + 2)
    segments = rods.shape[0]
    work = np.zeros(segments, WORK)
    sums = np.zeros(1, SUMS)
    matrix = np.zeros((segments, segments, LANES))
    factor = np.zeros((segments, segments, LANES))
    inward = np.arange(segments - 1, -1, -1)
    has_field = np.abs(world[0].field).max() > 0.0
    for block in range(first, last):
        arms = state[block]
        lanes = min(LANES, count - block * LANES)
        _look(arms, work, lanes)
        _release(work, lanes)
        for _ in range(substeps):
            _move(arms, work, sums[0], rods, world[0], lanes)
            if has_field:
                _weigh(work, sums[0], matrix, rods, inward, lanes)
                _burden(arms, work, sums[0], rods, world[0], inward, lanes)
                _push(arms, work, sums[0], matrix, factor, rods, world[0], inward, lanes)
            else:
                _push_nothing(sums[0], lanes)
            _ask(arms, work, sums[0], rods, world[0], lanes)
            if _need(arms, work, sums[0], rods, world[0], inward, lanes):
                _guess(arms, work, sums[0], world[0], lanes)
                _weigh(work, sums[0], matrix, rods, inward, lanes)
                _limit(work, sums[0], matrix, factor, inward, lanes)
            else:
                _release(work, lanes)
            _turn(arms, work, sums[0], lanes)
        _read(arms, work, sums[0], output, rods, block, lanes)


@inner
def _look(arms, work, lanes):
    for i in range(arms.shape[0]):
        a, w = arms[i], work[i]
        for k in range(lanes):
            w.sine[k], w.cosine[k] = _sine_cosine(a.angle[k])


@inner
def _move(arms, work, sums, rods, world, lanes):
    """Turn the segments; `sums` velocity is what brings the last centre from where its rod was."""
    h = world.substep
    rate = 1.0 / h
    segments = arms.shape[0]
    sums.velocity_x[:lanes] = 0.0
    sums.velocity_y[:lanes] = 0.0
    for i in range(segments):
        a, w = arms[i], work[i]
        carried = rods[i].centre if i == segments - 1 else rods[i].length
        for k in range(lanes):
            speed, sine, cosine = a.speed[k], w.sine[k], w.cosine[k]
            lag_x, lag_y = a.lag_x[k], a.lag_y[k]
            angle = a.angle[k] + h * speed
            new_sine, new_cosine = _sine_cosine(angle)
            new_lag_x = (new_cosine - cosine) * rate + speed * sine
            new_lag_y = (new_sine - sine) * rate - speed * cosine
            w.free_x[k] = lag_x - new_lag_x - sine * speed
            w.free_y[k] = lag_y - new_lag_y + cosine * speed
            sums.velocity_x[k] += carried * ((new_cosine - cosine) * rate + lag_x)
            sums.velocity_y[k] += carried * ((new_sine - sine) * rate + lag_y)
            a.lag_x[k] = new_lag_x
            a.lag_y[k] = new_lag_y
            a.angle[k] = angle
            w.sine[k] = new_sine
            w.cosine[k] = new_cosine


@inner
def _push_nothing(sums, lanes):
    for k in range(lanes):
        sums.x[k] = 0.0
        sums.y[k] = 0.0
        sums.turn[k] = 0.0


@inner
def _burden(arms, work, sums, rods, world, inward, lanes):
    """Find the impulse that each joint must give, for its speed to stay as it is: `needed`."""
    _push_nothing(sums, lanes)
    for i in range(arms.shape[0]):
        a, w = arms[i], work[i]
        for k in range(lanes):
            w.wanted[k] = a.speed[k] - sums.turn[k]
            sums.turn[k] = a.speed[k]
    _push_nothing(sums, lanes)
    _need(arms, work, sums, rods, world, inward, lanes)


@inner
def _push(arms, work, sums, matrix, factor, rods, world, inward, lanes):
    """Find the field's impulse on the hand, `sums` x and y, and its moment, turn.

    `mmc_gym.body.force_field` says how.
    """
    segments = arms.shape[0]
    sums.x[:lanes] = 0.0
    sums.y[:lanes] = 0.0
    for i in inward:
        w = work[i]
        length = rods[i].length
        for k in range(lanes):
            sums.x[k] += length * w.cosine[k]
            sums.y[k] += length * w.sine[k]
            w.load_x[k] = -sums.y[k]  # the way of the hand per angle of the joint
            w.load_y[k] = sums.x[k]
    for k in range(lanes):
        sums.mobility_xx[k] = 0.0
        sums.mobility_xy[k] = 0.0
        sums.mobility_yy[k] = 0.0
    for axis in range(2):
        for i in range(segments):
            a, w = arms[i], work[i]
            for k in range(lanes):
                way = w.load_x[k] if axis == 0 else w.load_y[k]
                w.right[k] = way * a.yields[k]
            for j in range(segments):
                b = arms[j]
                same = 1.0 if i == j else 0.0
                for k in range(lanes):
                    both = a.yields[k] * b.yields[k] > 0.0
                    factor[i, j, k] = matrix[i, j, k] if both else same
        _solve(work, sums, factor, inward, lanes)
        for i in range(segments):
            a, w = arms[i], work[i]
            for k in range(lanes):
                along_x = w.load_x[k] * w.excess[k]
                along_y = w.load_y[k] * w.excess[k]
                sums.mobility_xx[k] += along_x if axis == 0 else 0.0
                sums.mobility_xy[k] += along_y if axis == 0 else 0.0
                sums.mobility_yy[k] += 0.0 if axis == 0 else along_y
                change = w.needed[k] * w.excess[k]
                sums.velocity_x[k] -= change if axis == 0 else 0.0
                sums.velocity_y[k] -= 0.0 if axis == 0 else change
    sums.turn[:lanes] = 0.0
    for i in range(segments):
        a, w = arms[i], work[i]
        for k in range(lanes):
            speed = a.speed[k] - sums.turn[k]
            sums.turn[k] = a.speed[k]
            sums.velocity_x[k] += speed * w.load_x[k]
            sums.velocity_y[k] += speed * w.load_y[k]
    w, speeds = work[segments - 1], arms[segments - 1].speed
    reach = rods[segments - 1].length - rods[segments - 1].centre
    half = 0.5 * world.substep
    xx, xy, yx, yy = world.field[0, 0], world.field[0, 1], world.field[1, 0], world.field[1, 1]
    for k in range(lanes):
        along, across, other = sums.mobility_xx[k], sums.mobility_xy[k], sums.mobility_yy[k]
        a = 1.0 - half * (xx * along + xy * across)
        b = -half * (xx * across + xy * other)
        c = -half * (yx * along + yy * across)
        d = 1.0 - half * (yx * across + yy * other)
        # Twice the mean velocity: the rod's before, and the rigid rods' and their pivots' after.
        x = sums.velocity_x[k] - reach * w.sine[k] * speeds[k]
        y = sums.velocity_y[k] + reach * w.cosine[k] * speeds[k]
        push_x = half * (xx * x + xy * y)
        push_y = half * (yx * x + yy * y)
        scale = 1.0 / (a * d - b * c)
        sums.x[k] = scale * (d * push_x - b * push_y)
        sums.y[k] = scale * (a * push_y - c * push_x)
        sums.turn[k] = reach * (w.cosine[k] * sums.y[k] - w.sine[k] * sums.x[k])


@inner
def _ask(arms, work, sums, rods, world, lanes):
    """Find what each joint wants, with which impulses, and how much faster its stop allows."""
    fastest, gain, stop, rate = world.speed_limit, world.gain, world.stop_gain, 1.0 / world.substep
    is_position = world.is_position > 0.0
    sums.angle[:lanes] = 0.0
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
def _need(arms, work, sums, rods, world, inward, lanes):
    """Find the impulses that give all joints what they want; tell whether any is out of bounds."""
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
    return _any_lane(sums.changed, lanes)


@inner
def _turn(arms, work, sums, lanes):
    """Give the segments the velocities that the joints have found."""
    sums.turn[:lanes] = 0.0
    for i in range(arms.shape[0]):
        a, w = arms[i], work[i]
        for k in range(lanes):
            speed = sums.turn[k] + (w.wanted[k] + w.excess[k])
            sums.turn[k] = speed
            a.speed[k] = speed
            a.yields[k] = 1.0 if abs(w.bound[k]) == 1.0 else 0.0


@inner
def _read(arms, work, sums, output, rods, block, lanes):
    """Write what the arms show: segment angles, joint angles, joint velocities, hands.

    Last come the cosines and sines of the joint angles, which observations tell.
    """
    segments = arms.shape[0]
    count = output.shape[0] // (5 * segments + 2)
    size = count * segments
    turned = 3 * size + 2 * count
    sums.x[:lanes] = 0.0
    sums.y[:lanes] = 0.0
    for i in range(segments):
        w = work[i]
        length = rods[i].length
        for k in range(lanes):
            sums.x[k] += length * w.cosine[k]
            sums.y[k] += length * w.sine[k]
    sums.angle[:lanes] = 0.0
    for i in range(segments):
        a, w = arms[i], work[i]
        for k in range(lanes):
            w.moment_y[k], w.moment_x[k] = _sine_cosine(a.angle[k] - sums.angle[k])
            sums.angle[k] = a.angle[k]
    for k in range(lanes):
        arm = block * LANES + k
        parent_angle = parent_speed = 0.0
        for i in range(segments):
            angle, speed = arms[i].angle[k], arms[i].speed[k]
            at = arm * segments + i
            output[turned + at] = work[i].moment_x[k]
            output[turned + size + at] = work[i].moment_y[k]
            output[at] = angle
            output[size + at] = angle - parent_angle
            output[2 * size + at] = speed - parent_speed
            parent_angle, parent_speed = angle, speed
        output[3 * size + 2 * arm] = sums.x[k]
        output[3 * size + 2 * arm + 1] = sums.y[k]


@inner
def _weigh(work, sums, matrix, rods, inward, lanes):
    """Find the mass matrix M from inertia and first moment of the arm beyond the later joint."""
    segments = work.shape[0]
    beyond = 0.0
    sums.x[:lanes] = 0.0
    sums.y[:lanes] = 0.0
    sums.turn[:lanes] = 0.0
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
def _release(work, lanes):
    """Free all joints of their bounds."""
    for i in range(work.shape[0]):
        w = work[i]
        for k in range(lanes):
            w.bound[k] = FREE


@inner
def _guess(arms, work, sums, world, lanes):
    """Guess which bounds bind: those of the last substep, or those that needed impulses pass.

    A torque servo is nearly always at its bound.  A lane that passes none, of which `sums.changed`
    keeps the number, stays free: alone it would not have come here.
    """
    is_torque = world.is_torque > 0.0
    sums.x[:lanes] = 0.0
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
def _limit(work, sums, matrix, factor, inward, lanes):
    """Find z, by which each joint's velocity differs from the wanted one: `excess`."""
    segments = work.shape[0]
    for attempt in range(10 * segments + 50):
        _prescribe(work, sums, matrix, factor, lanes)
        _solve(work, sums, factor, inward, lanes)
        # Changing all wrong guesses at once is quick and may cycle; one at a time never does.
        if not _revise(work, sums, matrix, attempt > segments + 5, lanes):
            break


@inner
def _prescribe(work, sums, matrix, factor, lanes):
    """Set up equations for the joints at a bound; others move as they want or their stop allows."""
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
def _solve(work, sums, factor, inward, lanes):
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
def _revise(work, sums, matrix, one_by_one, lanes):
    """Change the guesses that the solution contradicts; tell whether there were any."""
    segments = work.shape[0]
    single = 1.0 if one_by_one else 0.0
    sums.changed[:lanes] = 0.0
    sums.turn[:lanes] = 0.0
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
            lowest, highest = w.lowest[k], w.highest[k]
            below, above = w.stop_below[k], w.stop_above[k]
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
    return _any_lane(sums.turn, lanes)
