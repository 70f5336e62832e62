"""Tuning of units whose tuning is known, and of the paper's networks."""

import numpy as np
import pytest

from mmc_gym.network import LearnedNormalizer
from mmc_gym.paper import networks as normalizers
from mmc_gym.paper.experiment import Settings
from mmc_gym.paper.experiments.population import DIRECTIONS, layer_tunings, run, tuning


@pytest.mark.parametrize("bias", [-1.0, 0.0, 0.7])
@pytest.mark.parametrize("strength", [0.5, 3.0])
def test_a_first_layer_unit_prefers_the_direction_of_its_weights(strength, bias):
    # h(φ) = tanh(s cos(φ − φ_w) + b) is above half where cos(φ − φ_w) > (artanh(half) − b)/s.
    preferred = np.radians([10.0, 75.5, 300.0])
    weights = strength * np.stack([np.cos(preferred), np.sin(preferred)], axis=1)
    network = LearnedNormalizer([weights, np.ones((2, 3))], [[bias] * 3, [0, 0]])
    (found,) = layer_tunings(network)
    np.testing.assert_allclose(np.exp(1j * found.preferred), np.exp(1j * preferred), atol=1e-9)
    half = (np.tanh(bias + strength) + np.tanh(bias - strength)) / 2
    width = 2 * np.degrees(np.arccos((np.arctanh(half) - bias) / strength))
    np.testing.assert_allclose(found.width, width, atol=1.0)


def test_evenly_spread_units_cover_the_circle_evenly():
    preferred = np.arange(8) * (np.pi / 4)
    found = tuning(np.exp(4 * np.cos(DIRECTIONS[:, None] - preferred)))
    assert found.largest_gap == pytest.approx(45)
    assert set(found.active) <= {1, 2, 3}
    np.testing.assert_allclose(found.width, found.width[0])


def test_the_order_of_units_does_not_matter():
    activations = np.tanh(2 * np.cos(DIRECTIONS[:, None] - np.array([3.0, 1.0, 5.0])))
    one, other = tuning(activations), tuning(activations[:, ::-1])
    np.testing.assert_allclose(one.preferred, [1, 3, 5])
    np.testing.assert_array_equal(one.activations, other.activations)


def test_silent_units_are_counted_and_left_out():
    activations = np.cos(DIRECTIONS[:, None] - np.array([3.0, 1.0, 5.0])) * [1.0, 1e-6, 0.5]
    found = tuning(activations)
    np.testing.assert_allclose(found.preferred, [3, 5])
    assert (found.silent, found.size, found.active.max()) == (1, 3, 2)


@pytest.mark.slow
def test_the_experiment_measures_and_draws_every_layer(tmp_path, monkeypatch):
    recipe = normalizers.replace(normalizers.QUICK_RECIPE, samples=400, epochs=3)
    monkeypatch.setattr(normalizers, "QUICK_RECIPE", recipe)
    result = run(Settings(quick=True, folder=tmp_path), lambda done, total: None)
    layers = [
        *("[4]", "[8]", "[8, 8], layer 1", "[8, 8], layer 2"),
        *("[8, 8], weight decay, layer 1", "[8, 8], weight decay, layer 2"),
    ]
    assert [row.quantity for row in result.rows[:-2:3]] == [
        f"{layer}: tuning width, mean (smallest to largest)" for layer in layers
    ]
    assert set(result.figures) == {"hidden_units", "hidden_units_3d", "tuning"}
    assert set(result.captions) == set(result.figures)
    assert set(result.data["hidden_units"]) == {"directions", *layers}
    # Two runs each; units numbered from 1.
    table = result.data["tuning"]
    assert len(table) == 2 * (4 + 5 * 8)
    sizes = dict(zip(layers, (4, *5 * [8]), strict=True))
    assert table.groupby("units")["unit"].max().to_dict() == sizes
    # The networks with weight decay are networks of their own.
    plain, decayed = (result.data["hidden_units"][name] for name in (layers[3], layers[5]))
    assert not np.allclose(plain, decayed)
    assert len(list((tmp_path / "networks").glob("8x8-*.npz"))) == 2
