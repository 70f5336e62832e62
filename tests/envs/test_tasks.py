"""Facts about the tasks: where trials start, their targets, and what the hand can reach."""

import math
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from mmc_gym import UserError
from mmc_gym.agents import make_agent
from mmc_gym.body import ArmParameters
from mmc_gym.envs.names import TASKS
from mmc_gym.envs.perturbations import VisuomotorRotation
from mmc_gym.envs.reach import MMCReachEnv
from mmc_gym.envs.tasks import DoubleStep, RandomTarget, Trial
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.envs.workspace import Workspace
from mmc_gym.geometry import reachable_radii, segments_from_joint_angles, wrap_angle
from mmc_gym.measures import run_episodes
from studies.paper.protocol import PAIRS, TARGETS

NO_ACTION = np.zeros(3, np.float32)


def targets_of(env, steps, **reset):
    """Where the target is at reset and after each step, (steps + 1, 2)."""
    infos = [env.reset(**reset)[1], *(env.step(NO_ACTION)[4] for _ in range(steps))]
    return np.array([info["target"] for info in infos])


def test_the_papers_task_is_its_420_movements_from_rest_and_evenly_bent():
    env = MMCReachEnv(task="paper")
    assert env.setup.task.trial_count == len(PAIRS) == 420
    observations, infos = zip(*(env.reset(options={"trial": trial}) for trial in range(420)))
    cosines, sines, speeds = np.split(np.array(observations)[:, :9], 3, axis=-1)
    assert (speeds == 0.0).all()
    bends = np.arctan2(sines, cosines)[:, 1:]  # at every joint the same, and to one side
    np.testing.assert_allclose(bends[:, 0], bends[:, 1], atol=1e-6)
    assert (bends >= -1e-6).all()
    starts = np.array([info["end_effector"] for info in infos])
    targets = np.array([info["target"] for info in infos])
    np.testing.assert_allclose(starts, TARGETS[PAIRS[:, 0]], atol=1e-9)
    np.testing.assert_allclose(targets, TARGETS[PAIRS[:, 1]], atol=1e-12)
    movements = {tuple(row) for row in np.hstack([starts, targets]).round(6).tolist()}
    assert len(movements) == 420


class Mine(RandomTarget):
    """The trials are what `drawn` returns."""

    def __init__(self, drawn):
        object.__setattr__(self, "draw", drawn)


@pytest.mark.parametrize("make", [MMCReachEnv, partial(MMCReachVectorEnv, 1)])
def test_paths_may_be_arrays_and_have_the_length_that_is_drawn_and_no_other(make):
    path = np.array([[0.0, 1.0], [0.5, 1.0]])
    env = make(task=Mine(lambda request: Trial(np.zeros(3), path)))
    env.reset(seed=0)
    *_, info = env.step(np.zeros(env.action_space.shape, np.float32))
    assert np.ravel(info["target"]).tolist() == path[1].tolist()
    assert env.setup.trials.path_length == 2
    path = np.array([[0.0, 1.0]] * 3)
    with pytest.raises(UserError, match="task must be one whose paths have 2"):
        env.reset(seed=0)


def test_centre_out_goes_in_eight_directions_45_degrees_apart_and_equally_far():
    env = MMCReachEnv(task="centre-out")
    infos = [env.reset(options={"trial": trial})[1] for trial in range(8)]
    starts = np.array([info["end_effector"] for info in infos])
    np.testing.assert_allclose(starts, [(0.0, 1.5)] * 8, atol=1e-9)
    ways = np.array([info["target"] for info in infos]) - (0.0, 1.5)
    np.testing.assert_allclose(np.linalg.norm(ways, axis=-1), 0.6)
    angles = np.arctan2(ways[:, 1], ways[:, 0]) % math.tau
    np.testing.assert_allclose(angles, np.arange(8) * math.pi / 4, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "step"),
    [
        ({"task": "double-step-100"}, 5),
        ({"task": "double-step-200"}, 10),
        ({"task": DoubleStep(delay=0.1), "substeps": 2}, 10),  # steps of 0.01 s
    ],
)
def test_the_target_jumps_once_and_at_its_time(arguments, step):
    env = MMCReachEnv(**arguments)
    for seed in range(5):
        targets = targets_of(env, 40, seed=seed)
        jumps = np.flatnonzero(np.any(np.diff(targets, axis=0), axis=-1)) + 1
        assert jumps.tolist() == [step]


