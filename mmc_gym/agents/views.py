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
"""

from __future__ import annotations

import math
from typing import Any, Literal

from mmc_gym.interface import ObservationLayout, turned_back

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
