"""Compiled physics steps of planar chains: blocks of arms, side by side in lanes.

Segment j points along u_j = (cos θ_j, sin θ_j), and n_j = (−sin θ_j, cos θ_j) is across it.  As in
Chipmunk, a step of duration h first moves and then pushes:

    θ' = θ + h ω,       while the rods' centres go straight on with their old velocities
    J'ᵀ μ (v' − v) = h Q,       Q the torques on the segments, μ the masses of the rods

A rod's velocity v has two parts: that of rigid rods on pivots (J ω: each end moves by ω_j n_j
relative to the other), and the part that closes the pivots, because the rods went straight instead
of round (the lag of u_j).  This is the velocity-Verlet (SHAKE) step of the chain, with the
centripetal force of the new step extrapolated from the last two.  It costs as little as an explicit
step, and needs no Coriolis term.  Chipmunk does the same once its pivots are solved to the end and
all of their error is corrected.

The torques are those of the servos, stops and locks.  Each joint asks for a velocity, and may use
impulses between a lowest and a highest one to reach it.  Take q̇ = asked + z, the joint-space mass
matrix M (`_weigh`), and the impulses that would give every joint the velocity it asks for (`_need`,
recursive Newton–Euler).  Then

    λ = needed + M z,   lowest ≤ λ ≤ highest,   z = 0 where λ is between its bounds,
    z ≤ 0 where λ is at the highest and z ≥ 0 where it is at the lowest.

Friction of a torque f adds ±h f to what is needed where a joint slides.  Where a joint rests, its
friction is a drag on the diagonal of M that leaves no speed.  A joint that would slide back rests,
and one whose rest takes more than h f slides (`_rub`).

M is positive definite, so there is one solution.  `_limit` finds it by principal pivoting: guess
which joints are at a bound, solve, change the guess (Júdice & Pires 1994, Computers & Operations
Research 21, 587–596).  A joint thrown against its stop while its servo is at a bound is a further
case.  All lanes are solved together; lanes that are done keep their solution while others continue.

Arms may differ: their parameters are arrays over lanes too, in a record `chain` for each block, or
in one for all blocks if the arms are equal, which then stays in the cache.

Lanes never mix, and no operations are reordered or fused.  So an arm's numbers do not depend on its
neighbours, its lane or the machine's vector width.  The compiler turns a loop over lanes into
vector instructions only if the loop contains no other loop, and if the compiler can tell, at the
latest right before the loop, that nothing written in it is read again.  So blocks of arms are
records of arrays: their fields do not overlap, and their shapes are part of their type, so that
loops over few segments are unrolled, and numba compiles anew for each number of segments.  The
number of lanes is an argument, because constant loops would be unrolled first.

Functions that numba compiles together are in this file, see `mmc_gym._compiling`.
"""

from __future__ import annotations

import numpy as np

from mmc_gym._compiling import compiled, inner, sine_cosine

# What binds a joint: nothing, a bound of its servo, or its stop while the servo is at a bound.
FREE, AT_HIGHEST, AT_LOWEST, STOPPED_ABOVE, STOPPED_BELOW = 0.0, 1.0, -1.0, -2.0, 2.0
_RESTS = 1e-6  # rad/s, the speed below which dry friction holds a joint
_HOLD = 1e9  # impulse per speed, mass · length², that holds it
_TINY = 1e-12  # rad/s: less is not worth another guess


@inner
def _between(absolute, i, k):
    """Return an angle or speed of a joint from those of the segments."""
    return absolute[i, k] - (absolute[i - 1, k] if i > 0 else 0.0)


