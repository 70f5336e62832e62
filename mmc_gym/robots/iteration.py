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

A block is a record: a task, and `LANES` postures that settle side by side.  Innermost loops run
over the lanes `k`, so that the processor handles several of them at once.  The shapes of its arrays
are part of its type, so numba compiles anew for each number of joints and nodes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mmc_gym._compiling import compiled, inner, sine_cosine
from mmc_gym.robots.blocks import LANES

_HELD = 1e12  # damping of a joint that rests


@compiled
def settle(blocks: Any, arm: Any, course: Any) -> None:
    """Iterate each block, in place, until a posture has settled; polish by Newton's method."""
    for b in range(blocks.shape[0]):
        block = blocks[b]
        _begin(block)
        for time in range(course.iterations + 1):
            _place(block, arm)
            _compare(block, course)
            block.iterations = time
            if time == 0:
                is_near = block.merit[0] < course.near
                block.alone = course.iterations if is_near else course.alone
            settled = block.settled[0]
            if course.takes_all:
                for k in range(LANES):
                    settled = min(settled, block.settled[k])
            elif time >= block.alone:
                for k in range(LANES):
                    settled = max(settled, block.settled[k])
            if settled > 0.0 or time == course.iterations:
                break
            _estimate(block, arm, course)
            _move(block, course)
        if course.is_exact or block.alone == course.iterations:
            for _ in range(course.newton_steps):
                _estimate(block, arm, course)
                _newton(block, arm, course)
                _place(block, arm)
                _compare(block, course)
        if course.turns_back:
            _turn_back(block, arm)


@inner
def _begin(block):
    """Bring postures within the limits."""
    for i in range(block.angle.shape[0]):
        for k in range(LANES):
            block.free[i, k] = 1.0 * (block.low[i, k] < block.high[i, k])
            angle = np.maximum(block.angle[i, k], block.low[i, k])
            block.angle[i, k] = np.minimum(angle, block.high[i, k])


@inner
def _place(block, arm):
    """Find nodes v_0g and axes u_i of postures by the product of exponentials, see `arm`."""
    block.shift[:] = 0.0
    block.turn[:] = 0.0
    for a in range(3):
        block.turn[a, a, :] = 1.0
    for i in range(arm.axes.shape[0]):
        if i == 0 or arm.joint_nodes[i] != arm.joint_nodes[i - 1]:
            _place_node(block, arm.nodes, arm.joint_nodes[i])
        ux, uy, uz = arm.axes[i, 0], arm.axes[i, 1], arm.axes[i, 2]
        px, py, pz = arm.points[i, 0], arm.points[i, 1], arm.points[i, 2]
        j, ratio, slide = arm.joints[i], arm.turns[i], arm.slides[i]
        for k in range(LANES):
            block.sine[k], block.cosine[k] = sine_cosine(ratio * block.angle[j, k])
        for a in range(3):
            for k in range(LANES):
                # A row r of the turn becomes r + sin q r×u + (1 − cos q) (u u·r − r).
                x, y, z = block.turn[a, 0, k], block.turn[a, 1, k], block.turn[a, 2, k]
                s, c = block.sine[k], 1.0 - block.cosine[k]
                along = x * ux + y * uy + z * uz
                dx = s * (y * uz - z * uy) + c * (along * ux - x)
                dy = s * (z * ux - x * uz) + c * (along * uy - y)
                dz = s * (x * uy - y * ux) + c * (along * uz - z)
                block.axis[i, a, k] = along
                block.shift[a, k] -= dx * px + dy * py + dz * pz
                block.shift[a, k] += slide * block.angle[j, k] * along
                block.turn[a, 0, k] = x + dx
                block.turn[a, 1, k] = y + dy
                block.turn[a, 2, k] = z + dz
    last = arm.nodes.shape[0] - 1
    for g in range(min(arm.joint_nodes[-1] + 1, last), last + 1):  # hand and tool
        _place_node(block, arm.nodes, g)


@inner
def _place_node(block, home, g):
    """Move node g of the zero posture along with what carries it."""
    for a in range(3):
        for k in range(LANES):
            x, y, z = block.turn[a, 0, k], block.turn[a, 1, k], block.turn[a, 2, k]
            moved = x * home[g, 0] + y * home[g, 1] + z * home[g, 2]
            block.node[g, a, k] = moved + block.shift[a, k]


