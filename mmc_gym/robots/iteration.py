"""Iterations of the network of hinges, compiled by numba; `network` has the equations.

**Slides and followers.**  A joint j may move several axes i, each by r_i q_j, and an axis may slide
what it carries along u_i instead of turning it.  The lever of an axis is how fast it moves a node,
and that of a joint is the sum over its axes:

    l_ig = r_i u_i × v_kg,  or r_i u_i of a slide;      L_jg = Σ_i l_ig

The estimate of a joint is again the displacement by which it alone would best make up for what is
missing, α_j = Σ_g L_jg·e_g / Σ_g (|L_jg|² + max(0, c_g)).  A slide moves nodes in a straight line,
so it has no c_g, and it does not turn the vectors h_a.  Of two axes of a joint, i before m,

    |L_jg|² has the product 2 l_ig·l_mg,      c_g has the part −2 r_i (u_i × l_mg)·e_g

where the latter is 0 if i slides.  Near a solution α = D⁻¹ JᵀJ δq, where J has the levers as its
columns and D is the diagonal of JᵀJ, so the bounds of the damping are the same for all joints.

A try is a record, see `records`: a task, and a posture on its way.  The shapes of its arrays are
part of its type, so numba compiles anew for each number of joints and nodes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mmc_gym._compiling import compiled, inner, shared, sine_cosine

_HELD = 1e12  # damping of a joint that rests
_SETTLED = 1e9  # any posture that has settled comes before all that have not
_STRIDE = 10  # iterations between two looks at what a try still lacks
_FINE = 1e-3  # what Newton's method leaves at most, shares of the tolerances, if it has steps left
_TOGETHER = 4  # tries of which the nearest to a given start wins


@compiled
def settle_tries(tries: Any, courses: Any, paces: Any) -> None:
    """Let each try settle, in place; there is one course, and one pace."""
    for t in range(tries.shape[0]):
        _settle(tries[t], courses[0], paces[0])


@compiled
def solve_tasks(
    tasks: Any, starts: Any, has_start: bool, pool: Any, ends: Any, kind: Any, courses: Any
) -> None:
    """Write the end of the first try to settle for each task, or the nearest of all ends.

    `starts` has a given start for each task, or else a row for all, to which whole turns are
    nearest.  The first try is from the given start, the others from one row of the pool after the
    other, those first that lack least.  Of four tries after a given start the nearest to it wins.
    `kind` is an empty array of tries, from which one of that type is made.
    """
    course, lacks = courses[0], np.empty(pool.shape[1])
    tries = np.empty(1, kind.dtype)  # Python takes ten times as long to make one
    for t in range(len(tasks)):
        this = tries[0]  # here, because a record does not keep its array alive
        end = ends[t]
        end.rank, end.iterations, end.is_solved = np.inf, 0, False
        _take(this, tasks[t], starts[t if has_start else 0])
        for attempt in range(course.starts):
            pace = course.quick if attempt < course.quick_tries else course.calm
            if has_start and attempt == 0:
                _go_to(this, this.start)
                _begin(this)
                _see(this, course, pace)
                pace = course.near if this.merit < course.near_start else course.quick
            else:
                row = pool[(attempt - has_start) // len(lacks)]
                if (attempt - has_start) % len(lacks) == 0:
                    _look(this, row, lacks, course, pace)
                nearest = np.argmin(lacks)
                lacks[nearest] = np.inf
                _go_to(this, row[nearest].angle)
            _settle(this, course, pace)
            end.iterations += this.iterations
            if this.rank < end.rank:
                _keep(end, this)
            if end.rank < 0.0 and not (has_start and attempt % _TOGETHER):
                break
        if end.rank >= 0.0:
            _go_to(this, end.angle)
            _settle(this, course, course.last)
            if course.has_both or this.rank < end.rank:
                _keep(end, this)
        if course.has_both and end.far >= course.far:
            _look(this, pool[0], lacks, course, course.place)
            for _ in range(min(course.quick_tries, course.starts - 1)):
                nearest = np.argmin(lacks)
                lacks[nearest] = np.inf
                _go_to(this, pool[0, nearest].angle)
                _settle(this, course, course.place)
                _settle(this, course, course.last)
                end.iterations += this.iterations
                is_as_near = this.far < max(end.far, course.far)
                if this.far < end.far - course.far or (is_as_near and this.turn < end.turn):
                    _keep(end, this)


@inner
def _take(this, task, start):
    """Take over a task and the posture to which whole turns shall be near."""
    for i in range(this.low.shape[0]):
        this.low[i], this.high[i], this.start[i] = task.low[i], task.high[i], start[i]
    for g in range(this.place.shape[0]):
        for a in range(3):
            this.place[g, a] = task.place[g, a]
    for a in range(3):
        for f in range(3):
            this.rotation[a, f] = task.rotation[a, f]


@inner
def _go_to(this, posture):
    """Begin at rest in a posture."""
    for i in range(this.angle.shape[0]):
        this.angle[i], this.velocity[i] = posture[i], 0.0


@inner
def _keep(end, this):
    """Write where a try has ended."""
    for i in range(this.angle.shape[0]):
        end.angle[i] = this.angle[i]
    end.far, end.turn, end.rank = this.far, this.turn, this.rank
    end.is_solved = this.is_solved


@shared
def _look(this, pool, lacks, course, pace):
    """Find what postures of the pool lack; where joints are held, they have to be placed anew."""
    is_held = False
    for i in range(this.low.shape[0]):
        is_held |= this.low[i] == this.high[i]
    for p in range(len(pool)):
        if is_held:
            _go_to(this, pool[p].angle)
            _begin(this)
            _place(this, course)
        else:
            _recall(this, pool[p], course)
        _compare(this, course, pace)
        lacks[p] = this.merit


@inner
def _recall(this, posture, course):
    """Take over the nodes of a posture of the pool, and move a tool's along."""
    for a in range(3):
        this.shift[a] = posture.shift[a]
        for f in range(3):
            this.moved[a, f] = posture.moved[a, f]
    for g in range(posture.node.shape[0]):
        for a in range(3):
            this.node[g, a] = posture.node[g, a]
    for g in range(posture.node.shape[0], course.nodes.shape[0]):
        _place_node(this, course.nodes, g)


