"""The senses: what is seen late, with noise, or not at all, in this order.

    hand, target ─ late by `vision_delay` ┐
                                          ├─ noise ─ hand hidden ─ observation ─ late by `delay`
    joint angles and velocities ──────────┘

Senses disturb observations, never rewards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.envs.arms import Arms, Bools, Floats
from mmc_gym.envs.cursor import CURSOR, Cursor
from mmc_gym.envs.workspace import distances
from mmc_gym.interface import Seen

Indices = NDArray[np.intp]
Randoms = Sequence[np.random.Generator]
NOISE = frozenset(("joint_noise", "joint_noise_speed", "vision_noise", "vision_noise_distance"))
"""The columns of `Arms` that say how noisy the senses are."""
_BLOCK = 50  # control steps for which noise is drawn at once
_VELOCITY_NOISE = 10.0  # of joint velocities, 1/s: times that of the joint angles
_MOVING = 0.05  # of the peak speed; a slower hand has ended its movement, as in `mmc_gym.measures`
_FASTEST_REST = 0.1  # segment lengths / s; a slower peak is no movement


class Disturbance(NamedTuple):
    """What disturbs the senses of n arms at one time, in arrays, or those of one, in numbers."""

    cursor: Cursor | None  #: stands for the hand; None if no arm has one
    delay: Any  #: of all senses, control steps
    vision_delay: Any  #: of sight, besides `delay`, control steps
    hidden: Any  #: see `Arms.hidden`; None if hands are always seen
    noise: NDArray[np.float64] | None  #: the columns of `NOISE`, (n, 4); None if no arm has any

    @classmethod
    def of(cls, arms: Arms, touched: frozenset[str]) -> Disturbance:
        """Return that of arms, given the names of the columns that perturbations touch."""
        step = arms.base.control_step
        noise = arms.joint_noise, arms.joint_noise_speed, arms.vision_noise
        return cls(
            Cursor.of(arms, touched) if touched & CURSOR else None,
            np.rint(arms.delay / step).astype(int),
            np.rint(arms.vision_delay / step).astype(int),
            arms.hidden if "hidden" in touched else None,
            np.stack([*noise, arms.vision_noise_distance], -1) if touched & NOISE else None,
        )

    def of_one(self) -> Disturbance:
        """Return that of a single arm, with numbers for the cursor and the delays."""
        return self._replace(
            cursor=None if self.cursor is None else self.cursor.row(0),
            delay=int(self.delay[0]),
            vision_delay=int(self.vision_delay[0]),
        )


class Noise:
    """White, normally distributed noise of the senses of n arms, drawn for many steps at once.

    Each arm's own generator draws its numbers; without noise it draws none.
    """

    def __init__(self, count: int, joints: int, touched: frozenset[str]) -> None:
        """Prepare for n arms, given the names of the columns that perturbations touch."""
        self._joints = joints if touched & {"joint_noise", "joint_noise_speed"} else 0
        sights = 4 if touched & {"vision_noise", "vision_noise_distance"} else 0
        self._numbers = np.zeros((count, _BLOCK, 2 * self._joints + sights))
        self._is_noisy = np.zeros(count, dtype=bool)

    def begin(self, arms: Indices, noise: Floats) -> None:
        """Begin episodes of some arms, given their largest noise, (k, 4)."""
        self._is_noisy[arms] = is_noisy = noise.any(axis=1)
        self._numbers[arms[~is_noisy]] = 0.0  # the first step draws those of the others

    def disturb(
        self, seen: Seen, noise: Floats, arms: Indices, steps: Indices, randoms: Randoms
    ) -> Seen:
        """Return what k arms sense with the noise of a step, (k, 4).

        `arms` are indices of all arms, each of which has its generator in `randoms`, (n,), and
        `steps` control steps since the start, (k,).
        """
        places = steps % _BLOCK
        for arm in arms[(places == 0) & self._is_noisy[arms]].tolist():
            randoms[arm].standard_normal(out=self._numbers[arm])
        numbers, end = self._numbers[arms, places], 2 * self._joints
        joint, joint_speed, vision, vision_distance = noise.T[..., None]
        if end:
            std = _combined(joint, joint_speed * np.abs(seen.joint_speeds))
            of_angles, of_speeds = np.split(numbers[:, :end], 2, axis=-1)
            seen = replace(
                seen,
                joint_angles=seen.joint_angles + std * of_angles,
                joint_speeds=seen.joint_speeds + _VELOCITY_NOISE * std * of_speeds,
            )
        if numbers.shape[1] > end:
            apart = distances(seen.hand, seen.target)[..., None]
            std = _combined(vision, vision_distance * apart)
            of_hand, of_target = np.split(numbers[:, end:], 2, axis=-1)
            hand, target = seen.hand + std * of_hand, seen.target + std * of_target
            seen = replace(seen, hand=hand, target=target)
        return seen


def _combined(std: Floats, more: Floats) -> Floats:
    """Return the standard deviation of the sum of two independent noises."""
    return np.sqrt(std * std + more * more)


class HandSight:
    """A memory of where the hands of n arms were last seen, and of their movements' ends."""

    def __init__(self, count: int, control_step: float) -> None:
        self._seen, self._hands = np.zeros((2, count, 2))
        self._peaks, self._fastest_rest = np.zeros(count), _FASTEST_REST * control_step
        self._has_ended = np.zeros(count, dtype=bool)
        self.is_seen = np.ones(count, dtype=bool)  #: in the last look, (n,)

    def look(
        self, arms: Indices, steps: Indices, hands: Floats, seen: NDArray[Any], hidden: Floats
    ) -> Floats:
        """Return where the hands of k arms were last seen, (k, 2), and remember it.

        `arms` are indices, (k,), `steps` control steps since the start, (k,), `hands` the true
        positions, (k, 2), `seen` those that would be shown, (k, 2), and `hidden` as in `Arms`.
        """
        starts = steps == 0
        self._peaks[arms[starts]], self._has_ended[arms[starts]] = 0.0, False
        moved = np.where(starts, 0.0, distances(hands, self._hands[arms]))
        peaks = np.maximum(self._peaks[arms], moved)
        is_slow = (moved < _MOVING * peaks) & (peaks > self._fastest_rest)
        ends: Bools = is_slow & ~self._has_ended[arms]
        is_seen = starts | (hidden == 0.0) | (ends & (hidden == 2.0))
        self._hands[arms], self._peaks[arms], self.is_seen[arms] = hands, peaks, is_seen
        self._has_ended[arms] |= ends
        self._seen[arms] = np.where(is_seen[:, None], seen, self._seen[arms])
        return self._seen[arms]


