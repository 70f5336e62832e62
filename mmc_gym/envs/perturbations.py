"""Perturbations of motors, body, senses, or of the cursor that stands for the hand.

A family of perturbations is one function of `(arms, strength)`, which overwrites columns of
`mmc_gym.envs.arms.Arms`; `strength` is an array (n,).  Everything else follows from that: strengths
that are drawn, times, mixtures, vectors and the observed context need nothing of a family.  A
`Change` is a family at a strength.  Lengths are in segment lengths.

A family of your own is one more function, see `mmc_gym.perturbation`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from mmc_gym._errors import (
    LARGEST_SIZE,
    SMALLEST_SIZE,
    is_disc,
    is_point,
    require_number,
    require_numbers,
    require_rows,
    require_whole,
)
from mmc_gym.envs.arms import Arms, Floats
from mmc_gym.envs.changes import Change, Distribution, Family, InUnits
from mmc_gym.envs.changes import OneOf as OneOf
from mmc_gym.envs.cursor import cosine_and_sine
from mmc_gym.envs.workspace import Point

FOUR_DISCS = ((1.5, 1.0, 0.25), (-1.5, 1.0, 0.25), (1.5, -1.0, 0.25), (-1.5, -1.0, 0.25))
_MOST_MS = 1e6


# The families of this package, by the group of what they change.  Their order is that of lists.

FAMILIES: dict[str, Family] = {}
"""The families of perturbations by name."""
GROUPS = ("cursor", "geometry", "loads", "locks", "motors", "senses")
"""The groups of families."""


def _family(
    group: str, name: str, unit: str, description: str, default: float, **facts: Any
) -> Callable[[Callable[..., None]], Family]:
    """Return a decorator that makes a function a family; `facts` are more fields of `Family`."""

    def register(apply: Callable[..., None]) -> Family:
        FAMILIES[name] = Family(name, unit, description, default, apply, group=group, **facts)
        return FAMILIES[name]

    return register


_cursor, _geometry, _loads, _locks, _motors, _senses = (partial(_family, name) for name in GROUPS)

# Facts that several families share.
_FINITE: dict[str, Any] = {"low": -LARGEST_SIZE, "high": LARGEST_SIZE}
_LENGTH: dict[str, Any] = {"neutral": 0.0, "known": True, "begins": False, "of": "segment"}
_JOINT: dict[str, Any] = {"low": 1.0, "whole": True}
_SIZE: dict[str, Any] = {"neutral": 0.0, "low": 0.0, "high": LARGEST_SIZE}
_MS: dict[str, Any] = {"neutral": 0.0, "low": 0.0, "high": _MOST_MS}
_FACTOR: dict[str, Any] = {"neutral": 1.0, "low": SMALLEST_SIZE, "high": LARGEST_SIZE}
_FACTOR["begins"] = False
_SHARE: dict[str, Any] = {"neutral": 0.0, "low": 0.0, "high": 2.0}
_CHANCE: dict[str, Any] = {"neutral": 0.0, "low": 0.0, "high": 1.0}


# Cursor: what stands for the hand.


@_cursor("rotation", "°", "cursor turned by {}°", 30.0, neutral=0.0)
def VisuomotorRotation(arms: Arms, degrees: Floats, centre: Point | None = None) -> None:
    """The cursor is the hand, turned counter-clockwise about a centre.

    After Krakauer, Pine, Ghilardi & Ghez (2000), J. Neurosci. 20:8916, who turned by 30°.  The
    centre, (x, y), is by default where the task's movements begin, or the base if they begin
    anywhere.  A turn about the base leaves all targets in reach; one about another point may take
    fixed targets near the border out of reach.
    """
    cosine, sine = cosine_and_sine(degrees)
    arms.turn_cursor(((cosine, -sine), (sine, cosine)), _centre(centre))


@_cursor("gain", "times", "cursor {} times as far as the hand", 1.4, neutral=1.0, low=SMALLEST_SIZE)
def CursorGain(arms: Arms, factor: Floats, centre: Point | None = None) -> None:
    """The cursor is `factor` times as far from the centre as the hand.

    After Krakauer, Pine, Ghilardi & Ghez (2000), J. Neurosci. 20:8916, who also changed the gain.
    """
    arms.turn_cursor(((factor, 0.0 * factor), (0.0 * factor, factor)), _centre(centre))


@_cursor("mirror", "° of the axis", "cursor mirrored at an axis of {}°", 90.0)
def CursorMirror(arms: Arms, degrees: Floats, centre: Point | None = None) -> None:
    """The cursor is the mirror image of the hand, on the other side of an axis through the centre.

    After Telgen, Parvin & Diedrichsen (2014), J. Neurosci. 34:13768, who swapped left and right.
    """
    cosine, sine = cosine_and_sine(degrees)
    along, across = cosine * cosine - sine * sine, cosine * sine + sine * cosine
    arms.turn_cursor(((along, across), (across, -along)), _centre(centre))


@_cursor("clamp", "°", "cursor clamped to a direction {}° from the target", 15.0)
def ErrorClamp(arms: Arms, degrees: Floats) -> None:
    """The cursor moves in a fixed direction, as far from the centre as the freely moving hand.

    After Morehead, Taylor, Parvin & Ivry (2017), J. Cogn. Neurosci. 29:1061.  The direction is
    counter-clockwise from that of the target.
    """
    arms.clamp[:] = degrees


@_cursor(
    "cursor-jump",
    "% of the way",
    "cursor jumps across the way by {} % of it",
    10.0,
    neutral=0.0,
    low=-100.0,
    high=100.0,
)
def CursorJump(arms: Arms, percent: Floats, share: float = 0.25) -> None:
    """The cursor is the hand, until it jumps sideways from the way to the target and stays offset.

    After Saunders & Knill (2005), Exp. Brain Res. 162:458.  It jumps where the hand has covered
    this share of the way, to the left if positive.
    """
    require_number("share", share, "from 0 to 1", lambda number: 0 <= number <= 1)
    arms.jump += percent / 100
    arms.jump_after[:] = share


@_cursor("cursor-shift", "lengths", "cursor shifted by {} segment lengths", 0.2, neutral=0.0)
def cursor_shift(arms: Arms, distance: Floats) -> None:
    """The cursor is to the right of the hand, along x, as through prism goggles.

    After Martin, Keating, Goodkin, Bastian & Thach (1996), Brain 119:1183.
    """
    arms.shift[:, 0] += distance


@_cursor("base-shift", "lengths", "base moved by {} segment lengths", 0.2, neutral=0.0)
def base_shift(arms: Arms, distance: Floats) -> None:
    """The base is further to the right, along x, than agents are given.

    `info["end_effector"]` is still from the base, and obstacles, gravity and fields move with it;
    `info["cursor"]` is where the hand is.
    """
    arms.shift[:, 0] += distance


@_cursor("base-turn", "°", "base turned by {}°", 20.0, neutral=0.0)
def base_turn(arms: Arms, degrees: Floats) -> None:
    """The base is turned counter-clockwise from what agents are given; see `base-shift`."""
    cosine, sine = cosine_and_sine(degrees)
    arms.turn_cursor(((cosine, -sine), (sine, cosine)), (0.0, 0.0))


# Geometry: lengths, and what is in the way.


@_geometry("longer", "%", "last segment {} % longer", 20.0, low=-99.9999, **_LENGTH)
def longer(arms: Arms, percent: Floats, of: Any = -1) -> None:
    """A segment is longer or shorter than before, as by a tool or growth; its mass is the same."""
    arms.segment_lengths *= _factors(arms, 1 + percent / 100, of)


@_geometry(
    "shorter", "%", "last segment {} % shorter", 20.0, high=99.9999, opposite="longer", **_LENGTH
)
def shorter(arms: Arms, percent: Floats, of: Any = -1) -> None:
    """A segment is shorter than before, as after an injury; its mass is the same."""
    arms.segment_lengths *= _factors(arms, 1 - percent / 100, of)


@_geometry(
    "obstacles",
    "discs",
    "fixed discs stop the arm, {}",
    2.0,
    low=1.0,
    high=len(FOUR_DISCS),
    whole=True,
    begins=False,
)
def obstacles(arms: Arms, count: Floats, discs: Any = None, segment_radius: float = 0.05) -> None:
    """Fixed discs in the plane stop the arm, without friction.  Several obstacles add up.

    Starting postures and drawn targets are clear of them.  The way between may be blocked, and
    the path of a pursued target may lead through them.  Physics steps are half as long as without
    obstacles, because a fast segment sinks into a disc a little: at most 0.07 in a million control
    steps of rough commands, and 0.14 with full steps.
    """
    for arm, number in enumerate(count.astype(int).tolist()):
        if not arms.obstacles[arm]:  # else physics steps are short already
            arms.substep[arm] /= 2
            arms.substeps[arm] *= 2
        arms.obstacles[arm] = (*arms.obstacles[arm], *(discs or FOUR_DISCS[:number]))
    arms.segment_radius[:] = segment_radius


# Loads: masses and forces.


@_loads("hand-mass", "segment masses", "hand carries {} segment masses", 3.0, neutral=0.0, low=0.0)
def HandMass(arms: Arms, mass: Floats) -> None:
    """The hand carries a point mass; 3 is as heavy as the default arm.  Masses add up."""
    arms.hand_mass += mass


@_loads(
    "segment-mass",
    "times",
    "last segment {} times as heavy",
    2.0,
    neutral=1.0,
    low=SMALLEST_SIZE,
    begins=False,
    of="segment",
)
def segment_mass(arms: Arms, factor: Floats, of: Any = -1) -> None:
    """A segment is heavier or lighter than before, as by a load along it."""
    arms.segment_masses *= _factors(arms, factor, of)


@_loads("force-field", "mass/s", "viscous curl field of {} at the hand", 60.0, neutral=0.0)
def ForceField(arms: Arms, curl: Floats) -> None:
    """A viscous curl field pushes the hand sideways: force = `curl` · (v_y, −v_x).  Fields add up.

    After Shadmehr & Mussa-Ivaldi (1994), J. Neurosci. 14:3208.  The hand leaves its course where
    the field drives the servos to their torque limit.  A positive curl, in mass / s, bends to the
    right of the movement.
    """
    arms.force_field[:, 0, 1] += curl
    arms.force_field[:, 1, 0] -= curl


@_loads(
    "gravity",
    "lengths/s²",
    "arm hangs in a gravity of {} segment lengths/s²",
    60.0,
    neutral=0.0,
    begins=False,
    is_given=True,
)
def Gravity(arms: Arms, acceleration: Floats) -> None:
    """The arm hangs in gravity, which pulls along −y.  Agents are always given it."""
    arms.gravity[:, 1] -= acceleration


@_loads(
    "channel",
    "mass/s",
    "walls along the way, as for a curl field of {}",
    60.0,
    begins=False,
    **_FINITE,
)
def Channel(arms: Arms, curl: Floats) -> None:
    """Stiff walls confine the hand to the line from its start to the first target.

    After Scheidt, Reinkensmeyer, Conditt, Rymer & Mussa-Ivaldi (2000), J. Neurophysiol. 84:853.
    `info` has the `channel_force` with which the hand pushes to the left, and the `ideal_force`
    that would cancel a curl field: `curl` times the speed along the line.  The slope of
    `channel_force` on `ideal_force` is the share of the field that was learned (Smith, Ghazizadeh &
    Shadmehr 2006, PLoS Biol. 4:e179).
    """
    arms.channel[:] = np.nan_to_num(arms.channel) + curl


@_loads(
    "joint-friction",
    "of the largest torque",
    "dry friction of joints, {} of the largest torque",
    0.3,
    begins=False,
    **_SIZE,
)
def joint_friction(arms: Arms, share: Floats) -> None:
    """Dry friction brakes all joints with this share of the servos' largest torque.

    It is Coulomb's: the same at any speed, and it holds joints at rest.  See Armstrong-Hélouvry,
    Dupont & Canudas de Wit (1994), Automatica 30:1083.
    """
    arms.joint_friction += share * arms.base.torque_limit


@_loads(
    "joint-damping",
    "of the largest torque",
    "viscous friction of joints, {} of the largest torque at full speed",
    0.3,
    begins=False,
    **_SIZE,
)
def joint_damping(arms: Arms, share: Floats) -> None:
    """Viscous friction grows with a joint's speed to this share of the largest torque.

    It has that share at the largest speed that servos ask for.
    """
    arms.joint_damping += share * arms.base.torque_limit / arms.base.speed_limit


# Locks: joints that become rigid.


@_locks(
    "locked", "joint", "joint {} (from the base) locked from the start", 2.0, known=True, **_JOINT
)
def locked(arms: Arms, number: Floats, at: Any = 0.0, until: Any = math.inf) -> None:
    """A joint becomes rigid at its present angle until the next reset, or until it is free again.

    If it is locked from the start, the other joints can reach all targets.  If it locks later, the
    target may become unreachable: the posture at that time is not known when targets are drawn.
    """
    arms.lock(arms.which(number), at, until)


@_locks(
    "locks",
    "joint",
    "joint {} (from the base) locked after 0.2 s",
    2.0,
    known=True,
    begins=False,
    **_JOINT,
)
def locks(arms: Arms, number: Floats) -> None:
    """A joint becomes rigid after 0.2 s, at the angle that it then has, until the next reset."""
    arms.lock(arms.which(number), 0.2, math.inf)


# Motors: what becomes of actions, which are shares of the largest; see `mmc_gym.envs.motors`.


@_motors(
    "motor-gain", "times", "motors turn {} times as far", 0.4, neutral=1.0, of="motor", **_FINITE
)
def motor_gain(arms: Arms, factor: Floats, of: Any = None) -> None:
    """Actions are multiplied by a factor: motors are weak, strong or, below 0, reversed."""
    arms.motor_gain *= _factors(arms, factor, of)


@_motors(
    "motor-offset",
    "of the largest action",
    "motors pushed by {} of the largest action",
    0.2,
    neutral=0.0,
    of="motor",
    **_FINITE,
)
def motor_offset(arms: Arms, share: Floats, of: Any = None) -> None:
    """A constant is added to actions, as by a badly trimmed amplifier; with `-until-`, a push."""
    arms.motor_offset += np.where(arms.which(of), share[:, None], 0.0)


@_motors("dead-zone", "of the largest action", "actions below {} do nothing", 0.1, **_SHARE)
def dead_zone(arms: Arms, share: Floats) -> None:
    """Actions smaller than this share of the largest do nothing."""
    arms.dead_zone[:] = np.maximum(arms.dead_zone, share)


@_motors(
    "backlash",
    "of the largest action",
    "motors follow once actions turned back by {}",
    0.1,
    **_SHARE,
)
def backlash(arms: Arms, share: Floats) -> None:
    """A motor follows only once its action has turned back by this share of the largest.

    This is the play operator of hysteresis, see Tao & Kokotovic (1996), Adaptive Control of Systems
    with Actuator and Sensor Nonlinearities.
    """
    arms.backlash += share


@_motors(
    "action-noise", "of the largest action", "noise of actions, {} of the largest", 0.1, **_SIZE
)
def action_noise(arms: Arms, std: Floats) -> None:
    """White noise of actions, of this standard deviation."""
    _add_variance(arms.action_noise, std)


@_motors("action-noise-size", "of the action", "noise of actions, {} of their size", 0.2, **_SIZE)
def action_noise_size(arms: Arms, std: Floats) -> None:
    """White noise of actions that grows with them.

    After Harris & Wolpert (1998), Nature 394:780.
    """
    _add_variance(arms.action_noise_size, std)


@_motors("action-delay", "ms", "actions late by {} ms", 60.0, **_MS)
def action_delay(arms: Arms, ms: Floats) -> None:
    """Actions arrive late; until the delay is over, the arm rests.  Delays add up.

    They are rounded to control steps.
    """
    arms.action_delay += ms / 1000


@_motors("dropped-actions", "probability", "actions dropped with probability {}", 0.1, **_CHANCE)
def dropped_actions(arms: Arms, probability: Floats, steps: Any = 1) -> None:
    """The action of each motor is dropped now and then, for so many control steps."""
    _happen(arms, "action_dropped", probability, steps)


@_motors("held-actions", "probability", "actions kept with probability {}", 0.1, **_CHANCE)
def held_actions(arms: Arms, probability: Floats, steps: Any = 1) -> None:
    """The action of each motor stays as it was now and then, for so many control steps."""
    _happen(arms, "action_held", probability, steps)


@_motors("repeated-actions", "probability", "actions repeated with probability {}", 0.3, **_CHANCE)
def repeated_actions(arms: Arms, probability: Floats, steps: Any = 1) -> None:
    """An action is sent again now and then, so many times more."""
    _happen(arms, "action_repeated", probability, steps)


@_motors("stuck-motor", "motor", "motor {} (from the base) keeps its last action", 2.0, **_JOINT)
def stuck_motor(arms: Arms, number: Floats) -> None:
    """A motor keeps its last action; from the start on, it rests."""
    arms.motor_stuck |= arms.which(number)


@_motors("torque-limit", "times", "torque limit {} times as high", 0.1, **_FACTOR)
def torque_limit(arms: Arms, factor: Floats) -> None:
    """The servos have less torque, or more, than agents are given."""
    arms.torque_limit *= factor


@_motors("servo-gain", "times", "servos {} times as stiff", 0.5, **_FACTOR)
def servo_gain(arms: Arms, factor: Floats) -> None:
    """The servos ask for less speed, or more, for an angle to their target."""
    arms.servo_gain *= factor


# Senses that are noisy, wrong or late, see `mmc_gym.envs.senses`.


@_senses("joint-noise", "rad", "noise of joint angles, {} rad", 0.02, **_SIZE)
def JointNoise(arms: Arms, std: Floats) -> None:
    """Noise of joint angles, of this standard deviation; that of velocities is 10 / s times that.

    Standing still, people feel their joint angles to about 1° (van Beers, Sittig & Denier van
    der Gon, 1998, Exp. Brain Res. 122:367).
    """
    _add_variance(arms.joint_noise, std)


@_senses("joint-noise-speed", "s", "noise of joint angles, {} s of joint speed", 0.01, **_SIZE)
def JointNoiseSpeed(arms: Arms, std: Floats) -> None:
    """Noise of joint angles whose standard deviation grows with the joint's speed."""
    _add_variance(arms.joint_noise_speed, std)