@shared
def _settle(this, course, pace):
    """Iterate until a try is near, polish it by Newton's method, and say where it has ended."""
    _begin(this)
    _see(this, course, pace)
    this.iterations, before = 0, np.inf
    while this.iterations < pace.iterations and not _is_near(
        this, course.loose_far, course.loose_turn, pace
    ):
        _estimate(this, course, pace)
        _move(this, course, pace)
        _see(this, course, pace)
        this.iterations += 1
        if this.iterations % _STRIDE == 0:
            if this.merit > pace.stalled * before:
                break
            before = this.merit
    for _ in range(pace.newton_steps):
        if _is_near(this, _FINE * course.far, _FINE * course.turn, pace):
            break
        _estimate(this, course, pace)
        _newton(this, course, pace)
        _see(this, course, pace)
    if course.loose_far > 0.0:
        away = _turn_back(this, course)
        this.is_solved = _is_near(this, course.far, course.turn, pace)
        this.rank = away - _SETTLED if this.is_solved else this.merit
        this.far = np.sqrt(this.miss)
        this.turn = np.arctan2(np.sqrt(this.sine), this.cosine) if pace.weight > 0.0 else 0.0


@inner
def _begin(this):
    """Bring a posture within the limits."""
    for i in range(this.angle.shape[0]):
        this.free[i] = 1.0 * (this.low[i] < this.high[i])
        this.angle[i] = min(max(this.angle[i], this.low[i]), this.high[i])


@shared
def _see(this, course, pace):
    """Find where a posture's nodes and axes are, and how far it is from its task."""
    _place(this, course)
    _compare(this, course, pace)


@inner
def _place(this, course):
    """Find nodes v_0g and axes u_i of a posture by the product of exponentials, see `arm`."""
    for a in range(3):
        this.shift[a] = 0.0
        for f in range(3):
            this.moved[a, f] = 1.0 * (a == f)
    for i in range(course.axes.shape[0]):
        if i == 0 or course.joint_nodes[i] != course.joint_nodes[i - 1]:
            _place_node(this, course.nodes, course.joint_nodes[i])
        ux, uy, uz = course.axes[i, 0], course.axes[i, 1], course.axes[i, 2]
        px, py, pz = course.points[i, 0], course.points[i, 1], course.points[i, 2]
        angle = this.angle[course.joints[i]]
        s, c = sine_cosine(course.turns[i] * angle)
        c = 1.0 - c
        for a in range(3):
            # A row r of the turn becomes r + sin q r×u + (1 − cos q) (u u·r − r).
            x, y, z = this.moved[a, 0], this.moved[a, 1], this.moved[a, 2]
            along = x * ux + y * uy + z * uz
            dx = s * (y * uz - z * uy) + c * (along * ux - x)
            dy = s * (z * ux - x * uz) + c * (along * uy - y)
            dz = s * (x * uy - y * ux) + c * (along * uz - z)
            this.axis[i, a] = along
            this.shift[a] -= dx * px + dy * py + dz * pz
            this.shift[a] += course.slides[i] * angle * along
            this.moved[a, 0] = x + dx
            this.moved[a, 1] = y + dy
            this.moved[a, 2] = z + dz
    last = course.nodes.shape[0] - 1
    for g in range(min(course.joint_nodes[-1] + 1, last), last + 1):  # hand and tool
        _place_node(this, course.nodes, g)


