"""Senses: where the joints and the target are, and how late they are seen.

Noise and delay are estimated from the observations.

**Posture.**  A joint that is seen at q with the speed v, and a control step Δt later with v′, has
turned by m = Δt (v + v′)/2, up to an error of Δt |v − v′|/2.  An innovation beyond that is noise.
The median of the joints is robust to a joint that hits something; for normal noise of variance R
its mean square is 0.455 · 2R (0.455 is the square of the normal median deviation).  The command
predicts the turn, too: c, see `commanded_turn`.  Near the target it is far more exact than noisy
speeds, but not for a joint that a load, a lock or an obstacle keeps from following.  This shows in
the last turn t of q̂.  So a Kalman filter weighs both, with Q_m the mean square of Δt (v − v′)/2:

    Q_c = (0.7 (t − c))² + (0.05 c)²,     t̂ = (Q_c m + Q_m c) / (Q_c + Q_m)
    P ← P + Q_c Q_m / (Q_c + Q_m),     K = P / (P + R)
    q̂ ← q̂ + t̂ + K · innovation,     P ← (1 − K) P

Innovations whose running mean is more than noise show a wrong prediction, and its square adds to P.
The hand tells the posture, too.  If it is seen elsewhere than q̂ takes it, by e, the most likely
turns are those of a Kalman update with the Jacobian J and the variance R_h of the seen hand,

    P J (Jᵀ P J + R_h)⁻¹ e

unless e is more than P and R_h explain: then the body is not as it is thought to be.  The next
prediction starts from q̂ without them, because the hand also tells the body.  Motors are learned
from m, because t̂ already expects what is commanded.

**Target.**  Third differences of a smooth movement vanish, so those of the target are noise: for
white noise of variance σ² in each coordinate, |Δ³z|² has the mean 40 σ².  The better of two
predictors is used.  For a target at rest it is the mean since the last jump, each observation
weighted by its precision.  For a moving target it is the parabola of least squares, discounted by θ
a step (the fading-memory filter; Morrison 1969, Brookner 1998),

    e = z − ẑ,     ẑ ← ẑ + (1 − θ³) e
    ẑ′ ← ẑ′ + 3/2 (1 − θ)² (1 + θ) e,     ½ẑ″ ← ½ẑ″ + ½ (1 − θ)³ e        time in control steps

Noise requires a long memory, and jerk J a short one: 1 − θ = (J Δt³/σ)^(2/7) balances both errors.
Noise is never the same twice: a target that is seen exactly where it was shows none, nor does it
move.

**Delay.**  It is the time from the first command that should be felt to the first movement.  An old
posture is run forward through the commands sent since (Miall et al. 1993).  Hand and target may be
seen later than joints are felt: until the hand first moves.  A late hand belongs to the posture of
its time.  A moving arm never looks the same twice, so repeated observations show that the delay
grows, or that some are lost, see `Senses._relate`.

**Lost numbers.**  A sensor that fails shows 0.  An angle whose cosine and sine are not those of one
angle, a speed of 0 though the joint turned, and a target with a coordinate of 0 are replaced by
what is expected, see `Senses.complete`.

Literature: Morrison (1969), Introduction to sequential smoothing and prediction.  Brookner (1998),
Tracking and Kalman filtering made easy.  Miall et al. (1993), J. Motor Behavior 25, 203–216.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mmc_gym.agents.base import all_true, any_true, where
from mmc_gym.agents.body_model.forward_model import (
    BETTER,
    FAST_RATE,
    JUMP,
    NOISE_OF_SPEEDS,
    RATE,
    SAME,
    SIGMAS,
    SMALL,
    Bools,
    Points,
    as_points,
    as_vectors,
    command_of,
    commanded_turn,
    error_of_turn,
    full_turn,
    hand,
    squared,
    turn_by_speeds,
)
from mmc_gym.agents.body_model.motors import Motors
from mmc_gym.agents.body_model.parts import Parts
from mmc_gym.geometry import Floats, wrap_angle
from mmc_gym.interface import ReachInterface, Seen, Sensed

MIDDLE = 0.455  # mean square of the median size of normal errors, per variance
SLIP = 0.7  # share of a joint's difference from its commanded turn that remains a step later
SERVO_ERROR = 0.05  # error of a commanded turn, as a share of it
BIASED = SIGMAS**2 * RATE / (2 - RATE)  # bound of the square of a running mean, per variance
MODEL_ERROR = 1e-3  # bound on the error of a turn integrated from steady speeds, radians
CLEAR = 0.01  # noise of the joint angles below which they are taken as they are seen, radians

JERK = 40.0  # J: jerk of a moving target, segment lengths/s³
SETTLED = 4  # observations after a jump until the third difference is noise alone

LONGEST_DELAY = 32  # the longest delay that is bridged, control steps
ONSET = 0.02  # a joint that is faster moves, rad/s
ONSET_OF_HAND = 4e-4  # a hand that moves by more in a control step moves, segment lengths


class Senses(NamedTuple):
    """What is seen: the posture, the target, and how late."""

    posture: PostureTrack
    target: TargetTrack
    delay: Delay
    hand: Points  # as last seen
    is_hidden: Bools  # whether the hand is not seen now, (n,)
    postures: Floats  # joint angles, the latest last, (n, LONGEST_DELAY + 1, N)
    seen: Floats  # joint angles, speeds and hand as seen, likewise
    repeats: Floats  # observations in turn that were seen before, (n,)
    is_later: Bools  # whether any of these was seen before the last one, (n,)
    as_given: Floats  # how far the last command seen should turn joints as given, (n, N)
    commanded: Floats  # and how far by their motors

    @classmethod
    def start(cls, interface: ReachInterface, sensed: Sensed) -> Senses:
        """Return the senses after the first observation, of arms at rest."""
        joint_angles = sensed.joint_angles
        postures = np.repeat(joint_angles[:, None], LONGEST_DELAY + 1, axis=1)
        return cls(
            PostureTrack.start(joint_angles, np.zeros_like(joint_angles)),
            TargetTrack.start(as_points(sensed.target)),
            Delay.start(command_of(interface, joint_angles, joint_angles)),
            np.zeros(len(joint_angles), complex),
            np.zeros(len(joint_angles), bool),
            postures,
            np.full((*postures.shape[:2], 2 * joint_angles.shape[1] + 2), np.inf),
            np.zeros(len(joint_angles)),
            np.zeros(len(joint_angles), bool),
            as_given=np.zeros_like(joint_angles),
            commanded=np.zeros_like(joint_angles),
        )

    def look(self, seen: Seen) -> Senses:
        """Return the senses after the first look at the hand."""
        hand = as_points(seen.hand)
        is_hidden = self._hides(hand, seen.joint_angles)
        return self._replace(hand=hand, is_hidden=is_hidden)

    def complete(self, seen: Seen, lost: Bools, offset: Floats, step: float) -> Seen:
        """Return what is seen, with what is expected in the place of numbers that are lost.

        `lost` are those that may be, see `Seen`.  A speed of 0 is lost if its joint turned.  Hand
        and target are seen from the first segment.  `offset` is what is added to the angles that
        sensors show, (n, N), and `step` the control step.
        """
        posture, angles, speeds = self.posture, seen.joint_angles, seen.joint_speeds
        joints = angles.shape[-1]
        is_steady = (speeds != 0) & (posture.speeds != 0)
        by_speeds = turn_by_speeds(posture.speeds, speeds, step)
        turn = np.where(is_steady, by_speeds, self.commanded)
        before = posture.seen - offset  # as sensors showed it
        angles = np.where(lost[:, :joints], wrap_angle(before + turn), angles)
        turned = wrap_angle(angles - before)
        has_turned = lost[:, joints : 2 * joints] & (np.abs(turned) > SMALL)
        speeds = np.where(has_turned, turned / step, speeds)
        back = np.exp(1j * (angles - seen.joint_angles)[:, 0])
        target, hand = back * as_points(seen.target), back * as_points(seen.hand)
        expected = self.target.predict(np.ones(len(target)))
        hand = np.where(lost[:, -1], expected - (target - hand), hand)
        target = np.where(lost[:, -1], expected, target)
        return Seen(angles, as_vectors(target), speeds, as_vectors(hand))

    def begin_anew(self, seen: Seen, interface: ReachInterface) -> Bools:
        """Return which arms begin another trial, (n,), though nobody says so.

        They are at rest where they cannot have turned to, and have another target.
        """
        posture = self.posture
        turned = np.abs(wrap_angle(seen.joint_angles - posture.seen))
        farthest = full_turn(interface) + SIGMAS * posture.deviation[:, 0]
        begin: Bools = turned.max(axis=-1) > 2 * farthest
        if any_true(begin):
            begin &= np.abs(seen.joint_speeds).max(axis=-1) < _onset(posture)
            moved = np.abs(as_points(seen.target) - self.target.predict(np.ones(len(begin))))
            begin &= moved > JUMP
            if seen.lost is not None:
                is_seen = ~seen.lost
                begin &= is_seen[:, : turned.shape[-1]].all(axis=-1) & is_seen[:, -1]
        return begin

    def _hides(self, hand: Points, joint_angles: Floats) -> Bools:
        """Return which hands are hidden, (n,): seen where they were, although the joints turn."""
        is_hidden = np.abs(hand - self.hand) < SAME
        if any_true(is_hidden):
            turned = np.abs(joint_angles - self.posture.seen).max(axis=-1)
            noise = self.posture.deviation[:, 0]
            is_hidden &= self.is_hidden | (turned > SMALL + SIGMAS * noise)
        return is_hidden

    def update(
        self, seen: Seen, interface: ReachInterface, parts: Parts, motors: Motors
    ) -> tuple[Senses, LastStep]:
        """Return the senses after one more observation, and what it shows of the last step."""
        joint_angles, speeds = seen.joint_angles, seen.joint_speeds
        place, hand = as_points(seen.target), as_points(seen.hand)
        delay, is_again = self.delay, np.zeros(len(hand), bool)
        history = self.seen, self.repeats, self.is_later
        if parts.bridges_delay:
            delay, is_again, history = self._relate(seen, interface)
        repeats = is_again | (self.repeats > 0)
        related, turns = delay, (self.as_given, self.commanded)
        if delay is not self.delay:
            turns = self._commanded_turns(delay, interface, motors)
        if parts.filters:
            posture = self.posture.filter(joint_angles, speeds, turns[1], interface.control_step)
            target = self.target.filter(place, interface.control_step)
        else:
            posture = self.posture.accept(joint_angles, speeds)
            target = self.target.accept(place)
        hidden: Floats = np.zeros(len(hand))
        if not all_true(delay.is_felt) and parts.bridges_delay:
            posture, hidden = self._at_onset(seen, posture, interface.control_step)
        if any_true(is_again):  # then nothing new is seen
            posture = where(is_again, self.posture, posture)
        if not delay.is_known:
            is_sharp = target.history[:, -1] == target.history[:, -2]
            moved = np.abs(hand - self.hand)
            way = self._way_to(posture.likely, np.array(interface.segment_lengths))
            delay = delay.estimate(self.posture, posture, moved, is_sharp, hidden, way)
        if not parts.bridges_delay:  # locks still depend on when a movement is felt
            delay = delay._replace(late=self.delay.late, late_sight=self.delay.late_sight)
        if delay is not related:
            turns = self._commanded_turns(delay, interface, motors)
        postures = self.postures
        if delay.may_lag:
            likely = posture.likely[:, None]
            postures = np.concatenate([postures[:, 1:], likely], axis=1)
        is_hidden = self._hides(hand, joint_angles)
        is_regular = ~repeats
        step = LastStep(
            before=self.posture,
            after=posture,
            as_given=turns[0],
            commanded=turns[1],
            is_felt=delay.is_felt & is_regular,
            is_timely=(delay.late == 0) & is_regular,
        )
        return Senses(posture, target, delay, hand, is_hidden, postures, *history, *turns), step

    def _way_to(self, joint_angles: Floats, lengths: Floats) -> Floats:
        """Return how far the hand of a posture is from its place at the start, (n,)."""
        return np.abs(hand(joint_angles, lengths) - hand(self.postures[:, 0], lengths))

    def record(self, command: Floats, interface: ReachInterface, motors: Motors) -> Senses:
        """Return the senses after commands were sent."""
        delay = self.delay.record(command, self.posture, interface)
        as_given, commanded = self._commanded_turns(delay, interface, motors)
        return self._replace(delay=delay, as_given=as_given, commanded=commanded)

    def _commanded_turns(
        self, delay: Delay, interface: ReachInterface, motors: Motors
    ) -> tuple[Floats, Floats]:
        """Return how far the command should have turned joints as given, and by their motors."""
        posture = self.posture
        as_given = commanded_turn(interface, posture.joint_angles, delay.commands_seen())
        return as_given, motors.expected(posture.turn, as_given, full_turn(interface))

    def _at_onset(
        self, seen: Seen, posture: PostureTrack, control_step: float
    ) -> tuple[PostureTrack, Floats]:
        """Return the posture at the onset of movement, and how many steps of it were hidden, (n,).

        At rest, a repeated observation looks like a new one.  If joints are first seen to move, and
        have turned by more than one step at their speed, earlier steps were hidden: that is neither
        noise nor delay.
        """
        turned = np.abs(wrap_angle(seen.joint_angles - self.posture.seen))
        step = control_step * np.abs(seen.joint_speeds)
        fastest = np.arange(len(step)), step.argmax(axis=-1)
        hidden = np.floor(turned[fastest] / np.maximum(step[fastest], SMALL))
        hidden = np.minimum(hidden, np.maximum(self.delay.due - 1, 0))
        hidden *= ~self.delay.is_felt & (self.posture.noise[:, 0] == 0)
        if not any_true(hidden):
            return posture, hidden
        exact = self.posture.accept(seen.joint_angles, seen.joint_speeds)
        exact = exact._replace(turn=control_step * seen.joint_speeds)
        return where(hidden > 0, exact, posture), hidden

    def _relate(
        self, seen: Seen, interface: ReachInterface
    ) -> tuple[Delay, Bools, tuple[Floats, Floats, Bools]]:
        """Return the delay, whether the observation was seen before, (n,), and the history with it.

        A moving arm never looks the same twice, so an observation that was seen before is late by
        one control step more.  If it repeats an older one than the last, the delay has grown.  If
        it repeats the last one, the next observation shows, by turn and speeds, whether the one
        between is lost or still to come.
        """
        angles, delay = seen.joint_angles, self.delay
        row = np.concatenate([angles, seen.joint_speeds, seen.hand], axis=-1)
        moves = np.abs(seen.joint_speeds).max(axis=-1) > ONSET
        is_again = (self.seen[..., 0] == angles[:, :1]).any(axis=-1) & moves & delay.is_felt
        repeats, is_later, late = self.repeats, self.is_later, delay.late
        if any_true(is_again) or any_true(repeats):  # in others not even the first angle repeats
            same = (self.seen == row[:, None]).all(axis=-1)
            is_again &= same.any(axis=-1)
            is_later = is_again & (is_later | ~same[:, -1])
            repeats = (repeats + 1) * is_again
            ends = (self.repeats > 0) & ~is_again & ~self.is_later
            turned = wrap_angle(angles - self.posture.seen)
            before, control_step = self.posture.speeds, interface.control_step
            step = turn_by_speeds(before, seen.joint_speeds, control_step)
            steps = 1 + self.repeats[:, None]
            nearer = (turned - steps * step) ** 2 - (turned - step) ** 2
            lost = ends & (nearer.sum(axis=-1) < 0)
            late = np.where(is_again, np.minimum(late + 1, LONGEST_DELAY), late)
            late = np.where(lost, np.maximum(late - self.repeats, 0), late)
            delay = delay._replace(late=late, late_sight=delay.late_sight + late - delay.late)
        latest = np.concatenate([self.seen[:, 1:], row[:, None]], axis=1)
        return delay, is_again, (latest, repeats, is_later)

    @property
    def of_hand(self) -> Floats:
        """Joint angles at the time at which the hand is seen.

        A hand that has not been seen to move, although joints have, is where it was at first.
        """
        likely = self.posture.likely
        if not self.delay.may_lag:
            return likely
        waits = self.delay.is_felt & ~self.delay.is_seen
        steps = np.where(waits, LONGEST_DELAY, self.delay.lag).astype(np.intp)
        past = self.postures[np.arange(len(steps)), LONGEST_DELAY - steps]
        return np.where(steps[:, None] > 0, past, likely)


class LastStep(NamedTuple):
    """What is seen of the last control step, to be compared with its command."""

    before: PostureTrack
    after: PostureTrack
    as_given: Floats  # how far the command should have turned joints with the given servos
    commanded: Floats  # and how far, by what is known of the motors
    is_felt: Bools  # whether a movement has been seen in this episode, (n,)
    is_timely: Bools  # whether the arm is seen in time, (n,)


class PostureTrack(NamedTuple):
    """Estimate of where the joints are."""

    joint_angles: Floats  # filtered; they continue beyond ±π
    turn: Floats  # in the last control step; by speeds, where angles are noisy
    filtered_turn: Floats  # that of the filtered angles
    seen: Floats  # joint angles as last seen
    speeds: Floats  # as last seen
    noise: Floats  # R, variance of the seen angles, (n, 1)
    doubt: Floats  # P, variance of the filtered angles
    bias: Floats  # running mean of the innovations, where there is noise
    age: Floats  # number of observations, (n, 1)

    @classmethod
    def start(cls, joint_angles: Floats, speeds: Floats) -> PostureTrack:
        """Return the estimate after the first observation."""
        still, none = np.zeros_like(speeds), np.zeros((len(joint_angles), 1))
        seen = joint_angles, speeds
        return cls(joint_angles, still, still, *seen, none, still, still, age=none + 1)

    def filter(
        self, joint_angles: Floats, speeds: Floats, commanded: Floats, control_step: float
    ) -> PostureTrack:
        """Return the estimate after one more observation, and turns that were commanded."""
        turn = turn_by_speeds(self.speeds, speeds, control_step)
        unclear = error_of_turn(self.speeds, speeds, control_step) + MODEL_ERROR
        strange = np.abs(wrap_angle(joint_angles - self.seen - turn)) - unclear
        median = np.sort(strange, axis=-1)[:, (strange.shape[-1] - 1) // 2, None]
        is_noisy = (median > 0.0) | (self.noise > 0.0)
        if not any_true(is_noisy):
            return self.accept(joint_angles, speeds)
        median = np.maximum(median, 0.0)
        rate = np.maximum(RATE, 1 / self.age)
        noise = self.noise + rate * (median * median / (2 * MIDDLE) - self.noise)
        of_speeds = (unclear * unclear).sum(axis=-1, keepdims=True) / unclear.shape[-1]
        of_command = (SLIP * (self.filtered_turn - commanded)) ** 2 + (SERVO_ERROR * commanded) ** 2
        of_command += SAME**2
        share = of_speeds / (of_speeds + of_command)
        by_speeds, turn = turn, turn + share * (commanded - turn)
        innovation = wrap_angle(joint_angles - self.joint_angles - turn)
        bias = is_noisy * (self.bias + RATE * (innovation - self.bias))
        doubt = np.where(self.age == 1, noise, self.doubt) + share * of_command
        doubt = doubt + np.maximum(bias * bias - BIASED * noise, 0.0)
        gain = doubt / (doubt + noise)
        turn, doubt, age = turn + gain * innovation, (1 - gain) * doubt, self.age + 1
        if not all_true(is_noisy):
            turn = np.where(is_noisy, turn, wrap_angle(joint_angles - self.joint_angles))
        after = self.joint_angles + turn
        turns = np.where(noise < CLEAR * CLEAR, turn, by_speeds), turn
        return PostureTrack(after, *turns, joint_angles, speeds, noise, doubt, bias, age)

    def accept(self, joint_angles: Floats, speeds: Floats) -> PostureTrack:
        """Return the estimate after one more observation, taken as exact."""
        turn, age = wrap_angle(joint_angles - self.joint_angles), self.age + 1
        turns = {"joint_angles": self.joint_angles + turn, "turn": turn, "filtered_turn": turn}
        return self._replace(**turns, seen=joint_angles, speeds=speeds, age=age)

    def by_hand(self, error: Floats, columns: Floats, noise: Floats) -> Floats:
        """Return joint angles, corrected by a hand that is seen elsewhere, by `error`, (n, 2).

        `columns` are the derivatives of the hand by joint angles, (n, N, 2), and `noise` is the
        variance of the seen hand in each coordinate, (n,).
        """
        spread = columns * self.doubt[..., None]
        variance = (columns[..., None] * spread[..., None, :]).sum(axis=1)
        variance += (noise + SAME**2)[:, None, None] * np.eye(2)
        pull = np.linalg.solve(variance, error[..., None])[..., 0]
        turn = (spread * pull[:, None]).sum(axis=-1)
        is_likely = (error * pull).sum(axis=-1) < SIGMAS**2
        return self.joint_angles + is_likely[:, None] * turn

    @property
    def is_clear(self) -> Bools:
        """Whether the seen angles are nearly free of noise, (n, 1)."""
        return self.deviation < CLEAR

    @property
    def likely(self) -> Floats:
        """Joint angles as seen, where they are clear; else filtered."""
        if not any_true(self.noise):
            return self.seen
        return np.where(self.is_clear, self.seen, self.joint_angles)

    @property
    def deviation(self) -> Floats:
        """Standard deviation of the noise of the seen angles, radians, (n, 1)."""
        return np.sqrt(self.noise)


class TargetTrack(NamedTuple):
    """Estimate of where the target is and how it moves, (n,)."""

    history: Points  # the last three observations, the latest last, (n, 3)
    mean: Points  # position of a target at rest
    doubt: Floats  # variance of that mean
    place: Points  # ẑ of a moving target
    velocity: Points  # ẑ′
    curve: Points  # ½ẑ″
    noise: Floats  # σ², in each coordinate
    error_resting: Floats  # mean square error of the predictor of a target at rest
    error_moving: Floats  # and of a moving target
    age: Floats  # number of observations since the target appeared or jumped
    seen: Floats  # number of observations in all
    has_jumped: Bools  # with the last observation
    is_moving: Bools  # whether the predictor of a moving target is used

    @classmethod
    def start(cls, target: Points) -> TargetTrack:
        """Return the estimate after the first observation."""
        zero, at_rest = np.zeros(len(target)), np.zeros_like(target)
        return cls(
            history=np.repeat(target[:, None], 3, axis=1),
            mean=target,
            doubt=zero,
            place=target,
            velocity=at_rest,
            curve=at_rest,
            noise=zero,
            error_resting=zero,
            error_moving=zero,
            age=zero + 1.0,
            seen=zero + 1.0,
            has_jumped=zero > 0,
            is_moving=zero > 0,
        )

    def filter(self, target: Points, control_step: float) -> TargetTrack:
        """Return the track after targets were seen once more, (n,), a control step later."""
        age, seen = self.age + 1, self.seen + 1
        stays = np.abs(target[:, None] - self.history).max(axis=-1) < SAME
        stays &= self.velocity == 0
        same = self._replace(age=age, seen=seen, has_jumped=np.zeros(len(target), bool))
        if all_true(stays):
            return same
        expected = self.place + self.velocity + self.curve
        error, stray = target - expected, target - self.mean
        jumps = self._jumps(error, stray)
        is_settled = (age >= SETTLED) & ~jumps
        noise = np.where(is_settled, self._noise_after(target), self.noise)
        moves = np.abs(np.diff(self.history, axis=-1, append=target[:, None])) > SAME
        noise[~moves[:, -1]] = 0.0

        # The mean of a target at rest.  Its gain is at least that of a plain mean; otherwise
        # noise that seemed small at first would keep it small for long.
        doubt = np.where(age <= SETTLED, noise / self.age, self.doubt) + SAME**2
        gain = np.maximum(np.where(seen <= SETTLED, 0.0, doubt / (doubt + noise)), 1 / age)

        # The parabola of a moving target.
        forget = (JERK * control_step**3 / np.sqrt(noise + SAME**2)) ** (2 / 7)
        forget = np.clip(forget, 1 / self.age, 1.0)
        keep = 1 - forget
        velocity = self.velocity + 2 * self.curve + 1.5 * forget**2 * (1 + keep) * error

        resting = self.error_resting + FAST_RATE * (squared(stray) - self.error_resting)
        moving = self.error_moving + FAST_RATE * (squared(error) - self.error_moving)
        moving = np.where(is_settled, moving, resting)
        after = TargetTrack(
            history=np.concatenate([self.history[:, 1:], target[:, None]], axis=1),
            mean=self.mean + gain * stray,
            doubt=(1 - gain) * doubt,
            place=expected + (1 - keep**3) * error,
            velocity=velocity,
            curve=self.curve + 0.5 * forget**3 * error,
            noise=noise,
            error_resting=resting,
            error_moving=moving,
            age=age,
            seen=seen,
            has_jumped=jumps,
            is_moving=(moving < BETTER * resting) & (age > SETTLED) & moves.all(axis=-1),
        )
        if any_true(jumps):
            fresh = TargetTrack.start(target)._replace(noise=noise, seen=seen, has_jumped=jumps)
            after = where(jumps, fresh, after)
        return where(stays, same, after) if any_true(stays) else after

    def _jumps(self, error: Points, stray: Points) -> Bools:
        """Return which targets jump, from their errors to the moving and the resting prediction."""
        is_moving = self.is_moving
        error_moving = np.where(is_moving, self.error_moving, 0.0)
        usual = SIGMAS * (2 * np.sqrt(self.noise) + np.sqrt(error_moving))
        far = np.abs(np.where(is_moving, error, stray))
        return (self.seen >= SETTLED) & (far > JUMP + usual)

    def _noise_after(self, target: Points) -> Floats:
        """Return the variance σ² of the noise of targets after one more observation, (n,)."""
        oldest, older, last = self.history.T
        third = squared(target - 3 * last + 3 * older - oldest) / 40
        rate = np.maximum(RATE, 1 / np.maximum(self.seen + 2 - SETTLED, 1))
        return self.noise + rate * (third - self.noise)

    def accept(self, target: Points) -> TargetTrack:
        """Return the estimate after one more observation, taken as exact and at rest."""
        return self._replace(mean=target, has_jumped=np.abs(target - self.mean) > JUMP)

    def predict(self, steps: Floats) -> Points:
        """Return where the target will be some control steps (n,) after the observation."""
        if not any_true(self.is_moving):
            return self.mean
        ahead = self.place + self.velocity * steps + self.curve * steps * steps
        return np.where(self.is_moving, ahead, self.mean)


class Delay(NamedTuple):
    """Estimate of how late the senses are, and the commands that bridge it."""

    commands: Floats  # those sent (`command_of`), the latest last, (n, LONGEST_DELAY + 1, N)
    due: Floats  # number of observations since the first that should show movement, (n,)
    late: Floats  # the delay of the joints, (n,)
    is_felt: Bools  # whether a movement of theirs has been seen, (n,)
    late_sight: Floats  # the delay of hand and target, (n,)
    is_seen: Bools  # whether the hand has been seen to move, (n,)

    @classmethod
    def start(cls, command: Floats) -> Delay:
        """Return the estimate for arms at rest, held by these commands."""
        held = np.repeat(command[:, None], LONGEST_DELAY + 1, axis=1)
        zero = np.zeros(len(command))
        return cls(held, zero, zero, zero > 0, zero, zero > 0)

    @property
    def may_lag(self) -> bool:
        """Whether any hand is seen later than its joints are felt, or not seen to move yet."""
        if not all_true(self.is_seen):
            return True
        return any_true(self.late_sight) and any_true(self.late_sight > self.late)

    @property
    def lag(self) -> Floats:
        """How much later hand and target are seen than the joints are felt, (n,)."""
        return np.maximum(self.late_sight - self.late, 0.0)

    @property
    def is_known(self) -> bool:
        """Whether all arms have been felt and seen to move."""
        return all_true(self.is_felt & self.is_seen)

    def estimate(
        self,
        before: PostureTrack,
        posture: PostureTrack,
        moved: Floats,
        is_sharp: Bools,
        hidden: Floats | float = 0.0,
        way: Floats | float = 0.0,
    ) -> Delay:
        """Return the estimate after one more observation of the posture and the hand.

        Joints are never felt later than a hand is seen, if its sight `is_sharp`, (n,): not noisy.
        Values that repeat exactly show no movement, because even noise would change them.  A hand
        that has `moved`, (n,), by more than any late one at its onset was hidden, not late: by more
        than half of its `way` so far, (n,), as far as joints tell.  So is one that has not been
        seen to move for longer than the longest delay.  Steps of the joints' movement that were
        `hidden`, (n,), count as not late.
        """
        moves = np.abs(posture.speeds).max(axis=-1) > _onset(posture)
        moves &= (posture.seen != before.seen).any(axis=-1)
        waited = np.clip(self.due - 1 - hidden, 0, LONGEST_DELAY)
        late = np.where(self.is_felt, self.late, waited)
        is_hidden = ~self.is_seen & (
            (self.due > LONGEST_DELAY + 1) | (moved > np.maximum(JUMP, way / 2))
        )
        late_sight = np.where(self.is_seen, self.late_sight, np.where(is_hidden, late, waited))
        is_felt = moves | self.is_felt
        due = self.due + (self.due > 0)
        is_seen = self.is_seen | (moved > ONSET_OF_HAND) | is_hidden
        late = np.where(is_seen & is_sharp, np.minimum(late, late_sight), late)
        return Delay(self.commands, due, late, is_felt, late_sight, is_seen)

    def record(self, command: Floats, posture: PostureTrack, interface: ReachInterface) -> Delay:
        """Return the estimate after commands were sent."""
        commands = np.concatenate([self.commands[:, 1:], command[:, None]], axis=1)
        due = self.due
        if not all_true(due):
            turn = commanded_turn(interface, posture.joint_angles, command)
            felt_from = _onset(posture) * interface.control_step
            due = np.where(due > 0, due, np.abs(turn).max(axis=-1) > felt_from)
        return self._replace(commands=commands, due=due)

    def commands_seen(self) -> Floats:
        """Return the commands that led to the last observation."""
        if not any_true(self.late):
            return self.commands[:, -1]
        steps = self.late.astype(np.intp)
        return self.commands[np.arange(len(steps)), LONGEST_DELAY - steps]

    def run_forward(
        self, interface: ReachInterface, joint_angles: Floats, turn: Floats, motors: Motors
    ) -> tuple[Floats, Floats]:
        """Return joint angles and last turns of now, by the commands since they were last seen."""
        for back in range(int(self.late.max()), 0, -1):
            asked = commanded_turn(interface, joint_angles, self.commands[:, -back])
            after = motors.expected(turn, asked, full_turn(interface))
            is_due = (back <= self.late)[:, None]
            joint_angles = joint_angles + np.where(is_due, after, 0.0)
            turn = np.where(is_due, after, turn)
        return joint_angles, turn


def _onset(posture: PostureTrack) -> Floats:
    """Return the least speed that is a movement, not noise, rad/s, (n,)."""
    return ONSET + NOISE_OF_SPEEDS * posture.deviation[:, 0]
