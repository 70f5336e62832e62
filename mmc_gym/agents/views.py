"""What a learned policy sees of an observation: two views, in numpy and in torch alike.

"world", with the offset from hand to target enlarged, for success is decided in its last few
hundredths:

    cos q, sin q, joint speeds, target / reach, GAIN · (target − hand) / (2 reach)

"arm", the same in the frame of the arm's first segment.  The task has no preferred direction: turn
arm and target about the base, and the same joint speeds do.  So target and offset are turned by
minus the first joint angle, and that angle is left out:

    cos q_2…q_N, sin q_2…q_N, joint speeds,
    R(−q_1) target / reach, GAIN · R(−q_1) (target − hand) / (2 reach)

Where there is a preferred direction (gravity, obstacles, a turned cursor), or an action means one
(joint positions), the arm's view lacks it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

View = Literal["arm", "world"]

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
    if isinstance(observation, Mapping):
        posture = observation["observation"]
        target = observation["desired_goal"] / reach
        offset = (observation["desired_goal"] - observation["achieved_goal"]) / (2 * reach)
        rest = posture[..., :0]
    else:
        end = 3 * joint_count + 4
        posture = observation[..., : end - 4]
        target, offset = observation[..., end - 4 : end - 2], observation[..., end - 2 : end]
        rest = observation[..., end:]
    if view == "world":
        return arrays.concatenate((posture, target, OFFSET_GAIN * offset, rest), -1)
    cosine, sine = posture[..., :1], posture[..., joint_count : joint_count + 1]

    def turn(vector: Any) -> tuple[Any, Any]:
        x, y = vector[..., :1], vector[..., 1:]
        return cosine * x + sine * y, cosine * y - sine * x

    parts = (
        posture[..., 1:joint_count],
        posture[..., joint_count + 1 :],
        *turn(target),
        *turn(OFFSET_GAIN * offset),
        rest,
    )
    return arrays.concatenate(parts, -1)


def feature_count(view: View, joint_count: int) -> int:
    """How many features an observation without additions has."""
    return 3 * joint_count + {"arm": 2, "world": 4}[view]