@inner
def _place_node(this, home, g):
    """Move node g of the zero posture along with what carries it."""
    for a in range(3):
        x, y, z = this.moved[a, 0], this.moved[a, 1], this.moved[a, 2]
        moved = x * home[g, 0] + y * home[g, 1] + z * home[g, 2]
        this.node[g, a] = moved + this.shift[a]


@inner
def _compare(this, course, pace):
    """Find what is missing: e_g as `gap`, and Σ_a h_a × e_a / 2 s² as `spin`.

    `miss` is the largest |e_g|², `merit` the sum of all squares; `sine` (squared) and `cosine` are
    those of the angle by which the hand still has to turn, in a direction that of `heading`: the
    unit vector of its axis.
    """
    miss = merit = sine = 0.0
    ax, ay, az = course.axis[0], course.axis[1], course.axis[2]
    cosine = 0.0 if ax * ax + ay * ay + az * az > 0.0 else -0.5
    for g in range(1, this.node.shape[0]):
        if course.is_placed[g]:
            x = this.place[g, 0] - this.node[g, 0]
            y = this.place[g, 1] - this.node[g, 1]
            z = this.place[g, 2] - this.node[g, 2]
            square = x * x + y * y + z * z
            this.gap[g, 0] = x
            this.gap[g, 1] = y
            this.gap[g, 2] = z
            miss = max(miss, square)
            merit += square
    for a in range(3):
        c, e = (a + 1) % 3, (a + 2) % 3
        spin = trace = 0.0
        for f in range(3):
            trace = trace + this.rotation[a, f] * this.moved[a, f]
            spin = spin + this.rotation[e, f] * this.moved[c, f]
            spin = spin - this.rotation[c, f] * this.moved[e, f]
        this.heading[a] = this.moved[a, 0] * ax + this.moved[a, 1] * ay
        this.heading[a] += this.moved[a, 2] * az
        this.spin[a] = 0.5 * spin
        sine += 0.25 * spin * spin
        cosine += 0.5 * trace
    this.miss, this.sine, this.cosine = miss, sine, cosine
    this.merit = merit + 2.0 * pace.weight * (1.0 - cosine)


@inner
def _is_near(this, far, turn, pace):
    """Return whether a posture misses by less than two tolerances, of place and of rotation."""
    if pace.weight > 0.0:
        sine = np.sin(min(turn, np.pi / 2)) ** 2
        if this.sine >= sine or this.cosine <= 0.0:
            return False
    return this.miss < far * far


@shared
def _estimate(this, course, pace):
    """Find the estimates of the joints, α_j = `pull` / `leverage`."""
    for j in range(this.pull.shape[0]):
        this.pull[j], this.leverage[j] = 0.0, 1e-9
    for i in range(course.axes.shape[0]):
        g, j, ratio = course.joint_nodes[i], course.joints[i], course.turns[i]
        spin = this.axis[i, 0] * this.spin[0] + this.axis[i, 1] * this.spin[1]
        spin = spin + this.axis[i, 2] * this.spin[2]
        this.pull[j] += pace.weight * ratio * spin
        this.leverage[j] += pace.weight * ratio * ratio
        for h in range(g + 1, course.nodes.shape[0]):
            if course.is_placed[h]:
                x, y, z = _lever(this, course, i, h)
                this.pull[j] += x * this.gap[h, 0] + y * this.gap[h, 1] + z * this.gap[h, 2]
                this.leverage[j] += x * x + y * y + z * z
                this.leverage[j] += ratio * ratio * max(_stretch(this, i, g, h), 0.0)
        for m in range(i + 1, course.axes.shape[0]):
            if course.joints[m] == j:
                _couple(this, course, pace, i, m)


@inner
def _couple(this, course, pace, i, m):
    """Add to the leverage of a joint what two of its axes have together, i before m."""
    j, ratio = course.joints[i], course.turns[i]
    for a in range(3):
        along = this.axis[i, a] * this.axis[m, a]
        this.leverage[j] += 2.0 * pace.weight * ratio * course.turns[m] * along
    for h in range(course.joint_nodes[m] + 1, course.nodes.shape[0]):
        if course.is_placed[h]:
            x, y, z = _lever(this, course, i, h)
            u, v, w = _lever(this, course, m, h)
            this.leverage[j] += 2.0 * (x * u + y * v + z * w)
            ux, uy, uz = this.axis[i, 0], this.axis[i, 1], this.axis[i, 2]
            bend = (uy * w - uz * v) * this.gap[h, 0]
            bend = bend + (uz * u - ux * w) * this.gap[h, 1]
            bend = bend + (ux * v - uy * u) * this.gap[h, 2]
            this.leverage[j] += 2.0 * max(-ratio * bend, 0.0)


