"""Senses: where the joints and the target are, behind noise, and how late they are seen.

Nothing is told of noise and delay.  Both are estimated from what is seen.

**Posture.**  A joint that is seen at q with the speed v is seen at q + Δt (v + v′)/2 a control step
Δt later, give or take Δt |v − v′| / 2, for nobody knows when within the step the speed has changed.
What is beyond that tells the noise: the middle one of the joints is robust to a joint that hits
something, and its mean square is 0.455 · 2R for normal noise of variance R (0.455 is the square of
the normal median deviation).  A Kalman filter of one variance for all joints of an arm does the
rest, with Q the mean square of Δt (v − v′) / 2:

    P ← P + Q,     K = P / (P + R),     q̂ ← q̂ + Δt (v + v′)/2 + K · innovation,     P ← (1 − K) P

**Target.**  Third differences of the target leave no smooth movement, only noise: for white noise
of variance σ² in each coordinate, |Δ³z|² has the mean 40 σ².  Two predictors run side by side, and
the one that has foretold better is believed: the mean since the last jump, each observation
weighted by its precision, for a target that stands; and the parabola of least squares, discounted
by θ a step, for one that moves (the fading-memory filter; Morrison 1969, Brookner 1998),

    e = z − ẑ,     ẑ ← ẑ + (1 − θ³) e
    ẑ′ ← ẑ′ + 3/2 (1 − θ)² (1 + θ) e,     ½ẑ″ ← ½ẑ″ + ½ (1 − θ)³ e        time in control steps

Noise wants much memory, and jerk J little: 1 − θ = (J Δt³/σ)^(2/7) balances both errors.

**Delay.**  It is the time from the first command that should be felt to the first movement that
is felt.  An old posture is run forward through the commands sent since, by a model of the servos
(Miall, Weir, Wolpert and Stein 1993).

Literature: N. Morrison (1969), Introduction to sequential smoothing and prediction, McGraw-Hill.
E. Brookner (1998), Tracking and Kalman filtering made easy, Wiley.  R. C. Miall, D. J. Weir,
D. M. Wolpert, J. F. Stein (1993), Is the cerebellum a Smith predictor?, J. Motor Behavior 25,
203–216.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import every, some, where
from mmc_gym.agents.body_model.drive import commanded_turn
from mmc_gym.interface import ReachInterface
from mmc_gym.network.chain import Floats, wrap_angle

Points: TypeAlias = NDArray[np.complexfloating]
"""Points of the plane as complex numbers, x + iy: to turn is to multiply."""
Bools: TypeAlias = NDArray[np.bool_]

MIDDLE = 0.455
"""Mean square of the middle of several normal errors' sizes, as a share of their variance."""
MODEL_ERROR = 1e-3
"""By how much the speeds mistell a turn at most, where they are steady, radians."""
NOISE_RATE = 0.1
"""Share by which the estimates of noise follow what is seen."""
LARGEST = 0.3
"""An innovation counts as this at most, radians: more is no noise."""

JERK = 40.0
"""J: jerk of a target that moves, segment lengths/s³."""
JUMP = 0.15
"""A target that is farther than this from where it was expected has jumped, segment lengths."""
SETTLED = 4
"""Observations without a jump after which the third difference is noise alone."""
SAME = 1e-5
"""Places that differ by less are the same, segment lengths: observations are in float32."""
FAST = 2.5
"""A joint that is faster than this moves, however noisy it is, rad/s."""
EARLY = 6
"""Observations after which noise is not taken for a movement any more."""

LONGEST_DELAY = 25
"""The longest delay that is bridged, control steps."""
ONSET = 0.02
"""A joint that is faster than this moves, rad/s, if nothing is noisy."""
ONSET_PER_NOISE = 60.0
"""What the noise of the joint angles adds to that, 1/s."""
CLEARLY = 5.0
"""A movement is due to be felt if a speed is asked for that is so many times the onset."""