class Late:
    """The last values of n arms, of which each arm's arrives so many steps late."""

    def __init__(self, value: Any, most: int) -> None:
        """Make room for delays of at most so many steps; `value` is an array (n, …), or a mapping.

        A mapping is never late.
        """
        self._value = value
        if most:
            self._values = np.repeat(value[None], most + 1, axis=0)
        self._most, self._newest = most, 0

    def grow(self, most: int) -> None:
        """Make room for longer delays; the oldest value fills it."""
        if most > self._most:
            order = (self._newest - np.arange(self._most, -1, -1)) % (self._most + 1)
            values = self._values[order] if self._most else self._value[None]
            more = np.repeat(values[:1], most - self._most, axis=0)
            self._values = np.concatenate([more, values])
            self._most, self._newest = most, most

    @property
    def is_late(self) -> bool:
        """Whether a value may arrive later than it is sent; else the newest one is handed out."""
        return self._most > 0

    @property
    def oldest(self) -> Any:
        """The value that the next one replaces; it may be overwritten and sent."""
        return self._values[(self._newest + 1) % (self._most + 1)] if self._most else self._value

    def send(self, value: Any) -> None:
        """Send a value on its way, in place of the oldest."""
        if not self._most:
            self._value = value
            return
        oldest = self.oldest
        self._newest = (self._newest + 1) % (self._most + 1)
        if not np.may_share_memory(value, oldest):  # else it was written into this place
            oldest[...] = value

    def fill(self, arms: Indices, value: Any) -> None:
        """Let the value of some arms be all that is on its way."""
        if self._most:
            self._values[:, arms] = value
        else:
            put(self._value, arms, value)

    def arrived(self, delays: Any) -> Any:
        """Return the value of each arm that arrives now, given its delay, (n,)."""
        if not self._most:
            return self._value
        slots, count = self._values.shape[:2]
        rows = (self._newest - delays) % slots * count + np.arange(count)
        return self._values.reshape(slots * count, *self._values.shape[2:]).take(rows, axis=0)


def put(values: Any, arms: Indices, rows: Any) -> None:
    """Write rows of some arms into an array, or into each array of a mapping."""
    if isinstance(values, dict):
        for name in rows:
            values[name][arms] = rows[name]
    else:
        values[arms] = rows
