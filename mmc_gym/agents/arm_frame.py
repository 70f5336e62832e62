"""What a learned policy sees: the observation, in the frame of the arm's first segment.

The task has no preferred direction: turn arm and target about the base, and the same joint speeds
do.  So target and offset are turned by minus the first joint angle, and that angle is left out:

    cos q_2…q_N, sin q_2…q_N, joint speeds,
    R(−q_1) target / reach, GAIN · R(−q_1) (target − hand) / (2 reach)

The offset from hand to target is enlarged, for success is decided in its last few hundredths.
Where there is a preferred direction (gravity, obstacles, a turned cursor) this view lacks it.

The same function serves numpy, where the policy acts, and torch, where it is trained.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

OFFSET_GAIN = 6.0


def in_arm_frame(arrays: Any, observation: Any, joint_count: int, reach: float) -> Any:
    """The features of observations, (..., 3N + 2), and whatever the observations end with.

    Args:
        arrays: the module that the observations are arrays of, numpy or torch.
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


def feature_count(joint_count: int) -> int:
    """How many features an observation without additions has."""
    return 3 * joint_count + 2