@compiled
def place(state, shown, chain, no_work, indices, postures, speeds):
    """Place the arms of these indices; their servos hold, stop the joints or are slack."""
    works = np.zeros(1, no_work.dtype)
    segments, lanes = state[0].angle.shape
    is_position, is_torque = chain[0].is_position > 0.0, chain[0].is_torque > 0.0
    for row in range(indices.shape[0]):
        block, k = indices[row] // lanes, indices[row] % lanes
        arms, c = state[block], chain[min(block, chain.shape[0] - 1)]
        angle = speed = 0.0
        for i in range(segments):
            angle += postures[row, i]
            speed += speeds[row, i]
            arms.angle[i, k] = angle
            arms.speed[i, k] = speed
            arms.lag_x[i, k] = 0.0
            arms.lag_y[i, k] = 0.0
            arms.held[i, k] = np.nan
            arms.yields[i, k] = 1.0
            arms.limit[i, k] = 0.0 if is_torque else c.substep * c.torque_limit[k]
            least, most = c.lowest_angle[i, k], c.highest_angle[i, k]
            if not is_position:
                arms.asked[i, k] = 0.0
            elif np.isfinite(least):
                arms.asked[i, k] = min(max(postures[row, i], least), most)
            else:
                arms.asked[i, k] = _between(arms.angle, i, k)
    for block in np.unique(indices // lanes):
        work = works[0]  # here, because a record does not keep its array alive
        _look(state[block], work, lanes)
        c = chain[min(block, chain.shape[0] - 1)]
        _show(state[block], work, c, shown[block * lanes : (block + 1) * lanes])


@compiled
def command(state, chain, values, scale, is_relative):
    """Command `scale` times `values`, (count, N), one value per arm and joint.

    Relative values are added to the present joint angles.
    """
    is_torque, is_position = chain[0].is_torque > 0.0, chain[0].is_position > 0.0
    for block in range(state.shape[0]):
        arms, c = state[block], chain[min(block, chain.shape[0] - 1)]
        first = block * arms.angle.shape[1]
        lanes = min(arms.angle.shape[1], values.shape[0] - first)
        for i in range(arms.angle.shape[0]):
            for k in range(lanes):
                least, most = c.lowest_angle[i, k], c.highest_angle[i, k]
                is_limited = np.isfinite(least)
                angle = _between(arms.angle, i, k)
                value = scale * values[first + k, i]
                value = value + angle if is_relative else value
                if is_torque:
                    arms.asked[i, k] = c.speed_limit[k] if value >= 0.0 else -c.speed_limit[k]
                    arms.limit[i, k] = c.substep * min(abs(value), c.torque_limit[k])
                elif is_position and is_limited:
                    arms.asked[i, k] = min(max(value, least), most)
                elif is_position:
                    way = value - angle
                    turns = np.rint(way / (2.0 * np.pi))
                    arms.asked[i, k] = angle + (way - turns * (2.0 * np.pi))
                else:
                    arms.asked[i, k] = value


@compiled
def step(state, shown, chain, no_work, substeps):
    """Simulate one control step of the arms in `state`, and write their public values."""
    works = np.zeros(1, no_work.dtype)
    for block in range(state.shape[0]):
        work = works[0]  # here, because a record does not keep its array alive
        arms, c = state[block], chain[min(block, chain.shape[0] - 1)]
        first = block * arms.angle.shape[1]
        lanes = min(arms.angle.shape[1], shown.shape[0] - first)
        _look(arms, work, lanes)
        work.push_x[:] = work.push_y[:] = work.push_turn[:] = 0.0  # of another block, with a field
        work.drag[:] = work.friction[:] = 0.0
        has_friction = c.has_friction > 0.0
        for _ in range(substeps):
            _move(arms, work, c, lanes)
            if has_friction:
                _slide(arms, work, c, lanes)
            if c.has_field > 0.0:
                _weigh(work, c, lanes)
                _push(arms, work, c, lanes)
            _ask(arms, work, c, lanes)
            for _ in range(2 * arms.angle.shape[0] + 2 if has_friction else 1):
                if _need(arms, work, c, lanes):
                    _guess(arms, work, c, lanes)
                    _weigh(work, c, lanes)
                    _limit(work, lanes)
                else:
                    work.bound[:] = FREE
                if not has_friction or not _rub(work, lanes):
                    break
            _turn(arms, work, lanes)
        _show(arms, work, c, shown[first : first + lanes])


@inner
def _look(arms, work, lanes):
    """Compute the directions of the segments, and free all joints."""
    work.bound[:] = FREE
    for k in range(lanes):
        for i in range(arms.angle.shape[0]):
            work.sine[i, k], work.cosine[i, k] = sine_cosine(arms.angle[i, k])


@inner
def _move(arms, work, chain, lanes):
    """Turn the segments.  At `velocity` the last rod's centre would follow, onto its pivot."""
    h = chain.substep
    rate = 1.0 / h
    segments = arms.angle.shape[0]
    work.velocity_x[:] = 0.0
    work.velocity_y[:] = 0.0
    for i in range(segments):
        for k in range(lanes):
            carried = chain.centre[i, k] if i == segments - 1 else chain.length[i, k]
            speed, sine, cosine = arms.speed[i, k], work.sine[i, k], work.cosine[i, k]
            lag_x, lag_y = arms.lag_x[i, k], arms.lag_y[i, k]
            angle = arms.angle[i, k] + h * speed
            new_sine, new_cosine = sine_cosine(angle)
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
def _slide(arms, work, chain, lanes):
    """Let joints slide on as before, or rest: find the impulse of their friction, or their drag."""
    for i in range(arms.angle.shape[0]):
        for k in range(lanes):
            speed = _between(arms.speed, i, k)
            torque = chain.joint_friction[k] + chain.joint_damping[k] * abs(speed)
            impulse = chain.substep * torque
            rests = (impulse > 0.0) & (abs(speed) < _RESTS)
            work.grip[i, k] = impulse
            work.friction[i, k] = 0.0 if rests else impulse if speed > 0.0 else -impulse
            work.drag[i, k] = _HOLD if rests else 0.0


@inner
def _rub(work, lanes):
    """Let joints rest that would slide back, and slide if their rest takes too much."""
    changes = 0.0
    for i in range(work.friction.shape[0]):
        for k in range(lanes):
            grip, friction, drag = work.grip[i, k], work.friction[i, k], work.drag[i, k]
            speed = work.demand[i, k] + work.excess[i, k]
            slides = drag * abs(speed) > grip
            rests = friction * speed < 0.0
            moving = grip if speed > 0.0 else -grip
            work.friction[i, k] = moving if slides else 0.0 if rests else friction
            work.drag[i, k] = _HOLD if rests else 0.0 if slides else drag
            changes += 1.0 if slides | rests else 0.0
    return changes > 0.0


@inner
def _push(arms, work, chain, lanes):
    """Compute the field's impulse on the hand, `push_x` and `push_y`, and its moment, `push_turn`.

    `mmc_gym.body.pymunk.linkage.HandField` has the equations.
    """
    segments = arms.angle.shape[0]
    half = 0.5 * chain.substep
    # First, the impulses that the joints must give to keep their speeds.
    work.push_x[:] = 0.0
    work.push_y[:] = 0.0
    work.push_turn[:] = 0.0
    for k in range(lanes):
        for i in range(segments):
            work.demand[i, k] = _between(arms.speed, i, k)
    _need(arms, work, chain, lanes)
    for k in range(lanes):
        reach = chain.length[segments - 1, k] - chain.centre[segments - 1, k]
        xx, xy = chain.field[0, 0, k], chain.field[0, 1, k]
        yx, yy = chain.field[1, 0, k], chain.field[1, 1, k]
        x = y = 0.0
        for i in range(segments - 1, -1, -1):
            x += chain.length[i, k] * work.cosine[i, k]
            y += chain.length[i, k] * work.sine[i, k]
            work.load_x[i, k] = -y  # the Jacobian J
            work.load_y[i, k] = x
        along = across = other = 0.0  # the hand's mobility Λ
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
        for i in range(segments):
            velocity_x += work.demand[i, k] * work.load_x[i, k]
            velocity_y += work.demand[i, k] * work.load_y[i, k]
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
    """Compute how much an impulse changes the speeds of the joints that yield: `excess`."""
    segments = arms.yields.shape[0]
    for i in range(segments):
        work.right[i, k] = impulse[i, k] * arms.yields[i, k]
        for j in range(segments):
            both = arms.yields[i, k] * arms.yields[j, k] > 0.0
            work.factor[i, j, k] = work.matrix[i, j, k] if both else 1.0 if i == j else 0.0
    _solve(work, k)


@inner
def _ask(arms, work, chain, lanes):
    """Compute the speed each joint demands, its range of impulses, and what its stop allows."""
    stop, rate, is_position = chain.stop_gain, 1.0 / chain.substep, chain.is_position > 0.0
    for k in range(lanes):
        fastest, gain = chain.speed_limit[k], chain.gain[k]
        for i in range(arms.angle.shape[0]):
            least, most = chain.lowest_angle[i, k], chain.highest_angle[i, k]
            angle = _between(arms.angle, i, k)
            asked, limit, held = arms.asked[i, k], arms.limit[i, k], arms.held[i, k]
            demand = gain * (asked - angle) if is_position else asked
            demand = fastest if demand > fastest else demand
            demand = -fastest if demand < -fastest else demand
            above = stop * (most - angle) if angle > most else np.inf
            below = stop * (least - angle) if angle < least else -np.inf
            lowest = -np.inf if demand > above else -limit
            highest = np.inf if demand < below else limit
            demand = above if demand > above else demand
            demand = below if demand < below else demand
            locked = held == held
            demand = rate * (held - angle) if locked else demand
            work.demand[i, k] = demand
            work.lowest[i, k] = -np.inf if locked else lowest
            work.highest[i, k] = np.inf if locked else highest
            work.stop_above[i, k] = above - demand
            work.stop_below[i, k] = below - demand


@inner
def _need(arms, work, chain, lanes):
    """Compute the impulses that give the speeds demanded; return whether any is out of bounds."""
    segments = arms.angle.shape[0]
    last = segments - 1
    for k in range(lanes):
        fall_x, fall_y = chain.substep * chain.gravity[0, k], chain.substep * chain.gravity[1, k]
        x = y = turn = 0.0
        for i in range(segments):
            length, mass, centre = chain.length[i, k], chain.mass[i, k], chain.centre[i, k]
            turn = turn + work.demand[i, k]
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
        for i in range(segments - 1, -1, -1):
            length, centre, inertia = chain.length[i, k], chain.centre[i, k], chain.inertia[i, k]
            load_x, load_y = work.load_x[i, k], work.load_y[i, k]
            push_x = length * x + centre * load_x
            push_y = length * y + centre * load_y
            torque = work.cosine[i, k] * push_y - work.sine[i, k] * push_x
            needed = needed + torque + inertia * (work.turn[i, k] - arms.speed[i, k])
            x += load_x
            y += load_y
            total = needed + (work.drag[i, k] * work.demand[i, k] + work.friction[i, k])
            work.needed[i, k] = total
            work.excess[i, k] = 0.0
            is_beyond = (total > work.highest[i, k]) | (total < work.lowest[i, k])
            beyond += 1.0 if is_beyond else 0.0
        work.changed[k] = beyond
    return work.changed[:lanes].any()


@inner
def _turn(arms, work, lanes):
    """Set the segments' velocities to those that the joints reach."""
    for k in range(lanes):
        speed = 0.0
        for i in range(arms.speed.shape[0]):
            speed = speed + (work.demand[i, k] + work.excess[i, k])
            arms.speed[i, k] = speed
            arms.yields[i, k] = 1.0 if abs(work.bound[i, k]) == 1.0 else 0.0


@inner
def _show(arms, work, chain, shown):
    """Write the public values: angles, velocities, hands, cosines and sines of joint angles."""
    segments = arms.angle.shape[0]
    for k in range(shown.shape[0]):
        arm = shown[k]
        x = y = 0.0
        for i in range(segments):
            angle = _between(arms.angle, i, k)
            arm.segment_angles[i] = arms.angle[i, k]
            arm.joint_angles[i] = angle
            arm.joint_velocities[i] = _between(arms.speed, i, k)
            arm.joint_sines[i], arm.joint_cosines[i] = sine_cosine(angle)
            x += chain.length[i, k] * work.cosine[i, k]
            y += chain.length[i, k] * work.sine[i, k]
        arm.end_effector[0] = x
        arm.end_effector[1] = y


@inner
def _weigh(work, chain, lanes):
    """Compute the mass matrix M from inertia and first moment of the arm beyond each joint."""
    segments = work.sine.shape[0]
    for k in range(lanes):
        x = y = inertia = beyond = 0.0
        for j in range(segments - 1, -1, -1):
            length, mass, centre = chain.length[j, k], chain.mass[j, k], chain.centre[j, k]
            alone = mass * centre * centre + chain.inertia[j, k] + beyond * length * length
            moment = mass * centre + beyond * length
            beyond += mass
            cosine, sine = work.cosine[j, k], work.sine[j, k]
            inertia = (inertia + 2.0 * length * (cosine * x + sine * y)) + alone
            x = x + moment * cosine
            y = y + moment * sine
            work.matrix[j, j, k] = inertia
            work.moment_x[j, k] = x
            work.moment_y[j, k] = y
        for j in range(segments):
            x = y = 0.0
            for i in range(j - 1, -1, -1):
                x = x + chain.length[i, k] * work.cosine[i, k]
                y = y + chain.length[i, k] * work.sine[i, k]
                along = work.moment_x[j, k] * x
                across = work.moment_y[j, k] * y
                work.matrix[j, i, k] = work.matrix[j, j, k] + along + across
                work.matrix[i, j, k] = work.matrix[j, i, k]
            work.matrix[j, j, k] += work.drag[j, k]


@inner
def _guess(arms, work, chain, lanes):
    """Guess which bounds bind: those of the last substep, or else those that `needed` exceeds.

    A torque servo is nearly always at its bound.  A lane where no impulse is out of bounds stays
    free, as it would if it were alone; `changed` is the number of those impulses in each lane.
    """
    is_torque = chain.is_torque > 0.0
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
    """Compute z, each joint's velocity minus the one that it demands: `excess`."""
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
    """Set up equations for joints at a bound; set the others to their own or their stop's speed."""
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
        for i in range(j + 1, segments):
            ratio = factor[i, j, k] * work.inverse[j, k]
            right[i, k] -= ratio * right[j, k]
            for m in range(j + 1, i + 1):
                factor[i, m, k] -= ratio * factor[m, j, k]
    for i in range(segments - 1, -1, -1):
        total = right[i, k]
        for j in range(i + 1, segments):
            total -= factor[j, i, k] * excess[j, k]
        excess[i, k] = total * work.inverse[i, k]


@inner
def _revise(work, one_by_one, lanes):
    """Change the guesses that the solution contradicts; return whether there are any."""
    segments = work.bound.shape[0]
    work.changed[:] = 0.0
    work.is_done[:] = 0.0
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
    return work.changed[:lanes].any()
