"""Facts about what the hand can reach, and what is drawn from there."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from mmc_gym.body import ArmParameters
from mmc_gym.envs.perturbations import VisuomotorRotation
from mmc_gym.envs.reach import MMCReachEnv
from mmc_gym.envs.workspace import Workspace
from mmc_gym.network.chain import reachable_radii, segments_from_joint_angles


def workspace(lengths):
    return Workspace(ArmParameters(tuple(lengths)))


@pytest.mark.parametrize("lengths", [(1.0, 1.0, 1.0), (3.0, 1.0, 0.5)])
def test_targets_are_uniform_over_the_area_that_the_hand_reaches(lengths):
    random = np.random.default_rng(0)
    x, y = np.array([workspace(lengths).draw_target(random, []) for _ in range(5_000)]).T
    inner, outer = reachable_radii(lengths)
    area = (x**2 + y**2 - inner**2) / (outer**2 - inner**2)
    assert stats.kstest(area, "uniform").pvalue > 0.01
    angle = (np.arctan2(y, x) + math.pi) / math.tau
    assert stats.kstest(angle, "uniform").pvalue > 0.01
    assert abs(np.corrcoef(area, angle)[0, 1]) < 4 / math.sqrt(5_000)


@given(
    lengths=st.lists(st.floats(0.1, 3.0), min_size=1, max_size=8),
    x=st.floats(-50, 50),
    y=st.floats(-50, 50),
    seed=st.integers(0, 2**32 - 1),
)
def test_targets_are_reachable_and_so_is_the_nearest_point(lengths, x, y, seed):
    space = workspace(lengths)
    assert space.contains(space.draw_target(np.random.default_rng(seed), []))
    nearest = space.nearest((x, y))
    assert space.contains(nearest)
    inner, outer = reachable_radii(lengths)
    distance = math.hypot(x, y)
    expected = max(0.0, inner - distance, distance - outer)
    assert math.dist(nearest, (x, y)) == pytest.approx(expected, abs=1e-9)


TWO_LENGTHS = (1.2, 1.0)
TWO_LIMITS = ((-0.5, 1.5), (0.2, 2.0))


def within_limits(points, tolerance=1e-9):
    """Whether a two-segment arm under `TWO_LIMITS` reaches each point, by the cosine rule."""
    (first, second), (x, y) = TWO_LENGTHS, np.moveaxis(points, -1, 0)
    cosine = (x**2 + y**2 - first**2 - second**2) / (2 * first * second)
    reachable = np.zeros(cosine.shape, dtype=bool)
    for side in (1, -1):
        elbow = side * np.arccos(np.clip(cosine, -1, 1))
        shoulder = np.arctan2(y, x) - np.arctan2(
            second * np.sin(elbow), first + second * np.cos(elbow)
        )
        shoulder = np.remainder(shoulder + math.pi, math.tau) - math.pi
        good = np.abs(cosine) <= 1 + tolerance
        for angle, (low, high) in zip((shoulder, elbow), TWO_LIMITS, strict=True):
            good &= (low - tolerance <= angle) & (angle <= high + tolerance)
        reachable |= good
    return reachable


def test_joint_limits_leave_targets_uniform_over_what_the_arm_can_reach():
    """Up to the size of a cell: the shares of coarse squares are those of their areas."""
    env = MMCReachEnv(segment_lengths=TWO_LENGTHS, joint_limits=TWO_LIMITS)
    env.reset(seed=0)
    targets = np.array([env.reset()[1]["target"] for _ in range(10_000)])
    assert within_limits(targets, tolerance=1e-7).all()
    extent = sum(TWO_LENGTHS)
    anywhere = np.random.default_rng(0).uniform(-extent, extent, (1_000_000, 2))
    edges = np.linspace(-extent, extent, 7)
    share, area = (
        np.histogram2d(*points.T, bins=(edges, edges))[0] / len(points)
        for points in (targets, anywhere[within_limits(anywhere)])
    )
    assert np.abs(share - area).sum() / 2 < 0.05


@pytest.mark.parametrize("lengths", [(1.0, 1.0, 1.0), (2.0, 0.7), (1.0, 0.8, 0.6, 0.4)])
@pytest.mark.parametrize("share", [1.0, 0.7])
def test_the_evenly_bent_posture_has_the_hand_where_it_is_asked_for(lengths, share):
    distance = share * sum(lengths)
    point = (distance * math.cos(2.5), distance * math.sin(2.5))
    posture = workspace(lengths).posture_at(point)
    hand = segments_from_joint_angles(np.array(posture), lengths).sum(axis=0)
    np.testing.assert_allclose(hand, point, atol=1e-9)
    assert len(set(posture[1:])) <= 1
    assert all(0 <= angle <= math.pi for angle in posture[1:])


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.0, 1.5), (-2.0, 1.0)])
@pytest.mark.parametrize("degrees", [30.0, -90.0, 180.0])
def test_a_cursor_reaches_its_targets_by_a_hand_that_is_in_reach(centre, degrees):
    space, random = workspace((1.0, 1.0, 1.0)), np.random.default_rng(0)
    space.cursor = rotation = VisuomotorRotation(degrees, centre)
    for _ in range(300):
        target = space.draw_target(random, [])
        assert space.contains(target)
        assert math.hypot(*target) <= 3 + 1e-8
        assert math.hypot(*rotation.hand(*target)) <= 3 + 1e-8