@_senses(
    "vision-noise",
    "lengths",
    "noise of the seen hand and target, {} segment lengths",
    0.03,
    **_SIZE,
)
def VisionNoise(arms: Arms, std: Floats) -> None:
    """Noise of the seen hand and target, in each coordinate."""
    _add_variance(arms.vision_noise, std)


@_senses(
    "vision-noise-distance",
    "of distance",
    "noise of the seen hand and target, {} of their distance",
    0.05,
    **_SIZE,
)
def VisionNoiseDistance(arms: Arms, std: Floats) -> None:
    """Noise of the seen hand and target that grows with their distance (Weber's law)."""
    _add_variance(arms.vision_noise_distance, std)


@_senses("observation-noise", "of each number", "noise of observed numbers, {}", 0.1, **_SIZE)
def observation_noise(arms: Arms, std: Floats) -> None:
    """White noise of each number of the observation, of this standard deviation, alike for all."""
    _add_variance(arms.observation_noise, std)


@_senses("delay", "ms", "all senses late by {} ms", 100.0, **_MS)
def delay(arms: Arms, ms: Floats) -> None:
    """All observations are late; until the delay is over, they show the start.  Delays add up.

    They are rounded to control steps.  Gymnasium has `gymnasium.wrappers.DelayObservation`, but it
    shows zeros at first, which no posture has, and cannot wrap a vector environment.
    """
    arms.delay += ms / 1000


