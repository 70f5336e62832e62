"""On a time base each of the 420 movements is bell-shaped, and none is worse for it on average."""

import numpy as np
import pytest

from mmc_gym.network import LearnedNormalizer, MMCNetwork
from mmc_gym.paper.experiment import Settings
from mmc_gym.paper.experiments.bell_shaped import minimum_jerk_movements, record_timed_movements
from mmc_gym.paper.protocol import OVERSHOOT, PAIRS, TARGETS, record_movements, shapes

NETWORKS = {
    "Euclidean": MMCNetwork(),
    "accurate": MMCNetwork(normalizer=LearnedNormalizer.shipped("accurate")),
}


@pytest.mark.parametrize("iterations", [40, 100])
@pytest.mark.parametrize("name", NETWORKS)
def test_each_movement_is_bell_shaped_and_ends_as_near(name, iterations):
    found = shapes(record_timed_movements(NETWORKS[name], iterations))
    assert np.median(found["correlation"]) >= 0.98
    assert 1.8 <= np.median(found["peak_to_mean"]) <= 2.0
    assert 0.45 <= np.median(found["time_to_peak"]) <= 0.55
    assert (found["velocity_peaks"] == 1).mean() >= 0.95
    assert (found["overshoot"] > OVERSHOOT).sum() == 0
    for schedule in ("synchronous", "delayed"):
        classical = record_movements(MMCNetwork(schedule=schedule), iterations, iterations)
        assert found["final"].mean() <= classical.distance[:, -1].mean()


def test_the_paper_s_networks_are_bell_shaped_on_average_only():
    for network in (MMCNetwork(schedule="delayed", dynamics="reference"), MMCNetwork()):
        found = shapes(record_movements(network, 40, 40))
        assert np.median(found["correlation"]) < 0.1
        assert np.median(found["peak_to_mean"]) > 2.5
        assert np.median(found["time_to_peak"]) < 0.2


@pytest.mark.parametrize("iterations", [40, 100])
def test_minimum_jerk_passes_every_measure(iterations):
    recording = minimum_jerk_movements(iterations)
    found = shapes(recording)
    np.testing.assert_allclose(found["correlation"], 1)
    np.testing.assert_allclose(found["peak_to_mean"], 15 / 8, rtol=2e-3)
    np.testing.assert_allclose(found["time_to_peak"], 0.5, atol=0.51 / iterations)
    assert (found["velocity_peaks"] == 1).all()
    np.testing.assert_allclose(found["overshoot"], 0, atol=1e-12)
    np.testing.assert_allclose(recording.distance[:, -1], 0, atol=1e-12)
    np.testing.assert_allclose(recording.velocity.sum(axis=-1), 1)


def test_a_timed_movement_starts_where_its_warm_movement_ends():
    recording = record_timed_movements(MMCNetwork(), 40)
    np.testing.assert_allclose(recording.start, TARGETS[PAIRS[:, 0]])
    starts = recording.start_segments.sum(axis=-2)
    assert np.linalg.norm(starts - recording.start, axis=-1).mean() < 0.1
    assert recording.segments.shape == (420, 40, 3, 2)


@pytest.fixture(scope="module")
def result():
    from mmc_gym.paper.experiments.bell_shaped import EXPERIMENT

    calls = []
    found = EXPERIMENT.run(Settings(quick=True), lambda done, total: calls.append((done, total)))
    assert calls[-1][0] == calls[-1][1]
    return found


def test_the_experiment_measures_all_and_draws_them(result):
    assert set(result.figures) == set(result.captions)
    frame = result.data["bell_shape"]
    assert frame.groupby(["name", "iterations"]).size().eq(420).all()
    assert frame["name"].nunique() * 7 + 1 == len(result.rows)
