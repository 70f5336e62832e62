"""Optimal feedback control: the linear-quadratic-Gaussian controller of the linearised arm.

This is the field's normative model of movement (Todorov & Jordan 2002).  No path is planned.  At
any time the feedback is optimal under noise that grows with the command.  So it corrects errors
only where they matter: where they move the hand.

**The given body.**  A joint turns at the speed commanded to its servo.  The drive a changes that
speed, and follows the command u with a lag, as muscles do:

    q̇ = v,     v̇ = a,     τ ȧ = u (1 + c ε) − a,     ε normal

**The task.**  Be at the target after the time T, and stay.  During a reach there is little cost
but effort.  After it every control step costs, for ever,

    |e|² + ρ² |ṗ|² + η² |v|² + r |u|²,     e = target − hand,  p = hand

T = T₀ + d/v̄ for a target at the distance d.  T begins anew when the target jumps.

**Its solution.**  With the Jacobian J = U Σ Vᵀ the turned joints Vᵀq are independent: each is a
chain (z, v, a) that moves the hand by s along a column of U, or not at all (s = 0).  Backwards in
time, with S the cost to go (Todorov 2005),

    L = (r + (1 + c²) BᵀSB)⁻¹ BᵀSA,     u = −L (z, v, a),     S ← Q + AᵀS (A − BL)

Staying is the fixed point of this recursion (Qian, Jiang, Jiang & Mazzoni 2013): a Riccati
equation, with c² BᵀSB added to r.  A reach ends in it.  L depends only on s and on the number of
remaining steps.  A table of L over both is solved once, and looked up for the present posture.

**Senses.**  Kalman filters have constant gains, from the dual Riccati equation.  There is one for
each joint, with the command as efference copy; one for the difference between the seen and the felt
hand; and one for a target that may move.  The noise is not given.  It is assumed to be that of
people.  Senses are assumed to be on time, unless a delay is given.  Then the filters estimate the
past; joints are extrapolated by the commands since then, and the target by its velocity.

Literature: Todorov & Jordan (2002), Nature Neurosci. 5, 1226–1235.  Todorov (2005), Neural Comput.
17, 1084–1108.  Todorov & Li (2005), Proc. American Control Conf., 300–306 (linearise at the present
posture).  Qian et al. (2013), Neural Comput. 25, 697–724.  van Beers, Sittig & Denier van der Gon
(1998), Exp. Brain Res. 122, 367–377 (noise of the senses).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import LARGEST_SIZE, require, require_between, require_positive
from mmc_gym.agents.base import FeedbackAgent
from mmc_gym.agents.inverse_kinematics import hand_position, jacobian, leave_line
from mmc_gym.geometry import Floats, nearest_reachable, turned_back, wrap_angle
from mmc_gym.interface import ReachInterface, Seen, Sensed


@dataclass(frozen=True)
class Assumptions:
    """Costs to minimise, and assumptions on timing, lag, noise and delay."""

    shortest: float = 0.3  #: T₀, duration of a movement of no length, s
    speed: float = 4.0  #: v̄, growth of distance with duration, segment lengths / s
    longest: float = 1.4  #: largest duration of a movement, s; at least a control step
    lag: float = 0.04  #: τ of the drive, s
    velocity_cost: float = 0.1  #: ρ, s
    joint_cost: float = 0.01  #: η, lengths · s / rad; stops movements that do not move the hand
    effort_cost: float = 0.002  #: √r, lengths · s² / rad
    motor_noise: float = 0.2  #: c, noise as a fraction of the command
    joint_noise: float = 0.0175  #: of felt joint angles, rad; ten times this for velocities, rad/s
    vision_noise: float = 0.01  #: of the seen hand and target, segment lengths
    slip: float = 0.01  #: error of a joint's turn in a control step, rad
    push: float = 0.1  #: disturbance of a joint's velocity in a control step, rad/s
    drift: float = 0.01  #: change of the seen against the felt hand in a step, segment lengths
    swerve: float = 0.3  #: change of a target's velocity in a control step, segment lengths / s
    delay: float = 0.0  #: of the senses, s; rounded to control steps

    def __post_init__(self) -> None:
        require_between(0, LARGEST_SIZE, **asdict(self))
        for name in ("speed", "longest", "lag"):
            require_positive(name, getattr(self, name))


DEFAULT = Assumptions()

TARGET_JUMP_DISTANCE = 0.5  #: a target farther from its expected place has jumped, lengths
SOFT = 0.05  #: keeps joints that hardly move the hand from chasing a target, lengths² / rad²
#: Values of s in the table of gains, lengths / rad: spaced by one ratio, interpolated linearly.
SMALLEST, LARGEST, ENTRIES = 0.01, 30.0, 81


def plant(assumed: Assumptions, step: float) -> tuple[Floats, Floats]:
    """Return A (3, 3) and B (3, 1) of a turned joint (z, v, a) for a control step of `step` s."""
    a = np.array([[1.0, step, 0.0], [0.0, 1.0, step], [0.0, 0.0, 1.0 - step / assumed.lag]])
    return a, np.array([[0.0], [0.0], [step / assumed.lag]])


def staying_cost(assumed: Assumptions, moves: float) -> Floats:
    """Return Q (3, 3) of a turned joint that moves the hand by s = `moves` lengths / rad."""
    return np.diag([moves**2, (moves * assumed.velocity_cost) ** 2 + assumed.joint_cost**2, 0.0])


def optimal_gain(assumed: Assumptions, step: float, value: Floats) -> Floats:
    """Return L (..., 3); `value` is S (..., 3, 3), the cost to go after the next step."""
    a, b = plant(assumed, step)
    stake = (1 + assumed.motor_noise**2) * (b.T @ value @ b)[..., 0]
    return (b.T @ value @ a)[..., 0, :] / (assumed.effort_cost**2 + stake)


def staying_value(assumed: Assumptions, step: float, moves: float) -> Floats:
    """Return S (3, 3) of staying for ever, for a turned joint of s = `moves` lengths / rad."""
    from scipy.linalg import solve_discrete_are  # `import mmc_gym` loads no scipy

    a, b = plant(assumed, step)
    effort, before = assumed.effort_cost**2, math.inf
    while abs(effort - before) > 1e-9 * effort:
        value: Floats = solve_discrete_are(a, b, staying_cost(assumed, moves), [[effort]])
        stake = float((b.T @ value @ b)[0, 0])
        before, effort = effort, assumed.effort_cost**2 + assumed.motor_noise**2 * stake
    return value


def reaching_gains(assumed: Assumptions, step: float, value: Floats) -> Floats:
    """Return L (steps, ..., 3) of the longest reach, last step first; `value` is S at its end."""
    a, b = plant(assumed, step)
    gains_backwards = []
    for _ in range(round(assumed.longest / step)):
        gain = optimal_gain(assumed, step, value)
        gains_backwards.append(gain)
        value = staying_cost(assumed, 0.0) + a.T @ value @ (a - b * gain[..., None, :])
    return np.array(gains_backwards)


def kalman_gain(a: Floats, c: Floats, disturbance: Floats, noise: Floats) -> Floats:
    """Return the constant Kalman gain K of x ← Ax + K (y − CAx); the last two are covariances."""
    from scipy.linalg import solve_discrete_are

    p = solve_discrete_are(a.T, c.T, disturbance, noise)
    return p @ c.T @ np.linalg.inv(c @ p @ c.T + noise)


def turned_joints(effects: Floats) -> tuple[Floats, Floats, Floats]:
    """Return U's first column (..., 2), s (..., 2) and two rows of Vᵀ (..., 2, N) of J = U Σ Vᵀ.

    U is a rotation.  Where s is 0, so is the row.  `numpy.linalg.svd` is five times slower.
    """
    x, y = effects[..., 0, :], effects[..., 1, :]
    twice = np.arctan2(2.0 * (x * y).sum(axis=-1), (x * x).sum(axis=-1) - (y * y).sum(axis=-1))
    towards = np.stack((np.cos(0.5 * twice), np.sin(0.5 * twice)), axis=-1)
    cosine, sine = towards[..., None, :1], towards[..., None, 1:]
    rows = cosine * effects + sine * effects[..., ::-1, :] * np.array([[1.0], [-1.0]])
    moves = np.sqrt((rows * rows).sum(axis=-1))
    return towards, moves, rows / np.maximum(moves, 1e-9)[..., None]


def _turned(vector: Floats, towards: Floats) -> Floats:
    """Return the components of vectors (..., 2) along U's columns; `towards` is the first."""
    return np.stack(turned_back(*np.moveaxis(vector, -1, 0), *np.moveaxis(towards, -1, 0)), axis=-1)