@_senses("vision-delay", "ms", "sight of hand and target late by {} ms", 100.0, **_MS)
def vision_delay(arms: Arms, ms: Floats) -> None:
    """Hand and target are seen late, while the joints are felt on time.

    Until the delay is over, hand and target are seen where they were at the start.  People also see
    later than they feel (Crevecoeur, Munoz & Scott 2016, J. Neurosci. 36:8598).
    """
    arms.vision_delay += ms / 1000


@_senses("no-feedback", "", "hand not seen after the start", 1.0, has_strength=False)
def NoFeedback(arms: Arms, _: Floats) -> None:
    """The hand is never seen after the start: no visual correction hides what was learned.

    Observations repeat where the hand, or its cursor, was last seen, and `info["is_hand_seen"]`
    says whether it is seen now.  The target is always seen.
    """
    arms.hidden[:] = 1.0


@_senses(
    "endpoint-feedback", "", "hand seen at the end of the movement only", 1.0, has_strength=False
)
def EndpointFeedback(arms: Arms, _: Floats) -> None:
    """The hand is seen only at the end of the movement, and is shown there from then on.

    The movement ends when the hand is slower than 5 % of its peak speed.  People learn from such
    endpoints, too (Taylor, Krakauer & Ivry 2014, J. Neurosci. 34:3023).
    """
    arms.hidden[:] = np.where(arms.hidden == 1.0, 1.0, 2.0)


