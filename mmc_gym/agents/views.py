"""The views that learned policies have of an observation, in numpy and in torch alike.

"arm" is the observation as it is: target and offset are seen from the arm's first segment.  A goal
environment's is brought into the same form.

The task has no preferred direction: turn arm and target about the base, and the same joint speeds
do.  But joint positions mean a direction.  For them there is "target", in which the world is turned
until the target, at φ from the base, lies straight ahead:

    cos (q_1 − φ), sin (q_1 − φ), cos q_2…q_N, sin q_2…q_N, joint speeds,
    |target|, e = R(−φ) (target − hand), e / (NEAR + |e|)

A policy with this view gives joint positions in the turned world, where the posture 0 points at the
target, and `turned_actions` turns them back.

A policy with a memory also sees a `History` of what it observed and did.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mmc_gym.interface import Observation, ObservationLayout, in_the_world, turned_back
from mmc_gym.network.chain import wrap_angle

Float32 = NDArray[np.float32]

View = Literal["arm", "target"]

VIEWS: dict[View, str] = {
    "arm": "posture, joint speeds, target, and offset from hand to target, as observed",
    "target": "all joint angles, joint speeds, the target's distance, and offset from hand to "
    "target, all seen as if the target lay straight ahead, whence its actions are turned back",
}
"""Descriptions of the views, for a table."""


def features(arrays: Any, view: View, observation: Any, layout: ObservationLayout) -> Any:
    """Return the features of observations, (..., `feature_count`), and what they end with.

    The observations are `arrays` of the module numpy or torch: of MMCReach-v0, (..., 3N + 6) or
    longer, or of MMCReachGoal-v0, a mapping.
    """
    if view == "arm":
        return layout.flatten(observation, arrays)
    seen = layout.split(observation, arrays)
    target, offset = ((of[..., :1], of[..., 1:]) for of in (seen.target, seen.offset))
    distance = arrays.hypot(*target)
    # At the base it has no direction; any will do.
    cosine, sine = (x / (distance + (distance == 0)) for x in target)
    near = seen.near[..., :1], seen.near[..., 1:]
    others = seen.cosines[..., 1:], seen.sines[..., 1:]
    parts = (cosine, -sine, *others, seen.speeds, distance, *turned_back(*offset, cosine, sine))
    return arrays.concatenate((*parts, *turned_back(*near, cosine, sine), seen.rest), -1)


def feature_count(view: View, layout: ObservationLayout) -> int:
    """Return how many features an observation without additions has."""
    return layout.size - (view == "target")


def turned_actions(
    arrays: Any, actions: Any, observation: Any, layout: ObservationLayout, *, back: bool = False
) -> Any:
    """Turn joint positions in the target's view into joint positions in the world, or back.

    They are joint angles / π, (..., N).  The first is wrapped to the range from −1 to 1, the others
    stay as they were.  The other arguments are those of `features`.
    """
    seen = layout.split(observation, arrays)
    first = arrays.arctan2(seen.sines[..., :1], seen.cosines[..., :1])
    turn = (first + arrays.arctan2(seen.target[..., 1:], seen.target[..., :1])) / math.pi
    first = (actions[..., :1].clip(-1, 1) + (-turn if back else turn) + 1) % 2 - 1
    return arrays.concatenate((first, actions[..., 1:]), -1)


@dataclass(frozen=True)
class History:
    """A policy's memory: what it observed and did in its last steps, from now backwards.

    The steps are cut into blocks, the latest one first.  Of each block the policy sees the mean of

        joint angles, hand and target, each less what is observed now; actions

    where hand and target are turned into the frame of the first segment as it is now.  So what
    stays put is seen as zeros under any view of the world, a mean over blocks is a filter against
    noise, and a difference between blocks is a velocity.  Before an episode there was what its
    first observation shows, and no action.

    Attributes:
        layout: of the observations.
        blocks: steps in each block.
    """

    layout: ObservationLayout
    blocks: Sequence[int]

    @property
    def size(self) -> int:
        """Number of values that follow an observation."""
        return len(self.blocks) * self._width

    @property
    def steps(self) -> int:
        """Number of steps that are remembered."""
        return sum(self.blocks)

    @property
    def _width(self) -> int:
        return 2 * self.layout.joint_count + 4

    @cached_property
    def _starts(self) -> NDArray[np.intp]:
        return np.cumsum([0, *self.blocks[:-1]])

    def start(self, observation: Observation) -> Float32:
        """Return the memory before an episode's first observation, (..., steps, 2 N + 4)."""
        now = self.observed(observation)
        memory = np.zeros((*now.shape[:-1], self.steps, self._width), np.float32)
        memory[..., : now.shape[-1]] = now[..., None, :]
        return memory

    def recall(self, now: Float32, memory: Float32) -> Float32:
        """Return what a policy sees of its memory, (..., size), where this is `observed` now."""
        count = self.layout.joint_count
        means = np.add.reduceat(memory, self._starts, axis=-2)
        means /= np.array(self.blocks, np.float32)[:, None]
        means[..., : now.shape[-1]] -= now[..., None, :]
        first = now[..., None, 0]
        cosine, sine = np.cos(first), np.sin(first)
        for x in (count, count + 2):
            turned = turned_back(means[..., x], means[..., x + 1], cosine, sine)
            means[..., x], means[..., x + 1] = turned
        return means.reshape(*means.shape[:-2], self.size)

    @staticmethod
    def extended(now: Float32, action: Float32, memory: Float32) -> Float32:
        """Return the memory with one more step: what was `observed`, and the action (..., N)."""
        step = np.concatenate((now, action), -1)
        return np.concatenate((step[..., None, :], memory[..., :-1, :]), -2)

    def observed(self, observation: Observation, memory: Float32 | None = None) -> Float32:
        """Return joint angles, hand and target in the world, (..., N + 4).

        Joint angles go on from those in memory, without jumps of a whole turn.
        """
        seen = self.layout.split(observation)
        angles = np.arctan2(seen.sines, seen.cosines)
        target = in_the_world(seen.target, angles)
        hand = target - in_the_world(seen.offset, angles)
        if memory is not None:
            before = memory[..., 0, : self.layout.joint_count]
            angles = before + wrap_angle(angles - before)
        return np.concatenate((angles, hand, target), -1).astype(np.float32, copy=False)