@inner
def _compare(block, course):
    """Find what is missing: e_g as `gap`, Σ_a h_a × e_a / 2 s² as `spin`; and who has settled.

    `miss` is the largest |e_g|², `merit` the sum of all squares; `sine` (squared) and `cosine` are
    those of the angle by which the hand still has to turn, in a direction that of `heading`: the
    unit vector of its axis.
    """
    block.miss[:] = 0.0
    block.merit[:] = 0.0
    block.sine[:] = 0.0
    ax, ay, az = course.axis[0], course.axis[1], course.axis[2]
    block.cosine[:] = 0.0 if ax * ax + ay * ay + az * az > 0.0 else -0.5
    for g in range(1, block.node.shape[0]):
        if course.is_placed[g]:
            for k in range(LANES):
                x = block.place[g, 0, k] - block.node[g, 0, k]
                y = block.place[g, 1, k] - block.node[g, 1, k]
                z = block.place[g, 2, k] - block.node[g, 2, k]
                square = x * x + y * y + z * z
                block.gap[g, 0, k] = x
                block.gap[g, 1, k] = y
                block.gap[g, 2, k] = z
                block.miss[k] = np.maximum(block.miss[k], square)
                block.merit[k] += square
    for a in range(3):
        c, e = (a + 1) % 3, (a + 2) % 3
        for k in range(LANES):
            spin = trace = 0.0
            for f in range(3):
                trace = trace + block.rotation[a, f, k] * block.turn[a, f, k]
                spin = spin + block.rotation[e, f, k] * block.turn[c, f, k]
                spin = spin - block.rotation[c, f, k] * block.turn[e, f, k]
            block.heading[a, k] = block.turn[a, 0, k] * ax + block.turn[a, 1, k] * ay
            block.heading[a, k] += block.turn[a, 2, k] * az
            block.spin[a, k] = 0.5 * spin
            block.sine[k] += 0.25 * spin * spin
            block.cosine[k] += 0.5 * trace
    far, turn = course.far * course.far, np.sin(min(course.turn, np.pi / 2)) ** 2
    for k in range(LANES):
        block.merit[k] += 2.0 * course.weight * (1.0 - block.cosine[k])
        is_turned = (block.sine[k] < turn) * (block.cosine[k] > 0.0) + (course.weight == 0.0)
        block.settled[k] = 1.0 * (block.miss[k] < far) * is_turned


@inner
def _estimate(block, arm, course):
    """Find the estimates of the joints, α_j = `pull` / `leverage`."""
    block.pull[:] = 0.0
    block.leverage[:] = 1e-9
    for i in range(arm.axes.shape[0]):
        g, j, ratio = arm.joint_nodes[i], arm.joints[i], arm.turns[i]
        for k in range(LANES):
            spin = block.axis[i, 0, k] * block.spin[0, k] + block.axis[i, 1, k] * block.spin[1, k]
            spin = spin + block.axis[i, 2, k] * block.spin[2, k]
            block.pull[j, k] += course.weight * ratio * spin
            block.leverage[j, k] += course.weight * ratio * ratio
        for h in range(g + 1, arm.nodes.shape[0]):
            if course.is_placed[h]:
                for k in range(LANES):
                    x, y, z = _lever(block, arm, i, h, k)
                    along = x * block.gap[h, 0, k] + y * block.gap[h, 1, k] + z * block.gap[h, 2, k]
                    block.pull[j, k] += along
                    block.leverage[j, k] += x * x + y * y + z * z
                    stretch = np.maximum(_stretch(block, i, g, h, k), 0.0)
                    block.leverage[j, k] += ratio * ratio * stretch
        for m in range(i + 1, arm.axes.shape[0]):
            if arm.joints[m] == j:
                _couple(block, arm, course, i, m)


@inner
def _couple(block, arm, course, i, m):
    """Add to the leverage of a joint what two of its axes have together, i before m."""
    j, ratio = arm.joints[i], arm.turns[i]
    for a in range(3):
        for k in range(LANES):
            along = block.axis[i, a, k] * block.axis[m, a, k]
            block.leverage[j, k] += 2.0 * course.weight * ratio * arm.turns[m] * along
    for h in range(arm.joint_nodes[m] + 1, arm.nodes.shape[0]):
        if course.is_placed[h]:
            for k in range(LANES):
                x, y, z = _lever(block, arm, i, h, k)
                u, v, w = _lever(block, arm, m, h, k)
                block.leverage[j, k] += 2.0 * (x * u + y * v + z * w)
                ux, uy, uz = block.axis[i, 0, k], block.axis[i, 1, k], block.axis[i, 2, k]
                bend = (uy * w - uz * v) * block.gap[h, 0, k]
                bend = bend + (uz * u - ux * w) * block.gap[h, 1, k]
                bend = bend + (ux * v - uy * u) * block.gap[h, 2, k]
                block.leverage[j, k] += 2.0 * np.maximum(-ratio * bend, 0.0)


@inner
def _lever(block, arm, i, h, k):
    """Return l_ih: how fast axis i moves node h, for a displacement of its joint."""
    g, ratio, slide = arm.joint_nodes[i], arm.turns[i], arm.slides[i]
    x = block.node[h, 0, k] - block.node[g, 0, k]
    y = block.node[h, 1, k] - block.node[g, 1, k]
    z = block.node[h, 2, k] - block.node[g, 2, k]
    ux, uy, uz = block.axis[i, 0, k], block.axis[i, 1, k], block.axis[i, 2, k]
    x, y, z = uy * z - uz * y, uz * x - ux * z, ux * y - uy * x
    return ratio * x + slide * ux, ratio * y + slide * uy, ratio * z + slide * uz


