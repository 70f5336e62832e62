"""What a learned policy sees of an observation: three views, in numpy and in torch alike.

"world", with the offset from hand to target enlarged, for success is decided in its last few
hundredths:

    cos q, sin q, joint speeds, target / reach, GAIN · (target − hand) / (2 reach)

The task has no preferred direction: turn arm and target about the base, and the same joint speeds
do.  The other two views are those of a world that is turned so that something lies on its x axis,
whereby one number becomes superfluous.  "arm" is that of the arm's first segment:

    cos q_2…q_N, sin q_2…q_N, joint speeds,
    R(−q_1) target / reach, GAIN · R(−q_1) (target − hand) / (2 reach)

"target" is that of the target, in direction φ from the base:

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
from collections.abc import Mapping
from typing import Any, Literal

View = Literal["arm", "target", "world"]

OFFSET_GAIN = 6.0


def features(arrays: Any, view: View, observation: Any, joint_count: int, reach: float) -> Any:
    """The features of observations, (..., `feature_count`), and what observations end with.

    Args:
        arrays: the module that the observations are arrays of, numpy or torch.
        view: which.
        observation: of MMCReach-v0, (..., 3N + 4) or longer, or of MMCReachGoal-v0, a mapping.
        joint_count: N.
        reach: sum of the segment lengths, by which the goals of a mapping are divided.
    """
    posture, target, offset, rest = _parts(observation, joint_count, reach)
    offset = OFFSET_GAIN * offset
    parts: tuple[Any, ...]
    if view == "world":
        return arrays.concatenate((posture, target, offset, rest), -1)
    first = posture[..., :1], posture[..., joint_count : joint_count + 1]  # cosine and sine of q_1
    others = posture[..., 1:joint_count], posture[..., joint_count + 1 :]
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


def feature_count(view: View, joint_count: int) -> int:
    """How many features an observation without additions has."""
    return 3 * joint_count + {"arm": 2, "target": 3, "world": 4}[view]


def turned_actions(
    arrays: Any, actions: Any, observation: Any, joint_count: int, *, back: bool = False
) -> Any:
    """Joint positions in the target's view as joint positions in the world, or back.

    Args:
        arrays: the module that actions and observations are arrays of, numpy or torch.
        actions: joint angles / π, (..., N).
        observation: that they answer, see `features`.
        joint_count: N.
        back: from the world into the target's view.

    Returns:
        Those actions, (..., N); the first is wrapped to the range from −1 to 1, the others are as
        they were.
    """
    _, target, _, _ = _parts(observation, joint_count, reach=1.0)  # only its direction counts
    turn = arrays.arctan2(target[..., 1:], target[..., :1]) / math.pi
    first = (actions[..., :1].clip(-1, 1) + (-turn if back else turn) + 1) % 2 - 1
    return arrays.concatenate((first, actions[..., 1:]), -1)


def _parts(observation: Any, joint_count: int, reach: float) -> tuple[Any, Any, Any, Any]:
    """Posture and joint speeds (..., 3N), target, offset (..., 2), and what else there is."""
    if isinstance(observation, Mapping):
        posture, target = observation["observation"], observation["desired_goal"]
        offset = (target - observation["achieved_goal"]) / (2 * reach)
        return posture, target / reach, offset, posture[..., :0]
    end = 3 * joint_count + 4
    posture, rest = observation[..., : end - 4], observation[..., end:]
    return posture, observation[..., end - 4 : end - 2], observation[..., end - 2 : end], rest


def _turned_back(x: Any, y: Any, cosine: Any, sine: Any) -> tuple[Any, Any]:
    """Components of vectors (x, y) in a frame whose x axis points to (cosine, sine)."""
    return cosine * x + sine * y, cosine * y - sine * x
