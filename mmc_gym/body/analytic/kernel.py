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
neighbours, its lane or the machine's vector width.  The compiler turns a loop over lanes into
vector instructions only if it sees, or can check once before the loop, that nothing it writes is
read again, and if there are no other loops in it.  So blocks of arms are records of arrays, whose
fields do not overlap, and whose shapes are part of their type: loops over few segments are written
out, and a step of three takes two thirds of the time that it takes with loops over lanes alone (one
of ten a quarter more).  numba compiles anew for each number of segments.  The
number of lanes is an argument, because constant loops would be written out first.

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
_TINY = 1e-12  # rad/s: less is not worth another guess
_STOP_RATE = -60 * math.log(0.9)  # a stop corrects 10 % of its error in 1/60 s, pymunk's default


def _record(names: str, shape: tuple[int, ...] = ()) -> np.dtype[np.void]:
    return np.dtype([(name, np.float64, shape) for name in names.split()])


# What an arm remembers, per segment and the joint before it: `lag` is the part of the velocity of
# u_j that closes the pivots; `asked` is what the servo is to do, with at most the impulse `limit`;
# `held` is the angle of a locked joint, or nan; `yields` is 1 where the servo gave all it could.
STATE = "angle speed lag_x lag_y asked limit held yields"
# What one physics step works with, per segment, and per arm.
WORK = (
    "sine cosine free_x free_y wanted turn lowest highest stop_above stop_below load_x load_y "
    "needed bound moment_x moment_y right inverse excess joint_sine joint_cosine"
)
SUMS = "push_x push_y push_turn velocity_x velocity_y changed is_done"
# The segments, each with the joint before it, and what is common to them.
RODS = _record("length mass centre inertia lowest_angle highest_angle")
SCALARS = _record("substep speed_limit torque_limit gain stop_gain is_position is_torque")
WORLD = np.dtype([*SCALARS.descr, ("gravity", np.float64, (2,)), ("field", np.float64, (2, 2))])


def lanes_of(segments: int) -> int:
    """Return how many arms are in a block: so many that what it works with fits the cache."""
    return 32 if segments <= 4 else 8