@inner
def _along(block, i, k):
    """Return the product of u_i and the heading."""
    product = block.axis[i, 0, k] * block.heading[0, k] + block.axis[i, 1, k] * block.heading[1, k]
    return product + block.axis[i, 2, k] * block.heading[2, k]


@inner
def _stretch(block, i, g, h, k):
    """Return v_gh · e_h, both across the axis of hinge i."""
    product = along = missing = 0.0
    for a in range(3):
        v = block.node[h, a, k] - block.node[g, a, k]
        product = product + v * block.gap[h, a, k]
        along = along + v * block.axis[i, a, k]
        missing = missing + block.gap[h, a, k] * block.axis[i, a, k]
    return product - along * missing


@inner
def _move(block, course):
    """Do v ← α/d + decay·v and q ← nearest posture within the limits to q + v.

    Where v opposes the estimates, Σ_i pull_i v_i < 0, it forgets its past: decay counts as 0.
    A joint that a limit stops has no velocity.
    """
    joints = block.angle.shape[0]
    block.memory[:] = 0.0
    for i in range(joints):
        for k in range(LANES):
            block.memory[k] += block.pull[i, k] * block.velocity[i, k]
    for k in range(LANES):
        block.memory[k] = course.decay * (block.memory[k] >= 0.0)
    for i in range(joints):
        for k in range(LANES):
            step = course.share * block.pull[i, k] / block.leverage[i, k]
            step = step + block.memory[k] * block.velocity[i, k]
            free = block.angle[i, k] + step
            angle = np.minimum(np.maximum(free, block.low[i, k]), block.high[i, k])
            block.velocity[i, k] = step * (angle == free)
            block.angle[i, k] = angle


@inner
def _newton(block, arm, course):
    """Do a damped step of Newton's method; joints that it brings to a limit rest in the next.

    With e, what is missing, and the levers J of the joints it solves (JᵀJ + λ I) Δq = Jᵀe, where
    λ = |e|² or more (Levenberg), by Gauss-Jordan elimination.
    """
    joints, axes = block.angle.shape[0], arm.axes.shape[0]
    block.row[:] = 0.0
    for i in range(axes):
        for m in range(axes):
            p, r, weight = arm.joints[i], arm.joints[m], course.weight * arm.turns[i] * arm.turns[m]
            for a in range(3):
                for k in range(LANES):
                    block.row[p, r, k] += weight * (block.axis[i, a, k] * block.axis[m, a, k])
            for k in range(LANES):  # a direction is one vector, which hinges along it do not move
                along = _along(block, i, k) * _along(block, m, k)
                block.row[p, r, k] -= weight * along
            for h in range(max(arm.joint_nodes[i], arm.joint_nodes[m]) + 1, arm.nodes.shape[0]):
                if course.is_placed[h]:
                    for k in range(LANES):
                        x, y, z = _lever(block, arm, i, h, k)
                        u, v, w = _lever(block, arm, m, h, k)
                        block.row[p, r, k] += x * u + y * v + z * w
    for i in range(joints):
        for k in range(LANES):
            damping = block.merit[k] + course.ridge + _HELD * (1.0 - block.free[i, k])
            block.row[i, i, k] += damping
            block.row[i, joints, k] = block.pull[i, k] * block.free[i, k]
    for p in range(joints):
        for i in range(joints):
            if i != p:
                for k in range(LANES):
                    block.memory[k] = block.row[i, p, k] / block.row[p, p, k]
                for j in range(p, joints + 1):
                    for k in range(LANES):
                        block.row[i, j, k] -= block.memory[k] * block.row[p, j, k]
    for i in range(joints):
        for k in range(LANES):
            free = block.angle[i, k] + block.row[i, joints, k] / block.row[i, i, k]
            angle = np.minimum(np.maximum(free, block.low[i, k]), block.high[i, k])
            block.free[i, k] = (block.low[i, k] < block.high[i, k]) * (angle == free)
            block.angle[i, k] = angle


@inner
def _turn_back(block, arm):
    """Turn joints by whole turns, as near to `start` as limits allow; find |q − start|², `away`.

    Of slides, and of joints that turn an axis by a part of a turn meanwhile, there are none.
    """
    turn = 2.0 * np.pi
    block.away[:] = 0.0
    for i in range(block.angle.shape[0]):
        for k in range(LANES):
            low, high, angle = block.low[i, k], block.high[i, k], block.angle[i, k]
            count = np.floor((block.start[i, k] - angle) / turn + 0.5)
            count = np.minimum(count, np.floor((high - angle) / turn))
            count = np.maximum(count, np.ceil((low - angle) / turn))
            count = count * arm.has_turns[i]
            angle = np.minimum(np.maximum(angle + turn * count, low), high)
            block.angle[i, k] = angle
            block.away[k] += (angle - block.start[i, k]) ** 2
