"""The senses: what is wrong, noisy, hidden or late, in this order.

    hand, target ─ late by `vision_delay` ┐
                                          ├─ noise ─ counts of encoders, hand hidden ─ observation
    joint angles ─ stuck ─ offset, drift ─┘

    observation ─ noise ─ numbers dropped ─ numbers held ─ repeated ─ late by `delay`

Senses disturb observations, never rewards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmc_gym.envs.arms import JOINT_NOISE, SPELLS, VISION_NOISE, Arms, Bools, Floats
from mmc_gym.envs.buffers import Indices, Late, Noise, Spells, combined
from mmc_gym.envs.workspace import distances
from mmc_gym.interface import Seen

FELT = frozenset(("joint_stuck", "joint_offset", "joint_drift", "encoder", *JOINT_NOISE))
"""The columns of `Arms` that say what is felt of the joints."""
SIGHT = frozenset((*VISION_NOISE, "vision_delay", "hidden"))
"""The columns of `Arms` that say what is seen of hand and target."""
SENSES = FELT | SIGHT | {"observation_noise", *SPELLS, "delay"}
"""All columns of `Arms` that disturb the senses."""
_VELOCITY_NOISE = 10.0  # of joint velocities, 1/s: times that of the joint angles
_MOVING = 0.05  # of the peak speed; a slower hand has ended its movement, as in `mmc_gym.measures`
_FASTEST_REST = 0.1  # segment lengths / s; a slower peak is no movement


class Senses:
    """The senses of n arms, with what they remember of an episode."""

    def __init__(
        self,
        count: int,
        joints: int,
        limits: NDArray[np.float32],
        delays: Mapping[str, int],
        touched: frozenset[str],
        control_step: float,
    ) -> None:
        """Prepare for n arms of N joints, given the names of the columns that are touched.

        `limits` are those of an observation, and `delays` the longest, control steps.
        """
        self._limits, size = limits, len(limits)
        self.change_state = bool(touched & (FELT | SIGHT))  #: whether `sense` changes anything
        self._touched, self._step = touched, control_step
        self._sights = Late(np.zeros((count, 2, 2)), delays["vision_delay"])  # hands and targets
        self._felt, self._drifted = np.zeros((2, count, joints))  # joint angles before, and drift
        self._hand_sight = HandSight(count, control_step)
        sizes = zip(SPELLS, (size, size, 1), strict=True)
        self._spells = {name: Spells(name, count, size) for name, size in sizes if name in touched}
        self._before = np.zeros((count, size), np.float32)  # the last observation
        self.late = Late(np.zeros((count, size), np.float32), delays["delay"])  #: observations

    def grow(self, delays: Mapping[str, int]) -> None:
        """Make room for longer delays, control steps."""
        self._sights.grow(delays["vision_delay"])
        self.late.grow(delays["delay"])

    def sense(
        self,
        indices: Indices,
        steps: Indices,
        true: Seen,
        arms: Arms,
        noise: Noise,
        hands: Floats,
    ) -> tuple[Seen, Bools | None]:
        """Return what is sensed of k arms: all, or some at their start; and which hands are seen.

        `indices` and `steps` since the start are (k,), `true` is what there is to see, `arms` have
        the present columns of all n, and `hands` are the true positions, (k, 2).
        """
        touched, seen, rows = self._touched, true, self._rows(indices)
        if "vision_delay" in touched:
            self._sights.take(indices, steps, np.stack([seen.hand, seen.target], axis=1))
            sights = self._sights.arrived(arms.steps_of("vision_delay"))[rows]
            seen = replace(seen, hand=sights[:, 0], target=sights[:, 1])
        if touched & FELT:
            seen = self._feel(indices, steps, seen, arms, noise)
        if touched & VISION_NOISE:
            std, increase = arms.vision_noise[rows], arms.vision_noise_distance[rows]
            noisy = np.flatnonzero(std + increase)
            hand, target = seen.hand.copy(), seen.target.copy()
            apart = distances(hand[noisy], target[noisy])
            std = combined(std[noisy], increase[noisy] * apart)[:, None]
            normal = std * noise.normal("vision_noise", steps[noisy], indices[noisy])
            hand[noisy] += normal[:, :2]
            target[noisy] += normal[:, 2:]
            seen = replace(seen, hand=hand, target=target)
        if "hidden" in touched:
            sight = self._hand_sight
            shown = sight.look(indices, steps, hands, seen.hand, arms.hidden[indices])
            return replace(seen, hand=shown), sight.is_seen[indices]
        return seen, None

    def _rows(self, indices: Indices) -> Any:
        """Return the indices of arms, or the slice of all, which is quicker."""
        return slice(None) if len(indices) == len(self._before) else indices

    def _feel(self, indices: Indices, steps: Indices, seen: Seen, arms: Arms, noise: Noise) -> Seen:
        """Return what is felt of the joints of k arms, besides what is seen."""
        touched, rows = self._touched, self._rows(indices)
        angles, speeds = seen.joint_angles.copy(), seen.joint_speeds.copy()
        if "joint_stuck" in touched:
            is_stuck = arms.joint_stuck[rows]
            np.copyto(angles, self._felt[rows], where=is_stuck & (steps > 0)[:, None])
            speeds[is_stuck] = 0.0
            self._felt[rows] = angles
        if "joint_offset" in touched:
            angles += arms.joint_offset[rows]
        if "joint_drift" in touched:
            drifted = self._drifted[rows] + arms.joint_drift[rows] * self._step
            drifted[steps == 0] = 0.0
            self._drifted[rows] = drifted
            angles += drifted
        if touched & JOINT_NOISE:
            std, increase = arms.joint_noise[rows], arms.joint_noise_speed[rows]
            noisy = np.flatnonzero(std + increase)
            std, increase = std[noisy, None], increase[noisy, None]
            std = combined(std, increase * np.abs(speeds[noisy]))
            normal = noise.normal("joint_noise", steps[noisy], indices[noisy])
            of_angles, of_speeds = np.split(normal, 2, axis=-1)
            angles[noisy] += std * of_angles
            speeds[noisy] += _VELOCITY_NOISE * std * of_speeds
        if "encoder" in touched:
            counts = arms.encoder[rows]
            counted = np.flatnonzero(counts)
            width = 2 * np.pi / counts[counted, None]
            angles[counted] = np.rint(angles[counted] / width) * width
        return replace(seen, joint_angles=angles, joint_speeds=speeds)

    def transmit(
        self,
        indices: Indices,
        steps: Indices,
        observation: NDArray[np.float32],
        arms: Arms,
        noise: Noise,
    ) -> NDArray[np.float32]:
        """Return what is transmitted of observations of k arms, (k, …), see `sense`."""
        rows = self._rows(indices)
        if "observation_noise" in self._touched:
            std = arms.observation_noise[rows]
            noisy = np.flatnonzero(std)
            normal = noise.normal("observation_noise", steps[noisy], indices[noisy])
            observation = observation.copy()
            observation[noisy] = observation[noisy] + std[noisy, None] * normal
            observation = observation.clip(-self._limits, self._limits)
        if self._spells:
            observation, is_later = observation.copy(), steps > 0
            for name, spells in self._spells.items():
                places, happens = spells.now(arms, noise, steps, rows, is_later)
                before = 0.0 if name == "number_dropped" else self._before[indices[places]]
                observation[places] = np.where(happens, before, observation[places])
            self._before[rows] = observation
        if "delay" not in self._touched:
            return observation
        self.late.take(indices, steps, observation)
        return np.asarray(self.late.arrived(arms.steps_of("delay"))[indices])


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