@_senses(
    "sensor-offset", "rad", "joint sensors off by {} rad", 0.15, neutral=0.0, of="joint", **_FINITE
)
def sensor_offset(arms: Arms, radians: Floats, of: Any = None) -> None:
    """Joints are felt at a constant angle from where they are, as by a badly calibrated sensor."""
    arms.joint_offset += np.where(arms.which(of), radians[:, None], 0.0)


@_senses(
    "sensor-drift",
    "rad/s",
    "joint sensors drift by {} rad/s",
    0.2,
    neutral=0.0,
    of="joint",
    **_FINITE,
)
def sensor_drift(arms: Arms, speed: Floats, of: Any = None) -> None:
    """Joints are felt at an angle from where they are that grows with time."""
    arms.joint_drift += np.where(arms.which(of), speed[:, None], 0.0)


@_senses("stuck-sensor", "joint", "sensor of joint {} (from the base) stuck", 2.0, **_JOINT)
def stuck_sensor(arms: Arms, number: Floats) -> None:
    """A joint is felt where it was before, and at rest."""
    arms.joint_stuck |= arms.which(number)


@_senses(
    "encoder", "counts", "joint sensors of {} counts in a turn", 64.0, low=2.0, high=1e9, whole=True
)
def encoder(arms: Arms, counts: Floats) -> None:
    """Joint angles are rounded to so many counts in a turn."""
    fewer = np.minimum(np.where(arms.encoder == 0.0, np.inf, arms.encoder), counts)
    arms.encoder[:] = fewer


