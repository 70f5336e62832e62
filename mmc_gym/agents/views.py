"""The views that learned policies have of an observation, in numpy and in torch alike.

"world", with the offset from hand to target enlarged, for success is decided in its last few
hundredths:

    cos q, sin q, joint speeds, target / reach, GAIN · (target − hand) / (2 reach)

The task has no preferred direction: turn arm and target about the base, and the same joint speeds
do.  The other two views turn the world, which makes one number superfluous.  In "arm" the arm's
first segment lies on the x axis:

    cos q_2…q_N, sin q_2…q_N, joint speeds,
    R(−q_1) target / reach, GAIN · R(−q_1) (target − hand) / (2 reach)

In "target" the target does, which is in direction φ from the base:

    cos (q_1 − φ), sin (q_1 − φ), cos q_2…q_N, sin q_2…q_N, joint speeds,
    |target| / reach, GAIN · R(−φ) (target − hand) / (2 reach)

It is for joint positions, which mean a direction as well: a policy with this view gives them in
the turned world, where the posture 0 points at the target, and `turned_actions` turns them back.
The arm's view has nothing to say of the first one.

Where there is a preferred direction (gravity, obstacles, a turned cursor), only the world's view
shows it.
"""

from __future__ import annotations

import math
from typing import Any, Literal

from mmc_gym.interface import ObservationLayout

View = Literal["arm", "target", "world"]

VIEWS: dict[View, str] = {
    "arm": "joint angles but the first, joint speeds, target, and offset from hand to target, all "
    "seen from the arm's first segment",
    "target": "all joint angles, joint speeds, the target's distance, and offset from hand to "
    "target, all seen as if the target lay straight ahead, whence its actions are turned back",
    "world": "all joint angles, joint speeds, target, and offset from hand to target",
}
"""Descriptions of the views, for a table."""

OFFSET_GAIN = 6.0


def features(arrays: Any, view: View, observation: Any, layout: ObservationLayout) -> Any:
    """Return the features of observations, (..., `feature_count`), and what they end with.

    The observations are `arrays` of the module numpy or torch: of MMCReach-v0, (..., 3N + 4) or
    longer, or of MMCReachGoal-v0, a mapping.
    """
    cosines, sines, speeds, target, offset, rest = layout.split(observation)
    offset = OFFSET_GAIN * offset
    parts: tuple[Any, ...]
    if view == "world":
        return arrays.concatenate((cosines, sines, speeds, target, offset, rest), -1)
    first = cosines[..., :1], sines[..., :1]
    others = cosines[..., 1:], sines[..., 1:], speeds
    goal = target[..., :1], target[..., 1:]
    left = offset[..., :1], offset[..., 1:]
    if view == "arm":
        parts = (*others, *_turned_back(*goal, *first), *_turned_back(*left, *first), rest)
        return arrays.concatenate(parts, -1)
    distance = arrays.hypot(*goal)
    # At the base it has no direction; any will do.
    direction = tuple(x / (distance + (distance == 0)) for x in goal)
    parts = (*_turned_back(*first, *direction), *others, distance)
    return arrays.concatenate((*parts, *_turned_back(*left, *direction), rest), -1)


def feature_count(view: View, layout: ObservationLayout) -> int:
    """Return how many features an observation without additions has."""
    return layout.size + {"arm": -2, "target": -1, "world": 0}[view]


def turned_actions(
    arrays: Any, actions: Any, observation: Any, layout: ObservationLayout, *, back: bool = False
) -> Any:
    """Turn joint positions in the target's view into joint positions in the world, or back.

    They are joint angles / π, (..., N).  The first is wrapped to the range from −1 to 1, the others
    stay as they were.  The other arguments are those of `features`.
    """
    target = layout.split(observation).target
    turn = arrays.arctan2(target[..., 1:], target[..., :1]) / math.pi
    first = (actions[..., :1].clip(-1, 1) + (-turn if back else turn) + 1) % 2 - 1
    return arrays.concatenate((first, actions[..., 1:]), -1)


def _turned_back(x: Any, y: Any, cosine: Any, sine: Any) -> tuple[Any, Any]:
    """Return the components of vectors (x, y) in a frame whose x axis is (cosine, sine)."""
    return cosine * x + sine * y, cosine * y - sine * x