@inner
def _lever(this, course, i, h):
    """Return l_ih: how fast axis i moves node h, for a displacement of its joint."""
    g, ratio, slide = course.joint_nodes[i], course.turns[i], course.slides[i]
    x = this.node[h, 0] - this.node[g, 0]
    y = this.node[h, 1] - this.node[g, 1]
    z = this.node[h, 2] - this.node[g, 2]
    ux, uy, uz = this.axis[i, 0], this.axis[i, 1], this.axis[i, 2]
    x, y, z = uy * z - uz * y, uz * x - ux * z, ux * y - uy * x
    return ratio * x + slide * ux, ratio * y + slide * uy, ratio * z + slide * uz


@inner
def _along(this, i):
    """Return the product of u_i and the heading."""
    product = this.axis[i, 0] * this.heading[0] + this.axis[i, 1] * this.heading[1]
    return product + this.axis[i, 2] * this.heading[2]


@inner
def _stretch(this, i, g, h):
    """Return v_gh · e_h, both across the axis of hinge i."""
    product = along = missing = 0.0
    for a in range(3):
        v = this.node[h, a] - this.node[g, a]
        product = product + v * this.gap[h, a]
        along = along + v * this.axis[i, a]
        missing = missing + this.gap[h, a] * this.axis[i, a]
    return product - along * missing


@inner
def _move(this, course, pace):
    """Do v ← α/d + decay·v and q ← nearest posture within the limits to q + v.

    Where v opposes the estimates, Σ_i pull_i v_i < 0, it forgets its past: decay counts as 0.
    A joint that a limit stops has no velocity.
    """
    memory = 0.0
    for i in range(this.angle.shape[0]):
        memory += this.pull[i] * this.velocity[i]
    decay = course.decay if memory >= 0.0 else 0.0
    for i in range(this.angle.shape[0]):
        step = pace.share * this.pull[i] / this.leverage[i]
        step = step + decay * this.velocity[i]
        free = this.angle[i] + step
        this.angle[i] = min(max(free, this.low[i]), this.high[i])
        this.velocity[i] = step if this.angle[i] == free else 0.0


@inner
def _newton(this, course, pace):
    """Do a damped step of Newton's method; joints that it brings to a limit rest in the next.

    With e, what is missing, and the levers J of the joints it solves (JᵀJ + λ I) Δq = Jᵀe, where
    λ = |e|² or more (Levenberg), by Gauss-Jordan elimination.
    """
    joints, axes = this.angle.shape[0], course.axes.shape[0]
    for i in range(joints):
        for j in range(joints):
            this.row[i, j] = 0.0
    for i in range(axes):
        for m in range(axes):
            p, r = course.joints[i], course.joints[m]
            weight = pace.weight * course.turns[i] * course.turns[m]
            for a in range(3):
                this.row[p, r] += weight * (this.axis[i, a] * this.axis[m, a])
            # A direction is one vector, which hinges along it do not move.
            this.row[p, r] -= weight * (_along(this, i) * _along(this, m))
            last = max(course.joint_nodes[i], course.joint_nodes[m])
            for h in range(last + 1, course.nodes.shape[0]):
                if course.is_placed[h]:
                    x, y, z = _lever(this, course, i, h)
                    u, v, w = _lever(this, course, m, h)
                    this.row[p, r] += x * u + y * v + z * w
    for i in range(joints):
        this.row[i, i] += this.merit + course.ridge + _HELD * (1.0 - this.free[i])
        this.row[i, joints] = this.pull[i] * this.free[i]
    for p in range(joints):
        for i in range(joints):
            if i != p:
                factor = this.row[i, p] / this.row[p, p]
                for j in range(p, joints + 1):
                    this.row[i, j] -= factor * this.row[p, j]
    for i in range(joints):
        free = this.angle[i] + this.row[i, joints] / this.row[i, i]
        this.angle[i] = min(max(free, this.low[i]), this.high[i])
        this.free[i] = 1.0 * (this.low[i] < this.high[i] and this.angle[i] == free)


@inner
def _turn_back(this, course):
    """Turn joints by whole turns, as near to `start` as limits allow; return |q − start|².

    Of slides, and of joints that turn an axis by a part of a turn meanwhile, there are none.
    """
    turn, away = 2.0 * np.pi, 0.0
    for i in range(this.angle.shape[0]):
        low, high, angle = this.low[i], this.high[i], this.angle[i]
        count = np.floor((this.start[i] - angle) / turn + 0.5)
        count = min(count, np.floor((high - angle) / turn))
        count = max(count, np.ceil((low - angle) / turn)) * course.has_turns[i]
        this.angle[i] = min(max(angle + turn * count, low), high)
        away += (this.angle[i] - this.start[i]) ** 2
    return away
