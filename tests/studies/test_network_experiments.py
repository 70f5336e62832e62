"""The experiments on the normalization networks: their errors, and their hidden units."""

from dataclasses import replace

import numpy as np
import pytest

from mmc_gym.network import LearnedNormalizer
from mmc_gym.network.fitting import PAPER
from studies.paper import networks
from studies.paper.experiment import Settings, write_result
from studies.paper.experiments import normalization, population
from studies.paper.experiments.population import DIRECTIONS, layer_tunings, tuning
from studies.paper.networks import ARCHITECTURES, QUICK_ARCHITECTURES, RUNS, architecture_name
from studies.paper.published import NORMALIZATION_PUBLISHED

pytestmark = pytest.mark.slow


def test_the_paper_s_twelve_architectures_of_five_runs_have_published_errors():
    assert (len(ARCHITECTURES), RUNS, PAPER.epochs) == (12, 5, 400)
    assert list(NORMALIZATION_PUBLISHED) == [architecture_name(units) for units in ARCHITECTURES]
    for published in NORMALIZATION_PUBLISHED.values():
        assert published.validation[0] == pytest.approx(
            published.text or published.validation[0], rel=0.2
        )


def test_the_vector_field_leads_to_the_unit_circle():
    inputs, outputs = normalization.vector_field(LearnedNormalizer.shipped("accurate"))
    assert inputs.shape == outputs.shape == (17 * 17, 2)
    assert np.abs(inputs).max() == pytest.approx(1.6)
    lengths = np.linalg.norm(outputs, axis=1)[np.linalg.norm(inputs, axis=1) > 0.1]
    np.testing.assert_allclose(lengths, 1, atol=0.05)


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
    assert (len(found.width), found.size, found.active.max()) == (2, 3, 2)
    none = tuning(1e-6 * activations)
    assert (len(none.width), none.size, none.active.max(), none.largest_gap) == (0, 3, 0, 360)


def test_a_small_set_is_trained_compared_and_drawn(tmp_path, monkeypatch):
    recipe = replace(networks.QUICK_RECIPE, samples=800, epochs=20)
    monkeypatch.setattr(networks, "QUICK_RECIPE", recipe)
    monkeypatch.setattr(normalization, "QUICK_RECIPE", recipe)
    result = normalization.run(Settings(quick=True, folder=tmp_path))
    count = len(QUICK_ARCHITECTURES)
    assert len(result.rows) == 3 * count
    assert result.rows[2].quantity == "[16]: validation MSE"
    assert result.rows[2].paper == 0.0042
    assert result.rows[2].data == "0.00427 ± 0.00015"
    assert "quick run: 20 of 400 epochs" in result.rows[2].note
    table = result.data["mse"]
    assert len(table) == 2 * count
    assert (table["validation_mse"] < 0.3).all()  # an untrained network is near 0.5
    assert result.data["training"]["validation [16]"].shape == (2, 20)
    written = {path.name for path in write_result(result, tmp_path / "out")}
    figures = {"mse_by_architecture", "training_curves", "mse_surface", "vector_field"}
    assert written == {f"{stem}.{suffix}" for stem in figures for suffix in ("png", "svg")} | {
        "mse.csv",
        "training.npz",
        "vector_field.npz",
    }


def test_the_experiment_measures_and_draws_every_layer(tmp_path, monkeypatch):
    recipe = replace(networks.QUICK_RECIPE, samples=400, epochs=3)
    monkeypatch.setattr(networks, "QUICK_RECIPE", recipe)
    result = population.run(Settings(quick=True, folder=tmp_path))
    layers = [
        *("[4]", "[8]", "[8, 8], layer 1", "[8, 8], layer 2"),
        *("[8, 8], weight decay, layer 1", "[8, 8], weight decay, layer 2"),
    ]
    assert [row.quantity for row in result.rows[:-2:3]] == [
        f"{layer}: tuning width, mean (smallest to largest)" for layer in layers
    ]
    assert set(result.figures) == {"hidden_units", "hidden_units_3d", "tuning"}
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
