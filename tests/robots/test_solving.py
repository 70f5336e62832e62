"""What a robot is asked to do: whole turns, mistakes, rotations, tools, directions, postures."""

from dataclasses import replace

import numpy as np
import pytest

from mmc_gym import HingeArm, HingeNetwork

UR5, PANDA = HingeArm.named("ur5"), HingeArm.named("panda")
ENDLESS = replace(UR5, limits=np.tile([-np.inf, np.inf], (6, 1)))


def poses_of(arm, count, seed=7):
    low, high = np.clip(arm.limits, -np.pi, np.pi).T
    return arm.forward(np.random.default_rng(seed).uniform(low, high, (count, len(low))))


def is_nearest_turn(angles, reference, arm):
    """Return whether a whole turn more or less leads farther away, or beyond the limits."""
    turned = angles + 2 * np.pi * np.array([-1, 1])[:, None, None]
    is_farther = np.abs(turned - reference) > np.abs(angles - reference) - 1e-9
    return (is_farther | (turned < arm.limits[:, 0]) | (turned > arm.limits[:, 1])).all(axis=0)


@pytest.mark.parametrize("arm", [UR5, PANDA, ENDLESS, replace(UR5, limits=UR5.limits + 1)])
@pytest.mark.parametrize("has_rotation", [True, False])
def test_without_a_start_joints_take_the_turn_nearest_to_the_middle(arm, has_rotation):
    poses = poses_of(arm, 60)
    rotation = poses[:, :3, :3] if has_rotation else None
    solution = HingeNetwork(arm).solve(poses[:, :3, 3], rotation)
    middle = np.where(np.isinf(arm.limits), 0, arm.limits).mean(axis=1)
    assert solution.is_solved.all()
    assert is_nearest_turn(solution.joint_angles, middle, arm).all()
    low, high = arm.limits.T
    assert ((low <= solution.joint_angles) & (solution.joint_angles <= high)).all()
    hand = arm.forward(solution.joint_angles)[:, :3, 3]
    np.testing.assert_allclose(hand, poses[:, :3, 3], atol=1e-3)


def test_a_robot_of_two_turns_stays_within_half_a_turn():
    angles = HingeNetwork(UR5).solve([0.3, 0.2, 0.4]).joint_angles
    assert np.abs(angles).max() <= np.pi


@pytest.mark.parametrize("endless", [1e9, 1e16, 1e100, 1e308])
def test_limits_that_stand_for_endless_are_none(endless):
    arm = replace(UR5, limits=np.tile([-endless, endless], (6, 1)))
    assert np.isinf(arm.limits).all()
    poses = poses_of(arm, 20)
    solution = HingeNetwork(arm).solve(poses[:, :3, 3], poses[:, :3, :3])
    assert solution.is_solved.all()
    assert np.abs(solution.joint_angles).max() <= np.pi


def test_a_joint_may_have_a_limit_on_one_side():
    arm = replace(UR5, limits=[[2, np.inf], [-np.inf, -5], *UR5.limits[2:]])
    poses = poses_of(UR5, 20)
    solution = HingeNetwork(arm).solve(poses[:, :3, 3], poses[:, :3, :3])
    assert solution.is_solved.all()
    first, second = solution.joint_angles[:, :2].T
    assert ((first >= 2) & (first <= 2 + 2 * np.pi)).all()
    assert ((second <= -5) & (second >= -5 - 2 * np.pi)).all()
