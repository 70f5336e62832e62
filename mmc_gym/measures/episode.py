"""One recorded episode: the arrays from which all measures are computed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]

MOVING = 0.05  # of the peak speed; a slower hand counts as resting


@dataclass(frozen=True, eq=False, repr=False)
class Episode:
    """One recorded episode of n steps, of an arm with N joints; N = 0 for a hand without an arm.

    Values that an environment does not report are NaN.
    """

    seed: int  #: given to the environment's reset
    #: Positions of the end effector, segment lengths, from the start on, (n + 1, 2); like targets
    #: (n + 1, 3) of an arm in space.
    hands: Floats
    distances: Floats  #: from hand (or cursor) to target, segment lengths, (n + 1,)
    targets: Floats  #: positions of the target, segment lengths, (n + 1, 2)
    joint_angles: Floats  #: relative, not wrapped, radians, (n + 1, N)
    servo_impulses: Floats  #: ∫ |τ| dt of each step and joint, mass · length² / s, (n, N)
    servo_work: Floats  #: ∫ |τ q̇| dt of each step and joint, mass · length² / s², (n, N)
    rewards: Floats  #: of each step, (n,)
    action_times: Floats  #: duration of `predict` in each step, seconds, (n,)
    control_step: float  #: duration of a step, seconds
    tolerance: float  #: distance within which the environment counts the target as reached
    reach: float  #: of the arm as agents are given it, segment lengths
    #: Positions of the cursor under a visuomotor rotation, (n + 1, 2); distances and success are
    #: the cursor's.  None where agents see the hand itself.
    cursors: Floats | None = None
    #: Forces to the left in a channel, see `Channel`: the hand's, and the one that would cancel the
    #: field, mass · length / s², (n + 1,) each; None without a channel.
    channel_forces: Floats | None = None
    ideal_forces: Floats | None = None
    #: The environment's own word on success, where no tolerance is known (NaN); else None.
    is_success: bool | None = None

    def __repr__(self) -> str:
        end = f"{self.distances[-1]:.3f} from the target at the end"
        return f"<Episode of seed {self.seed}, {len(self.rewards)} steps, {end}>"

    @property
    def seen_hands(self) -> Floats:
        """Positions of the cursor if there is one, else of the hand, (n + 1, 2)."""
        return self.hands if self.cursors is None else self.cursors

    @property
    def channel_share(self) -> float:
        """Slope of the channel's force on the ideal one, through the origin; NaN without one."""
        if self.channel_forces is None or self.ideal_forces is None or not self.ideal_forces.any():
            return math.nan
        ideal = self.ideal_forces
        return float(self.channel_forces @ ideal / (ideal @ ideal))

    @property
    def target(self) -> Floats:
        """Position of the target at the start, segment lengths, (2,)."""
        return np.asarray(self.targets[0])

    @property
    def is_target_fixed(self) -> bool:
        """True if the target neither moves nor is replaced by another."""
        return bool((self.targets == self.targets[0]).all())

    @cached_property
    def speeds(self) -> Floats:
        """Speed of the hand in each step, segment lengths/s, (n,)."""
        return hand_speed(self.hands, self.control_step)

    @cached_property
    def movement(self) -> slice:
        """Steps of the `moving_part`; empty if the hand never leaves the tolerance of its start."""
        away = np.linalg.norm(self.hands - self.hands[0], axis=-1)
        return moving_part(self.speeds) if away.max() > self.tolerance else slice(0, 0)

    @property
    def movement_speeds(self) -> Floats:
        """Speeds in the steps of the `movement`, (m,)."""
        return self.speeds[self.movement]


def hand_speed(hands: ArrayLike, control_step: float) -> Floats:
    """Return the speed of the hand in each control step, |p_{k+1} − p_k| / T, (steps,).

    It is that in the middle of the step, in segment lengths/s, up to terms in T².  Positions p are
    (steps + 1, 2), and the `control_step` T is in seconds.
    """
    steps = np.diff(np.asarray(hands, dtype=np.float64), axis=0)
    speeds: Floats = np.linalg.norm(steps, axis=-1) / control_step
    return speeds


def moving_part(speeds: ArrayLike) -> slice:
    """Return the steps from the first to the last with at least 5 % of the peak speed.

    The slice is empty at rest, and where a speed is not known.
    """
    profile = np.asarray(speeds, dtype=np.float64)
    highest = profile.max(initial=0.0)
    if not highest > 0.0:
        return slice(0, 0)
    fast = np.flatnonzero(profile >= MOVING * highest)
    return slice(int(fast[0]), int(fast[-1]) + 1)