@_senses("dropped-numbers", "probability", "observed numbers 0 with probability {}", 0.1, **_CHANCE)
def dropped_numbers(arms: Arms, probability: Floats, steps: Any = 1) -> None:
    """Each number of the observation is 0 now and then, for so many control steps."""
    _happen(arms, "number_dropped", probability, steps)


@_senses("held-numbers", "probability", "observed numbers kept with probability {}", 0.3, **_CHANCE)
def held_numbers(arms: Arms, probability: Floats, steps: Any = 1) -> None:
    """Each number of the observation stays as it was now and then, for so many control steps."""
    _happen(arms, "number_held", probability, steps)


@_senses(
    "repeated-observations",
    "probability",
    "observations repeated with probability {}",
    0.3,
    **_CHANCE,
)
def repeated_observations(arms: Arms, probability: Floats, steps: Any = 1) -> None:
    """An observation is sent again now and then, so many times more."""
    _happen(arms, "observation_repeated", probability, steps)


def _factors(arms: Arms, factor: Floats, of: Any) -> Floats:
    """Return a factor for each joint or segment, (n, N): 1 but for those of the number `of`."""
    return np.where(arms.which(of), factor[:, None], 1.0)


def _happen(arms: Arms, column: str, probability: Floats, steps: Any) -> None:
    """Let something happen once more, independently, for as many steps as the longest lasts."""
    for count in np.unique(steps).tolist():
        require_whole("steps", int(count) if float(count).is_integer() else count)
    probabilities, durations = getattr(arms, column), getattr(arms, f"{column}_steps")
    probabilities[:] = 1 - (1 - probabilities) * (1 - probability)
    durations[:] = np.maximum(durations, steps)


