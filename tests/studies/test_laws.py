import math

import numpy as np
import pytest

from mmc_gym.benchmark.suite import SCENARIOS
from studies import laws

STEP = 0.02


def take(names, episodes):
    return [laws.LAWS[name].of(episodes) for name in names]


def test_the_scenarios_of_the_laws_exist_and_have_the_trials_that_they_need():
    assert {law.scenario for law in laws.LAWS.values()} <= set(SCENARIOS)
    assert [len(SCENARIOS[name].instances(1)) for name in ("paper", "distances")] == [420, 32]
    env = SCENARIOS["distances"].make()
    infos = [env.reset(options={"trial": trial})[1] for trial in range(32)]
    assert len({tuple(info["end_effector"].round(6)) for info in infos}) == 1
    distances = np.unique([round(info["distance"], 6) for info in infos])
    assert distances == pytest.approx([0.3, 0.6, 0.9, 1.2])


TURNS = math.tau * np.random.default_rng(0).integers(-3, 4, size=(20, 3))


@pytest.mark.parametrize(
    ("postures", "spread"),
    [
        (np.array([0.3, -2.0, 3.1]) + TURNS, 0),  # equal, however often they are wound
        ([[0.0], [math.pi]], math.sqrt(2)),
        (np.linspace(0, math.tau, 7)[:-1, None], math.sqrt(2)),
        (np.zeros((0, 3)), math.nan),
        ([[0.0, 1.0]], math.nan),
        (np.full((3, 2), math.nan), math.nan),
    ],
)
def test_postures_spread_from_none_to_the_root_of_two(postures, spread):
    assert laws.posture_spread(postures) == pytest.approx(spread, abs=1e-7, nan_ok=True)


def test_posture_variability_is_that_at_each_target_and_of_hands_that_are_there(make_episode):
    def ending(posture, target, hand=None):
        hands = np.tile(target if hand is None else hand, (5, 1))
        return make_episode(hands, target, joint_angles=np.full((5, 1), posture))

    here, there = [1.0, 0.0], [0.0, 2.0]
    met = [ending(0.0, here), ending(math.pi / 2, here), *[ending(1.0, there)] * 2]
    missed, alone = ending(3.0, there, hand=[0.0, 1.0]), ending(3.0, [5.0, 5.0])
    variability = laws.posture_variability([*met, missed, alone])
    assert variability == pytest.approx(math.sqrt(2 * (1 - math.sqrt(0.5))) / 2)
    assert math.isnan(laws.posture_variability([alone]))


FITTS = ("fitts_slope", "fitts_r_squared")


def test_fitts_law_of_a_hand_that_halves_its_distance_again_and_again(make_episode):
    # d = D 2^{−t/τ} is within W/2 after τ log2(2 D / W): a slope of τ, and no intercept.
    halving, step = 0.07, 0.001
    way = 1 - 2 ** (-np.arange(3000) * step / halving)
    episodes = [
        make_episode(distance * np.outer(way, [1.0, 0.0]), [distance, 0.0], step)
        for distance in (0.3, 0.6, 0.9, 1.2)
    ]
    slope, r_squared = take(FITTS, episodes)
    assert slope == pytest.approx(halving, rel=0.01)
    assert laws.fitts_line(episodes).intercept == pytest.approx(0, abs=2 * step)
    assert r_squared == pytest.approx(1, abs=1e-4)
    still = make_episode(np.zeros((50, 2)), [0.3, 0.0])  # a distance where some hand never settles
    assert take(FITTS, [*episodes, still]) == pytest.approx(take(FITTS, episodes[1:]))
    assert np.isnan(take(FITTS, [still])).all() and np.isnan(take(FITTS, [])).all()


def ellipse(phase, axes=(1.0, 0.4)):
    return np.stack([axes[0] * np.cos(phase), axes[1] * np.sin(phase)], axis=-1)


@pytest.mark.parametrize("axes", [(1.0, 0.4), (0.7, 0.2)])
def test_a_harmonic_ellipse_follows_the_two_thirds_power_law(axes):
    # κ = a b ω³ / v³, and so v = ω (a b)^{1/3} κ^{−1/3}.
    turn, omega = np.array([[0.8, -0.6], [0.6, 0.8]]), 1.5
    law = laws.speed_curvature_law(ellipse(omega * STEP * np.arange(400), axes) @ turn.T, STEP)
    expected = math.log(omega * np.prod(axes) ** (1 / 3)), -1 / 3, 1
    assert law == pytest.approx(expected, abs=1e-3)


def test_an_ellipse_at_constant_speed_has_the_exponent_zero_and_straight_paths_have_none():
    phase = np.linspace(0, math.tau, 20_001)
    lengths = np.linalg.norm(np.diff(ellipse(phase), axis=0), axis=-1)
    way = np.concatenate([[0], np.cumsum(lengths)])
    even = np.interp(np.linspace(0, way[-1], 400), way, phase)
    assert laws.speed_curvature_law(ellipse(even), STEP).slope == pytest.approx(0, abs=5e-3)
    line = np.linspace(0, 1, 50)[:, None] ** 2 * [1.0, 2.0]
    trembling = 1e-4 * np.random.default_rng(0).standard_normal((50, 2)) * STEP
    for hands in (line, trembling, np.zeros((50, 2)), np.zeros((2, 2)), np.zeros((0, 2))):
        assert math.isnan(laws.speed_curvature_law(hands, STEP).slope)


def test_the_power_law_is_that_of_the_path_after_the_warm_up(make_episode):
    hands = ellipse(1.5 * STEP * np.arange(500))
    hands[:50] = np.random.default_rng(0).normal(size=(50, 2))
    episode = make_episode(hands, hands)
    power = ("speed_curvature_exponent", "speed_curvature_r_squared")
    assert take(power, [episode, episode]) == pytest.approx([1 / 3, 1], abs=1e-3)
    still = make_episode(np.zeros((500, 2)), [1.0, 0.0])
    assert np.isnan(take(power, [])).all() and np.isnan(take(power, [still])).all()