def test_a_pursued_target_has_the_stated_frequencies_is_in_reach_and_another_each_time():
    env, task = MMCReachEnv(task="pursuit"), TASKS["pursuit"].task
    assert env.setup.trials.path_length == task.episode_steps == 500
    path, other = (targets_of(env, 1000, seed=seed) for seed in range(2))
    np.testing.assert_array_equal(path[:500], path[500:1000])
    assert np.linalg.norm(path, axis=-1).max() < 3.0
    assert 0 < np.linalg.norm(np.diff(path, axis=0), axis=-1).max() < 0.06  # and nowhere jumps
    assert not np.array_equal(path[0], other[0])
    np.testing.assert_allclose(path[:500].mean(axis=0), (0.0, 1.5), atol=1e-9)
    amplitudes = np.abs(np.fft.rfft(path[:500] - (0.0, 1.5), axis=0)) / 250
    for coordinate, multiples in zip(amplitudes.T, (task.multiples_x, task.multiples_y)):
        assert tuple(np.flatnonzero(coordinate > 1e-9)) == multiples
        assert coordinate.sum() == pytest.approx(0.3 * 3)
        slow, fast = multiples  # amplitudes go with the inverse of the frequency
        assert coordinate[slow] / coordinate[fast] == pytest.approx(fast / slow)


@pytest.mark.parametrize("seed", range(3))
def test_the_next_via_point_appears_at_the_last_and_only_the_end_is_a_success(seed):
    env = MMCReachEnv(task="via-points", reward_type="sparse")
    (episode,) = run_episodes(make_agent("mmc", env), gym.wrappers.TimeLimit(env, 300), [seed])
    places = list(dict.fromkeys(map(tuple, episode.targets)))
    assert len(places) == 3
    reached = np.linalg.norm(episode.hands[1:] - episode.targets[:-1], axis=-1) <= 0.05
    is_last = (episode.targets == places[-1]).all(axis=-1)
    moved_on = (episode.targets[1:] != episode.targets[:-1]).any(axis=-1)
    np.testing.assert_array_equal(moved_on, reached & ~is_last[:-1])
    succeeds = (is_last & (episode.distances <= 0.05))[1:]
    assert succeeds[-1]
    np.testing.assert_array_equal(episode.rewards, np.where(succeeds, 0.0, -1.0))


@pytest.mark.parametrize("name", TASKS)
def test_posture_and_target_can_be_set_in_every_task(name):
    env = MMCReachEnv(task=name)
    posture = [0.5, 0.6, -0.7]
    observation, _ = env.reset(seed=0, options={"joint_angles": posture})
    np.testing.assert_allclose(np.arctan2(observation[3:6], observation[:3]), posture, atol=1e-6)
    targets = targets_of(env, 30, seed=0, options={"target": (1.0, 0.5)})
    assert (targets == (1.0, 0.5)).all()


def workspace(lengths):
    return Workspace(ArmParameters(segment_lengths=tuple(lengths)))


@pytest.mark.parametrize("lengths", [(1.0, 1.0, 1.0), (3.0, 1.0, 0.5)])
def test_targets_are_uniform_over_the_area_that_the_hand_reaches(lengths):
    random = np.random.default_rng(0)
    x, y = np.array([workspace(lengths).draw_target(random, []) for _ in range(5_000)]).T
    inner, outer = reachable_radii(lengths)
    area = (x**2 + y**2 - inner**2) / (outer**2 - inner**2)
    angle = (np.arctan2(y, x) + math.pi) / math.tau
    assert min(stats.kstest(share, "uniform").pvalue for share in (area, angle)) > 0.01
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
        bend = np.arctan2(second * np.sin(elbow), first + second * np.cos(elbow))
        shoulder = wrap_angle(np.arctan2(y, x) - bend)
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
    env = MMCReachEnv(perturbations=VisuomotorRotation(degrees, centre=centre))
    rotation, random = env.cursor, np.random.default_rng(0)
    space = Workspace(ArmParameters(), cursor=rotation)
    for target in (space.draw_target(random, []) for _ in range(300)):
        assert space.contains(target)
        assert max(math.hypot(*target), math.hypot(*rotation.hand(*target))) <= 3 + 1e-8