def make_state(segments: int, count: int) -> NDArray[np.void]:
    """Return blocks of arms, one record each: `STATE`, arrays (N, lanes)."""
    lanes = lanes_of(segments)
    return np.zeros(-(-count // lanes), _record(STATE, (segments, lanes)))


def no_work(segments: int) -> NDArray[np.void]:
    """Return an empty array of the records that a physics step works with."""
    lanes = lanes_of(segments)
    fields = [
        *_record(WORK, (segments, lanes)).descr,
        *_record(SUMS, (lanes,)).descr,
        *_record("matrix factor", (segments, segments, lanes)).descr,
    ]
    return np.empty(0, fields)


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
    block_size = state[0].angle.shape[1]
    for row in range(chosen.shape[0]):
        arm = chosen[row]
        arms, k = state[arm // block_size], arm % block_size
        angle = speed = x = y = parent_angle = parent_speed = 0.0
        for i in range(segments):
            angle += postures[row, i]
            speed += speeds[row, i]
            arms.angle[i, k] = angle
            arms.speed[i, k] = speed
            arms.lag_x[i, k] = 0.0
            arms.lag_y[i, k] = 0.0
            arms.held[i, k] = np.nan
            arms.yields[i, k] = 1.0
            arms.limit[i, k] = 0.0 if is_torque else world[0].substep * world[0].torque_limit
            least, most = rods[i].lowest_angle, rods[i].highest_angle
            if not is_position:
                arms.asked[i, k] = 0.0
            elif np.isfinite(least):
                arms.asked[i, k] = min(max(postures[row, i], least), most)
            else:
                arms.asked[i, k] = angle - parent_angle
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
def command(state, output, rods, world, values, scale, is_relative, first_block, last_block):
    """Hand one value per joint and arm to the servos: `scale` times `values`, (count, N).

    If they are relative, the present joint angle is added.
    """
    segments, count = rods.shape[0], values.shape[0]
    size = count * segments
    w = world[0]
    is_torque, is_position = w.is_torque > 0.0, w.is_position > 0.0
    for block in range(first_block, last_block):
        arms = state[block]
        first = block * arms.angle.shape[1]
        lanes = min(arms.angle.shape[1], count - first)
        for i in range(segments):
            least, most = rods[i].lowest_angle, rods[i].highest_angle
            is_limited = np.isfinite(least)
            for k in range(lanes):
                angle = output[size + (first + k) * segments + i]
                value = scale * values[first + k, i]
                value = value + angle if is_relative else value
                if is_torque:
                    arms.asked[i, k] = w.speed_limit if value >= 0.0 else -w.speed_limit
                    arms.limit[i, k] = w.substep * min(abs(value), w.torque_limit)
                elif is_position and is_limited:
                    arms.asked[i, k] = min(max(value, least), most)
                elif is_position:
                    way = value - angle
                    turns = np.rint(way / (2.0 * np.pi))
                    arms.asked[i, k] = angle + (way - turns * (2.0 * np.pi))
                else:
                    arms.asked[i, k] = value


@compiled
def step_blocks(state, output, rods, world, no_work, substeps, first, last):
    """Simulate the blocks of `state` from `first` to before `last`; write `output`."""
    segments = rods.shape[0]
    count = output.shape[0] // (5 * segments + 2)
    works = np.zeros(1, no_work.dtype)
    has_field = np.abs(world[0].field).max() > 0.0
    for block in range(first, last):
        work = works[0]  # here, because a record does not keep its array alive
        arms = state[block]
        first_arm = block * arms.angle.shape[1]
        lanes = min(arms.angle.shape[1], count - first_arm)
        _look(arms, work, lanes)
        for _ in range(substeps):
            _move(arms, work, rods, world[0], lanes)
            if has_field:
                _weigh(work, rods, lanes)
                _burden(arms, work, rods, world[0], lanes)
                _push(arms, work, rods, world[0], lanes)
            _ask(arms, work, rods, world[0], lanes)
            if _need(arms, work, rods, world[0], lanes):
                _guess(arms, work, world[0], lanes)
                _weigh(work, rods, lanes)
                _limit(work, lanes)
            else:
                _release(work, lanes)
            _turn(arms, work, lanes)
        _read(arms, work, output, rods, first_arm, lanes)


@inner
def _look(arms, work, lanes):
    """Find where the segments point; no joint is bound, and nothing pushes the hand."""
    for k in range(lanes):
        work.push_x[k] = 0.0
        work.push_y[k] = 0.0
        work.push_turn[k] = 0.0
        for i in range(arms.angle.shape[0]):
            work.bound[i, k] = FREE
            work.sine[i, k], work.cosine[i, k] = _sine_cosine(arms.angle[i, k])


@inner
def _move(arms, work, rods, world, lanes):
    """Turn the segments; `velocity` is what brings the last centre from where its rod was."""
    h = world.substep
    rate = 1.0 / h
    segments = arms.angle.shape[0]
    for k in range(lanes):
        work.velocity_x[k] = 0.0
        work.velocity_y[k] = 0.0
    for i in range(segments):
        carried = rods[i].centre if i == segments - 1 else rods[i].length
        for k in range(lanes):
            speed, sine, cosine = arms.speed[i, k], work.sine[i, k], work.cosine[i, k]
            lag_x, lag_y = arms.lag_x[i, k], arms.lag_y[i, k]
            angle = arms.angle[i, k] + h * speed
            new_sine, new_cosine = _sine_cosine(angle)
            new_lag_x = (new_cosine - cosine) * rate + speed * sine
            new_lag_y = (new_sine - sine) * rate - speed * cosine
            work.free_x[i, k] = lag_x - new_lag_x - sine * speed
            work.free_y[i, k] = lag_y - new_lag_y + cosine * speed
            work.velocity_x[k] += carried * ((new_cosine - cosine) * rate + lag_x)
            work.velocity_y[k] += carried * ((new_sine - sine) * rate + lag_y)
            arms.lag_x[i, k] = new_lag_x
            arms.lag_y[i, k] = new_lag_y
            arms.angle[i, k] = angle
            work.sine[i, k] = new_sine
            work.cosine[i, k] = new_cosine


@inner
def _burden(arms, work, rods, world, lanes):
    """Find the impulse that each joint must give, for its speed to stay as it is: `needed`."""
    for k in range(lanes):
        work.push_x[k] = 0.0
        work.push_y[k] = 0.0
        work.push_turn[k] = 0.0
        parent = 0.0
        for i in range(arms.speed.shape[0]):
            work.wanted[i, k] = arms.speed[i, k] - parent
            parent = arms.speed[i, k]
    _need(arms, work, rods, world, lanes)


@inner
def _push(arms, work, rods, world, lanes):
    """Find the field's impulse on the hand, `push_x` and `push_y`, and its moment, `push_turn`.

    `mmc_gym.body.force_field` says how.
    """
    segments = arms.angle.shape[0]
    reach = rods[segments - 1].length - rods[segments - 1].centre
    half = 0.5 * world.substep
    xx, xy, yx, yy = world.field[0, 0], world.field[0, 1], world.field[1, 0], world.field[1, 1]
    for k in range(lanes):
        x = y = 0.0
        for m in range(segments):
            i = segments - 1 - m
            x += rods[i].length * work.cosine[i, k]
            y += rods[i].length * work.sine[i, k]
            work.load_x[i, k] = -y  # the way of the hand per angle of the joint
            work.load_y[i, k] = x
        along = across = other = 0.0  # the hand's mobility
        velocity_x, velocity_y = work.velocity_x[k], work.velocity_y[k]
        _let_yield(arms, work, work.load_x, k)
        for i in range(segments):
            along += work.load_x[i, k] * work.excess[i, k]
            across += work.load_y[i, k] * work.excess[i, k]
            velocity_x -= work.needed[i, k] * work.excess[i, k]
        _let_yield(arms, work, work.load_y, k)
        for i in range(segments):
            other += work.load_y[i, k] * work.excess[i, k]
            velocity_y -= work.needed[i, k] * work.excess[i, k]
        parent = 0.0
        for i in range(segments):
            speed = arms.speed[i, k] - parent
            parent = arms.speed[i, k]
            velocity_x += speed * work.load_x[i, k]
            velocity_y += speed * work.load_y[i, k]
        a = 1.0 - half * (xx * along + xy * across)
        b = -half * (xx * across + xy * other)
        c = -half * (yx * along + yy * across)
        d = 1.0 - half * (yx * across + yy * other)
        # Twice the mean velocity: the rod's before, and the rigid rods' and their pivots' after.
        sine, cosine = work.sine[segments - 1, k], work.cosine[segments - 1, k]
        x = velocity_x - reach * sine * arms.speed[segments - 1, k]
        y = velocity_y + reach * cosine * arms.speed[segments - 1, k]
        push_x = half * (xx * x + xy * y)
        push_y = half * (yx * x + yy * y)
        scale = 1.0 / (a * d - b * c)
        x = scale * (d * push_x - b * push_y)
        y = scale * (a * push_y - c * push_x)
        work.push_x[k] = x
        work.push_y[k] = y
        work.push_turn[k] = reach * (cosine * y - sine * x)


@inner
def _let_yield(arms, work, impulse, k):
    """Find by how much an impulse speeds up the joints that give way: `excess`."""
    segments = arms.yields.shape[0]
    for i in range(segments):
        work.right[i, k] = impulse[i, k] * arms.yields[i, k]
        for j in range(segments):
            both = arms.yields[i, k] * arms.yields[j, k] > 0.0
            work.factor[i, j, k] = work.matrix[i, j, k] if both else 1.0 if i == j else 0.0
    _solve(work, k)


@inner
def _ask(arms, work, rods, world, lanes):
    """Find what each joint wants, with which impulses, and how much faster its stop allows."""
    fastest, gain, stop, rate = world.speed_limit, world.gain, world.stop_gain, 1.0 / world.substep
    is_position = world.is_position > 0.0
    for k in range(lanes):
        parent = 0.0
        for i in range(arms.angle.shape[0]):
            least, most = rods[i].lowest_angle, rods[i].highest_angle
            angle = arms.angle[i, k] - parent
            parent = arms.angle[i, k]
            asked, limit, held = arms.asked[i, k], arms.limit[i, k], arms.held[i, k]
            wanted = gain * (asked - angle) if is_position else asked
            wanted = fastest if wanted > fastest else wanted
            wanted = -fastest if wanted < -fastest else wanted
            above = stop * (most - angle) if angle > most else np.inf
            below = stop * (least - angle) if angle < least else -np.inf
            lowest = -np.inf if wanted > above else -limit
            highest = np.inf if wanted < below else limit
            wanted = above if wanted > above else wanted
            wanted = below if wanted < below else wanted
            locked = held == held
            wanted = rate * (held - angle) if locked else wanted
            work.wanted[i, k] = wanted
            work.lowest[i, k] = -np.inf if locked else lowest
            work.highest[i, k] = np.inf if locked else highest
            work.stop_above[i, k] = above - wanted
            work.stop_below[i, k] = below - wanted


@inner
def _need(arms, work, rods, world, lanes):
    """Find the impulses that give all joints what they want; tell whether any is out of bounds."""
    segments = arms.angle.shape[0]
    last = segments - 1
    fall_x, fall_y = world.substep * world.gravity[0], world.substep * world.gravity[1]
    for k in range(lanes):
        x = y = turn = 0.0
        for i in range(segments):
            length, mass, centre = rods[i].length, rods[i].mass, rods[i].centre
            turn = turn + work.wanted[i, k]
            change_x = -work.sine[i, k] * turn - work.free_x[i, k]
            change_y = work.cosine[i, k] * turn - work.free_y[i, k]
            work.load_x[i, k] = mass * ((x + centre * change_x) - fall_x)
            work.load_y[i, k] = mass * ((y + centre * change_y) - fall_y)
            x += length * change_x
            y += length * change_y
            work.turn[i, k] = turn
        work.load_x[last, k] -= work.push_x[k]
        work.load_y[last, k] -= work.push_y[k]
        needed = -work.push_turn[k]
        x = y = beyond = 0.0
        for m in range(segments):
            i = segments - 1 - m
            length, centre, inertia = rods[i].length, rods[i].centre, rods[i].inertia
            load_x, load_y = work.load_x[i, k], work.load_y[i, k]
            push_x = length * x + centre * load_x
            push_y = length * y + centre * load_y
            torque = work.cosine[i, k] * push_y - work.sine[i, k] * push_x
            needed = needed + torque + inertia * (work.turn[i, k] - arms.speed[i, k])
            x += load_x
            y += load_y
            work.needed[i, k] = needed
            work.excess[i, k] = 0.0
            is_beyond = (needed > work.highest[i, k]) | (needed < work.lowest[i, k])
            beyond += 1.0 if is_beyond else 0.0
        work.changed[k] = beyond
    return _any_lane(work.changed, lanes)


@inner
def _turn(arms, work, lanes):
    """Give the segments the velocities that the joints have found."""
    for k in range(lanes):
        speed = 0.0
        for i in range(arms.speed.shape[0]):
            speed = speed + (work.wanted[i, k] + work.excess[i, k])
            arms.speed[i, k] = speed
            arms.yields[i, k] = 1.0 if abs(work.bound[i, k]) == 1.0 else 0.0


@inner
def _read(arms, work, output, rods, first, lanes):
    """Write what the arms show: segment angles, joint angles, joint velocities, hands.

    Last come the cosines and sines of the joint angles, which observations tell.
    """
    segments = rods.shape[0]
    count = output.shape[0] // (5 * segments + 2)
    size = count * segments
    turned = 3 * size + 2 * count
    for k in range(lanes):
        parent = 0.0
        for i in range(arms.angle.shape[0]):
            angle = arms.angle[i, k]
            work.joint_sine[i, k], work.joint_cosine[i, k] = _sine_cosine(angle - parent)
            parent = angle
    for k in range(lanes):
        arm = first + k
        x = y = parent_angle = parent_speed = 0.0
        for i in range(segments):
            angle, speed = arms.angle[i, k], arms.speed[i, k]
            at = arm * segments + i
            output[at] = angle
            output[size + at] = angle - parent_angle
            output[2 * size + at] = speed - parent_speed
            output[turned + at] = work.joint_cosine[i, k]
            output[turned + size + at] = work.joint_sine[i, k]
            x += rods[i].length * work.cosine[i, k]
            y += rods[i].length * work.sine[i, k]
            parent_angle, parent_speed = angle, speed
        output[3 * size + 2 * arm] = x
        output[3 * size + 2 * arm + 1] = y


@inner
def _weigh(work, rods, lanes):
    """Find the mass matrix M from inertia and first moment of the arm beyond the later joint."""
    segments = work.sine.shape[0]
    for k in range(lanes):
        x = y = inertia = beyond = 0.0
        for m in range(segments):
            j = segments - 1 - m
            length, mass, centre = rods[j].length, rods[j].mass, rods[j].centre
            own = mass * centre * centre + rods[j].inertia + beyond * length * length
            moment = mass * centre + beyond * length
            beyond += mass
            cosine, sine = work.cosine[j, k], work.sine[j, k]
            inertia = (inertia + 2.0 * length * (cosine * x + sine * y)) + own
            x = x + moment * cosine
            y = y + moment * sine
            work.matrix[j, j, k] = inertia
            work.moment_x[j, k] = x
            work.moment_y[j, k] = y
        for j in range(segments):
            x = y = 0.0
            for m in range(segments):
                i = segments - 1 - m
                if i < j:
                    x = x + rods[i].length * work.cosine[i, k]
                    y = y + rods[i].length * work.sine[i, k]
                    along = work.moment_x[j, k] * x
                    across = work.moment_y[j, k] * y
                    work.matrix[j, i, k] = work.matrix[j, j, k] + along + across
                    work.matrix[i, j, k] = work.matrix[j, i, k]


@inner
def _release(work, lanes):
    """Free all joints of their bounds."""
    for k in range(lanes):
        for i in range(work.bound.shape[0]):
            work.bound[i, k] = FREE


@inner
def _guess(arms, work, world, lanes):
    """Guess which bounds bind: those of the last substep, or those that needed impulses pass.

    A torque servo is nearly always at its bound.  A lane that passes none, of which `changed` keeps
    the number, stays free: alone it would not have come here.
    """
    is_torque = world.is_torque > 0.0
    for k in range(lanes):
        bounds = 0.0
        for i in range(arms.asked.shape[0]):
            bounds += abs(work.bound[i, k])
        for i in range(arms.asked.shape[0]):
            needed, lowest, highest = work.needed[i, k], work.lowest[i, k], work.highest[i, k]
            above, below = work.stop_above[i, k], work.stop_below[i, k]
            last, asked = work.bound[i, k], arms.asked[i, k]
            new = AT_HIGHEST if needed > highest else FREE
            new = AT_LOWEST if needed < lowest else new
            pushed = AT_HIGHEST if asked > 0.0 else AT_LOWEST
            new = pushed if is_torque else new
            new = last if bounds > 0.0 else new
            new = FREE if (new == AT_HIGHEST) & (highest == np.inf) else new
            new = FREE if (new == AT_LOWEST) & (lowest == -np.inf) else new
            new = FREE if (new == STOPPED_ABOVE) & (above == np.inf) else new
            new = FREE if (new == STOPPED_BELOW) & (below == -np.inf) else new
            work.bound[i, k] = new if work.changed[k] > 0.0 else FREE


@inner
def _limit(work, lanes):
    """Find z, by which each joint's velocity differs from the wanted one: `excess`."""
    segments = work.bound.shape[0]
    for attempt in range(10 * segments + 50):
        # Changing all wrong guesses at once is quick and may cycle; one at a time never does.
        one_by_one = 1.0 if attempt > segments + 5 else 0.0
        _prescribe(work, lanes)
        for k in range(lanes):
            _solve(work, k)
        if not _revise(work, one_by_one, lanes):
            break


@inner
def _prescribe(work, lanes):
    """Set up equations for the joints at a bound; others move as they want or their stop allows."""
    segments = work.bound.shape[0]
    for i in range(segments):
        for k in range(lanes):
            bound, below, above = work.bound[i, k], work.stop_below[i, k], work.stop_above[i, k]
            stop = below if bound > 0.0 else above
            work.excess[i, k] = stop if abs(bound) == 2.0 else 0.0
    for i in range(segments):
        for k in range(lanes):
            bound, lowest, highest = work.bound[i, k], work.lowest[i, k], work.highest[i, k]
            right = (highest if bound > 0.0 else lowest) - work.needed[i, k]
            for j in range(segments):
                entry = work.matrix[i, j, k]
                right -= entry * work.excess[j, k]
                both = (abs(bound) == 1.0) & (abs(work.bound[j, k]) == 1.0)
                same = 1.0 if i == j else 0.0
                work.factor[i, j, k] = entry if both else same
            excess = work.excess[i, k]
            work.right[i, k] = right if abs(bound) == 1.0 else excess


@inner
def _solve(work, k):
    """Solve factor · excess = right by L D Lᵀ."""
    factor, right, excess = work.factor, work.right, work.excess
    segments = right.shape[0]
    for j in range(segments):
        work.inverse[j, k] = 1.0 / factor[j, j, k]
        for i in range(segments):
            if i > j:
                ratio = factor[i, j, k] * work.inverse[j, k]
                right[i, k] -= ratio * right[j, k]
                for m in range(segments):
                    if j < m <= i:
                        factor[i, m, k] -= ratio * factor[m, j, k]
    for m in range(segments):
        i = segments - 1 - m
        total = right[i, k]
        for j in range(segments):
            if j > i:
                total -= factor[j, i, k] * excess[j, k]
        excess[i, k] = total * work.inverse[i, k]


@inner
def _revise(work, one_by_one, lanes):
    """Change the guesses that the solution contradicts; tell whether there were any."""
    segments = work.bound.shape[0]
    for k in range(lanes):
        work.changed[k] = 0.0
        work.is_done[k] = 0.0
    for i in range(segments):
        for k in range(lanes):
            impulse = work.needed[i, k]
            for j in range(segments):
                impulse += work.matrix[i, j, k] * work.excess[j, k]
            bound, excess, is_done = work.bound[i, k], work.excess[i, k], work.is_done[k]
            lowest, highest = work.lowest[i, k], work.highest[i, k]
            below, above = work.stop_below[i, k], work.stop_above[i, k]
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
            new = bound if is_done > 0.0 else new
            work.bound[i, k] = new
            work.is_done[k] = one_by_one if new != bound else is_done
            work.changed[k] += 1.0 if new != bound else 0.0
    return _any_lane(work.changed, lanes)
