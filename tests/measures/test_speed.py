import math
from types import SimpleNamespace

import numpy as np
import pytest

from mmc_gym.measures.episode import hand_speed, moving_part
from mmc_gym.measures.speed import (
    MINIMUM_JERK_SPAN,
    correlation_with_minimum_jerk,
    count_peaks,
    peakedness,
    phase_of_peak,
    sparc,
)

STEP = 0.02


def of_speeds(measure, step=STEP):
    """Return a measure of episodes as a function of the speeds of a movement."""
    return lambda speeds: measure(
        SimpleNamespace(movement_speeds=np.asarray(speeds), control_step=step)
    )


smoothness = of_speeds(sparc)
SHAPES = (peakedness, phase_of_peak, correlation_with_minimum_jerk)


def bell(steps):
    """Speeds of a minimum-jerk movement in so many steps."""
    s = np.linspace(0, 1, steps + 1)
    x = 10 * s**3 - 15 * s**4 + 6 * s**5
    return hand_speed(np.stack([x, 2 * x], axis=-1), STEP)


def test_hand_speed_is_path_over_time():
    line = np.stack([1.5 * STEP * np.arange(51), np.zeros(51)], axis=-1)
    assert hand_speed(line, STEP) == pytest.approx(np.full(50, 1.5))
    angles = 2.0 * STEP * np.arange(200)
    circle = 0.7 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert hand_speed(circle, STEP) == pytest.approx(np.full(199, 1.4), rel=1e-3)


@pytest.mark.parametrize(
    ("profile", "peaks"),
    [
        (np.full(50, 1.5), 1),
        (bell(500), 1),
        *((np.tile(np.sin(np.linspace(0, math.pi, 40)), count), count) for count in (1, 2, 7)),
        ([0.2, 1.0, 0.3, 0.3 + 0.049, 0.1], 1),  # a rise by 5 % of the peak counts
        ([0.2, 1.0, 0.3, 0.3 + 0.051, 0.1], 2),
        (0.9 ** np.arange(50), 1),  # fastest in the first step
        (0.9 ** np.arange(50)[::-1], 1),
        ([*0.9 ** np.arange(50), *0.9 ** np.arange(50)[::-1]], 2),
        (np.zeros(20), 0),
        ([], 0),
    ],
)
def test_peaks_are_rises_that_stand_out(profile, peaks):
    assert count_peaks(profile) == count_peaks(1e-3 * np.asarray(profile)) == peaks


def test_minimum_jerk_is_the_reference_of_all_shapes():
    speeds = bell(501)
    assert peakedness(speeds) == pytest.approx(15 / 8, rel=1e-4)
    assert peakedness(np.full(7, 0.3)) == pytest.approx(1)
    assert math.isnan(correlation_with_minimum_jerk(np.full(7, 0.3)))
    assert phase_of_peak(speeds) == 0.5
    assert correlation_with_minimum_jerk(speeds) == pytest.approx(1)


def test_a_raised_cosine_correlates_with_minimum_jerk_as_the_integrals_say():
    # In both, time runs from 0 to 1; 30 t² (1 − t)² and 1 − cos 2πt have the means 1 and 1, the
    # variances 3/7 and 1/2, and the covariance 45/π⁴.
    time = (np.arange(2000) + 0.5) / 2000
    expected = 45 / math.pi**4 / math.sqrt(3 / 14)
    found = correlation_with_minimum_jerk(1 - np.cos(2 * math.pi * time))
    assert found == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("measure", [*SHAPES, smoothness])
def test_shape_and_smoothness_ignore_the_scale_of_speed_and_need_a_movement(measure):
    profile = np.random.default_rng(2).uniform(size=50)
    assert measure(37 * profile) == pytest.approx(measure(profile))
    assert math.isnan(measure(np.zeros(9))) and math.isnan(measure(np.array([])))
    assert moving_part(np.zeros(5)) == moving_part([]) == slice(0, 0)


@pytest.mark.parametrize("rest", [0, 1, 40])
def test_the_moving_part_of_minimum_jerk_is_its_span_whatever_rest_surrounds_it(rest):
    moving = np.pad(bell(4_000), rest)
    part = moving_part(moving)
    found = (part.start - rest) / 4_000, (part.stop - rest) / 4_000
    assert found == pytest.approx(MINIMUM_JERK_SPAN, abs=3e-4)
    speeds = moving[part]
    assert correlation_with_minimum_jerk(speeds, MINIMUM_JERK_SPAN) == pytest.approx(1, abs=1e-6)
    # The numbers in the module's docstring.
    assert peakedness(speeds) == pytest.approx(1.658, abs=5e-4)


def test_sparc_is_that_of_the_authors_own_example():
    time = np.arange(-1, 1, 0.01)
    found = of_speeds(sparc, 0.01)(np.exp(-5 * time**2))
    assert found == pytest.approx(-1.41403, abs=5e-6)


def test_smoothness_ignores_duration_and_punishes_a_second_submovement():
    assert smoothness(bell(120)) == pytest.approx(smoothness(bell(60)), abs=0.02)
    assert smoothness(np.concatenate([bell(60), 0.5 * bell(60)])) < smoothness(bell(60)) - 0.1