def _length(vector: Floats) -> Floats:
    """Return the length (..., 1) of each vector (..., 2)."""
    return np.hypot(vector[..., :1], vector[..., 1:])


class Gains(NamedTuple):
    """All gains of the controller."""

    #: table of L over the remaining steps of a movement and s, (3, steps + 1, entries); the gain
    #: of z is divided by s, so that it multiplies the error of the hand in segment lengths
    control: Floats
    posture: Floats  #: K of a joint's angle and of its velocity, each from its own reading, (2,)
    vision: float  #: K of the difference between the seen and the felt hand
    target: Floats  #: K of (place, velocity) from the seen place, (2,)


@lru_cache
def gains(assumed: Assumptions, step: float) -> Gains:
    """Return the gains for a control step of `step` seconds."""
    moves = np.geomspace(SMALLEST, LARGEST, ENTRIES)
    values = np.array([staying_value(assumed, step, move) for move in moves])
    staying = optimal_gain(assumed, step, values)
    control = np.concatenate((staying[None], reaching_gains(assumed, step, values)))
    control[..., 0] /= moves
    # A joint's velocity is set by the command, whatever it was before; a target keeps its velocity.
    joint, target = np.diag([1.0, 0.0]), np.array([[1.0, step], [0.0, 1.0]])
    disturbed = np.diag([assumed.slip, assumed.push]) ** 2
    swerve = assumed.swerve**2 * np.outer([0.5 * step, 1.0], [0.5 * step, 1.0])
    felt, seen = assumed.joint_noise**2 * np.diag([1.0, 100.0]), assumed.vision_noise**2 * np.eye(1)
    return Gains(
        np.ascontiguousarray(np.moveaxis(control, -1, 0)),
        posture=np.diag(kalman_gain(joint, np.eye(2), disturbed, felt)),
        vision=float(kalman_gain(np.eye(1), np.eye(1), assumed.drift**2 * np.eye(1), seen)[0, 0]),
        target=kalman_gain(target, np.eye(1, 2), swerve, seen)[:, 0],
    )