def _add_variance(std: Floats, more: Floats) -> None:
    std[:] = np.where(std == 0.0, more, np.sqrt(std * std + more * more))


# The same in the units of code: lengths as factors, times in seconds, joints as indices.


def SegmentLength(factor: Any = 1.2, segment: Any = -1, known: bool = False) -> Change:
    """Return the change of a segment to `factor` times its length; segment −1 is the last."""
    is_drawn = isinstance(segment, Distribution)
    number = InUnits(segment, 1.0, 1.0) if is_drawn else segment + 1 if segment >= 0 else segment
    return longer(_in_units(factor, 100.0, -100.0), known=known, **_unless(-1, of=number))


def LockedJoint(joint: Any = 1, time: Any = 0.0, known: bool = False) -> Change:
    """Return the lock of a joint, an index from the base outward, after `time` seconds."""
    return locked(_in_units(joint, 1.0, 1.0), known=known, at=time)


def SensoryDelay(seconds: Any = 0.1) -> Change:
    """Return a delay of all senses."""
    return delay(_in_units(seconds, 1000.0))


def VisionDelay(seconds: Any = 0.1) -> Change:
    """Return a delay of the sight of hand and target."""
    return vision_delay(_in_units(seconds, 1000.0))


def Obstacles(discs: Any = FOUR_DISCS[:2], segment_radius: float = 0.05) -> Change:
    """Return fixed discs, (x, y, radius) each, for segments of half this thickness."""
    rows = require_rows("discs", discs, "discs (x, y, radius), finite, of positive radius", is_disc)
    thickness = _unless(0.05, segment_radius=segment_radius)
    if rows == FOUR_DISCS[: len(rows)]:
        return obstacles(float(len(rows)), **thickness)
    return obstacles(1.0, discs=rows, **thickness)


def Timed(change: Change, at: Any = 0.0, over: Any = 0.0, until: Any = math.inf) -> Change:
    """Return a change that begins at `at`, grows for `over` and ends at `until`, s."""
    return replace(change, at=at, over=over, until=until)


def _in_units(number: Any, factor: float, offset: float = 0.0) -> Any:
    if isinstance(number, Distribution):
        return InUnits(number, factor, offset)
    return offset + factor * require_number("strength", number, "a finite number")


def _unless(default: Any, **settings: Any) -> Mapping[str, Any]:
    """Return the settings that are not the default."""
    return {name: value for name, value in settings.items() if value != default}


def _centre(centre: Any) -> Any:
    if centre is not None:
        require_numbers("centre", centre, "two finite values (x, y)", is_point)
    return centre