class PostureTrack(NamedTuple):
    """What is known of where the joints are.

    Attributes:
        joint_angles: filtered, radians; they go on beyond ±π, (n, N).
        turn: by how much they turned in the last control step, radians, (n, N).
        seen: the angles as last seen, radians, (n, N).
        speeds: as last seen, rad/s, (n, N).
        noise: R, variance of the seen angles, (n, 1).
        doubt: P, variance of the filtered angles, (n, 1).
        age: observations so far, (n, 1).
    """

    joint_angles: Floats
    turn: Floats
    seen: Floats
    speeds: Floats
    noise: Floats
    doubt: Floats
    age: Floats

    @classmethod
    def start(cls, joint_angles: Floats, speeds: Floats) -> PostureTrack:
        """Return what a first look tells."""
        none = np.zeros((len(joint_angles), 1))
        return cls(
            joint_angles, np.zeros_like(speeds), joint_angles, speeds, none, none, none + 1.0
        )

    def observed(self, joint_angles: Floats, speeds: Floats, control_step: float) -> PostureTrack:
        """Return what is known after another look, a control step later."""
        half = control_step / 2
        turn: Floats = half * (speeds + self.speeds)
        unclear = half * np.abs(speeds - self.speeds) + MODEL_ERROR
        strange = np.abs(wrap_angle(joint_angles - self.seen - turn)) - unclear
        size = np.sort(strange, axis=-1)
        middle = size[:, (size.shape[-1] - 1) // 2, None]
        age = self.age + 1
        if not some(middle > 0.0) and not some(self.noise):  # all is seen as it is
            turn = wrap_angle(joint_angles - self.joint_angles)
            exact = self.joint_angles + turn
            return PostureTrack(exact, turn, joint_angles, speeds, self.noise, self.noise, age)
        middle = np.clip(middle, 0.0, LARGEST)
        rate = np.maximum(NOISE_RATE, 1 / self.age)
        noise = self.noise + rate * (middle * middle / (2 * MIDDLE) - self.noise)
        doubt = np.where(self.age == 1, noise, self.doubt)
        doubt = doubt + (unclear * unclear).mean(axis=-1, keepdims=True)
        gain = doubt / (doubt + noise)
        turn = turn + gain * wrap_angle(joint_angles - self.joint_angles - turn)
        return PostureTrack(
            self.joint_angles + turn,
            turn,
            joint_angles,
            speeds,
            noise,
            (1 - gain) * doubt,
            age,
        )

    @property
    def deviation(self) -> Floats:
        """Standard deviation of the noise of the seen angles, radians, (n, 1)."""
        deviation: Floats = np.sqrt(self.noise)
        return deviation


class TargetTrack(NamedTuple):
    """What is known of where the target is and goes; time in control steps.

    Attributes:
        history: the last three observations, the latest last, (n, 3).
        mean: of a target that stands, (n,).
        doubt: variance of that mean, (n,).
        place, velocity, curve: of one that moves: ẑ, ẑ′ and ½ẑ″, (n,).
        noise: σ², in each coordinate, (n,).
        error_standing, error_moving: mean squares of what either foretold wrongly, (n,).
        age: observations since the target appeared, or jumped, (n,).
        seen: observations in all, (n,).
        has_jumped: whether it did with the last observation, (n,).
        is_moving: whether it is taken as one that moves, (n,).
    """

    history: Points
    mean: Points
    doubt: Floats
    place: Points
    velocity: Points
    curve: Points
    noise: Floats
    error_standing: Floats
    error_moving: Floats
    age: Floats
    seen: Floats
    has_jumped: Bools
    is_moving: Bools

    @classmethod
    def start(cls, target: Points) -> TargetTrack:
        """Return what a first look tells."""
        zero, still = np.zeros(len(target)), np.zeros_like(target)
        history = np.repeat(target[:, None], 3, axis=1)
        errors = (zero, zero)
        age = (zero + 1.0, zero + 1.0)
        no = (zero > 0, zero > 0)
        return cls(history, target, zero, target, still, still, zero, *errors, *age, *no)

    def observed(self, target: Points, control_step: float) -> TargetTrack:
        """Return what is known after another look, a control step later."""
        age, seen = self.age + 1, self.seen + 1
        if np.abs(target[:, None] - self.history).max() < SAME and not some(self.velocity):
            return self._replace(age=age, seen=seen, has_jumped=np.zeros(len(target), bool))
        expected = self.place + self.velocity + self.curve
        error, stray = target - expected, target - self.mean

        # Has it jumped?
        is_moving = self.is_moving
        usual = 6 * np.sqrt(self.noise) + 3 * np.sqrt(np.where(is_moving, self.error_moving, 0.0))
        far = np.abs(np.where(is_moving, error, stray))
        jumps = (self.seen >= SETTLED) & (far > JUMP + usual)
        is_settled = (age >= SETTLED) & ~jumps

        # How noisy is it?
        oldest, older, last = self.history.T
        third = _square(target - 3 * last + 3 * older - oldest) / 40
        rate = np.maximum(NOISE_RATE, 1 / np.maximum(seen - SETTLED + 1, 1))
        noise = np.where(is_settled, self.noise + rate * (third - self.noise), self.noise)

        # It stands, or it moves along a parabola.
        doubt = np.where(age <= SETTLED, noise / self.age, self.doubt) + SAME**2
        # Not below that of a plain mean: noise that seemed small at first would stop it for long.
        gain = np.maximum(np.where(seen <= SETTLED, 0.0, doubt / (doubt + noise)), 1 / age)
        forget = (JERK * control_step**3 / np.sqrt(noise + SAME**2)) ** (2 / 7)
        forget = np.clip(forget, 1 / self.age, 1.0)
        keep = 1 - forget
        velocity = self.velocity + 2 * self.curve + 1.5 * forget**2 * (1 + keep) * error
        standing = self.error_standing + 0.2 * (_square(stray) - self.error_standing)
        moving = self.error_moving + 0.2 * (_square(error) - self.error_moving)
        moving = np.where(is_settled, moving, standing)
        after = TargetTrack(
            np.stack([older, last, target], axis=1),
            self.mean + gain * stray,
            (1 - gain) * doubt,
            expected + (1 - keep**3) * error,
            velocity,
            self.curve + 0.5 * forget**3 * error,
            noise,
            standing,
            moving,
            age,
            seen,
            jumps,
            (moving < 0.5 * standing) & (age > SETTLED),
        )
        if not some(jumps):
            return after
        fresh = TargetTrack.start(target)._replace(noise=noise, seen=seen, has_jumped=jumps)
        return where(jumps, fresh, after)

    def ahead(self, steps: Floats) -> Points:
        """Return where the target will be some control steps (n,) after the last look, (n,)."""
        if not some(self.is_moving):
            return self.mean
        ahead = self.place + self.velocity * steps + self.curve * steps * steps
        place: Points = np.where(self.is_moving, ahead, self.mean)
        return place


def _square(points: Points) -> Floats:
    """Return |z|²."""
    square: Floats = points.real**2 + points.imag**2
    return square


class Delay(NamedTuple):
    """What is known of how late all is seen, and the commands that bridge it.

    Attributes:
        commands: those sent, see `command_of`, the latest last, radians,
            (n, LONGEST_DELAY + 1, N).
        due: observations since the first that should show movement, 0 before it, (n,).
        late: the delay, control steps, (n,).
        is_felt: whether a movement has been seen, (n,).
    """

    commands: Floats
    due: Floats
    late: Floats
    is_felt: Bools

    @classmethod
    def start(cls, command: Floats) -> Delay:
        """Return the memory of arms that commands (n, N) hold where they are."""
        held = np.repeat(command[:, None], LONGEST_DELAY + 1, axis=1)
        zero = np.zeros(len(command))
        return cls(held, zero, zero, zero > 0)

    def observed(self, before: PostureTrack, posture: PostureTrack) -> Delay:
        """Return the memory after another look at the posture.

        What is seen exactly as before is late: even noise would have changed it.
        """
        if every(self.is_felt) and every(posture.age > EARLY):
            return self
        moves = np.abs(posture.speeds).max(axis=-1) > np.minimum(_onset(posture), FAST)
        moves &= (posture.seen != before.seen).any(axis=-1)
        late = np.where(self.is_felt, self.late, np.clip(self.due - 1, 0, LONGEST_DELAY))
        # A first look may have taken noise for movement: so at first it has to go on.
        keeps = (posture.age[:, 0] > EARLY) | (posture.noise[:, 0] < SAME**2)
        is_felt = moves | (self.is_felt & keeps)
        due = self.due + (self.due > 0)
        return self._replace(due=due, late=late, is_felt=is_felt)

    def sent(self, command: Floats, posture: PostureTrack, told: ReachInterface) -> Delay:
        """Return the memory after commands (n, N), see `command_of`, in these postures."""
        commands = np.concatenate([self.commands[:, 1:], command[:, None]], axis=1)
        if every(self.due):
            return Delay(commands, self.due, self.late, self.is_felt)
        turn = commanded_turn(told, posture.joint_angles, command)
        asks = np.abs(turn).max(axis=-1) > CLEARLY * _onset(posture) * told.control_step
        return self._replace(commands=commands, due=np.where(self.due > 0, self.due, asks))

    @property
    def steps(self) -> NDArray[np.intp]:
        """The delay, control steps, (n,)."""
        return self.late.astype(np.intp)

    def command_then(self) -> Floats:
        """Return the commands (n, N) that led to what was seen last."""
        if not some(self.late):
            return self.commands[:, -1]
        command: Floats = self.commands[np.arange(len(self.late)), LONGEST_DELAY - self.steps]
        return command

    def run_forward(self, interface: ReachInterface, joint_angles: Floats) -> Floats:
        """Return where joints (n, N) should be by now, that were last seen at these angles."""
        for back in range(int(self.late.max()), 0, -1):
            turn = commanded_turn(interface, joint_angles, self.commands[:, -back])
            joint_angles = joint_angles + np.where((back <= self.late)[:, None], turn, 0.0)
        return joint_angles


def _onset(posture: PostureTrack) -> Floats:
    """Return the speed that is no noise, rad/s, (n,)."""
    onset: Floats = ONSET + ONSET_PER_NOISE * posture.deviation[:, 0]
    return onset