class Belief(NamedTuple):
    """The controller's state; arrays lead with the batch."""

    joint_angles: Floats  #: as felt, at the time of the senses, radians, (..., N)
    velocity: Floats  #: of the joints, as felt; after a command, as commanded; rad/s, (..., N)
    drive: Floats  #: rate of change of that velocity, rad/s², (..., N)
    shift: Floats  #: seen minus felt position of the hand, segment lengths, (..., 2)
    target: Floats  #: as sensed, segment lengths, (..., 2)
    target_velocity: Floats  #: as sensed, segment lengths / s, (..., 2)
    remaining: Floats  #: control steps left of the movement, (..., 1)
    asked: Floats  #: velocities commanded since the time of the senses, rad/s, (..., steps, N)


class OptimalControlAgent(FeedbackAgent[Belief]):
    """Optimal feedback control of the given arm, by joint velocities."""

    def __init__(self, interface: ReachInterface, assumed: Assumptions = DEFAULT) -> None:
        """Make an agent; `assumed.longest` must be at least a control step."""
        super().__init__(interface)
        require(isinstance(assumed, Assumptions), "assumed", assumed, "an Assumptions")
        accepted = f"at least a control step, {interface.control_step:g} s"
        require(assumed.longest >= interface.control_step, "longest", assumed.longest, accepted)
        self.assumed, self.gains = assumed, gains(assumed, interface.control_step)
        self._late = round(assumed.delay / interface.control_step)

    @override
    def start(self, sensed: Sensed) -> Belief:
        rest, still = np.zeros_like(sensed.joint_angles), np.zeros_like(sensed.target)
        unseen = np.full_like(sensed.target, np.nan)
        asked = np.zeros((*rest.shape[:-1], self._late, rest.shape[-1]))
        return Belief(
            sensed.joint_angles, rest, rest, unseen, sensed.target, still, unseen[..., :1], asked
        )

    @override
    def respond(self, state: Belief, seen: Seen) -> tuple[NDArray[np.float32], Belief]:
        state = self._joints_and_hand_sensed(state, seen)
        state = self._target_sensed(state, seen)
        state = self._driven(state, self._command(state))
        # A position servo turns a joint at this velocity if its target is this far ahead.
        ahead = state.velocity / self.interface.servo_gain
        now = seen.joint_angles + self.interface.control_step * state.asked.sum(axis=-2)
        return self.interface.act(now + ahead, replace(seen, joint_angles=now)), state

    def _joints_and_hand_sensed(self, before: Belief, seen: Seen) -> Belief:
        """Return the belief with joints and shift of the hand predicted and corrected by `seen`."""
        gains, step = self.gains, self.interface.control_step
        asked = np.concatenate((before.asked, before.velocity[..., None, :]), axis=-2)
        expected = before.joint_angles + step * asked[..., 0, :]
        angles = expected + gains.posture[0] * wrap_angle(seen.joint_angles - expected)
        velocity = before.velocity + gains.posture[1] * (seen.joint_speeds - asked[..., 0, :])
        shift = seen.hand - hand_position(angles, self.interface.segment_lengths)
        known = np.where(np.isnan(before.shift), shift, before.shift)
        return before._replace(
            joint_angles=angles,
            velocity=velocity,
            shift=known + gains.vision * (shift - known),
            asked=asked[..., 1:, :],
        )

    def _target_sensed(self, state: Belief, seen: Seen) -> Belief:
        """Return the belief with the target corrected; where it jumped, a movement begins."""
        gains, assumed, step = self.gains, self.assumed, self.interface.control_step
        expected = state.target + step * state.target_velocity
        error = seen.target - expected
        jumped = _length(error) > TARGET_JUMP_DISTANCE
        target = np.where(jumped, seen.target, expected + gains.target[0] * error)
        velocity = np.where(jumped, 0.0, state.target_velocity + gains.target[1] * error)
        felt = hand_position(state.joint_angles, self.interface.segment_lengths)
        distance = _length(target - felt - state.shift)
        duration = np.minimum(assumed.shortest + distance / assumed.speed, assumed.longest)
        begins = jumped | np.isnan(state.remaining)
        remaining = np.where(begins, np.rint(duration / step), state.remaining)
        return state._replace(target=target, target_velocity=velocity, remaining=remaining)

    def _command(self, state: Belief) -> Floats:
        """Return the optimal command u of the joints, (..., N), at the present time."""
        interface, lengths = self.interface, self.interface.segment_lengths
        step = interface.control_step
        target = state.target + self._late * step * state.target_velocity
        goal = nearest_reachable(target - state.shift, lengths)
        angles = state.joint_angles + step * state.asked.sum(axis=-2)
        hand, effects = jacobian(leave_line(angles, goal, lengths), lengths)
        effects[..., list(interface.lockable_joints)] = 0.0  # a joint that may lock moves nothing
        towards, moves, rows = turned_joints(effects)
        error = _turned(target - state.shift - hand, towards)
        glide = _turned(state.target_velocity, towards)
        chased = glide * moves / (moves**2 + SOFT)
        # Two turned joints move the hand; the rest of the joints' motion, `still`, does not.
        velocity = (rows * state.velocity[..., None, :]).sum(axis=-1)
        drive = (rows * state.drive[..., None, :]).sum(axis=-1)
        still_velocity = state.velocity - (rows * velocity[..., None]).sum(axis=-2)
        still_drive = state.drive - (rows * drive[..., None]).sum(axis=-2)
        of_error, of_velocity, of_drive = self._looked_up(moves, state.remaining)
        command = of_error * error - of_velocity * (velocity - chased) - of_drive * drive
        of_still = self.gains.control[1:, state.remaining.astype(np.intp), 0]
        still: Floats = -of_still[0] * still_velocity - of_still[1] * still_drive
        return (rows * command[..., None]).sum(axis=-2) + still

    def _driven(self, state: Belief, command: Floats) -> Belief:
        """Return the belief after a command (..., N), with one control step less remaining."""
        step, limit = self.interface.control_step, self.interface.speed_limit
        velocity = state.velocity + step * state.drive
        drive = state.drive + step / self.assumed.lag * (command - state.drive)
        # If the fastest joint must slow down, all do, so that the hand keeps its direction.
        fastest = np.abs(velocity).max(axis=-1, keepdims=True)
        share = limit / np.maximum(fastest, limit)
        remaining = np.maximum(state.remaining - 1.0, 0.0)
        return state._replace(velocity=share * velocity, drive=share * drive, remaining=remaining)

    def _looked_up(self, moves: Floats, remaining: Floats) -> Floats:
        """Return L (3, ..., 2) from the table, for s = `moves` (..., 2) and the remaining steps."""
        place = np.log(np.maximum(moves, SMALLEST) / SMALLEST)
        place *= (ENTRIES - 1) / math.log(LARGEST / SMALLEST)
        place = np.minimum(place, ENTRIES - 1.001)
        index, row = place.astype(np.intp), remaining.astype(np.intp)
        share, table = place - index, self.gains.control
        below: Floats = table[:, row, index]
        return below + share * (table[:, row, index + 1] - below)
