"""The normalization experiment, end to end on short trainings, and the words of its comparison."""

import numpy as np
import pytest

from mmc_gym.network import LearnedNormalizer
from mmc_gym.paper import networks as normalizers
from mmc_gym.paper.experiment import Settings, write_result
from mmc_gym.paper.experiments import normalization
from mmc_gym.paper.networks import ARCHITECTURES, QUICK_ARCHITECTURES


def test_every_architecture_has_published_errors():
    assert tuple(normalization.PUBLISHED) == ARCHITECTURES
    for published in normalization.PUBLISHED.values():
        assert published.validation[0] == pytest.approx(
            published.text or published.validation[0], rel=0.2
        )


def test_agreement_is_judged_by_the_spread_of_both():
    assert normalization.agreement((1.0, 0.1), (1.29, 0.2)) == "within the spread of both"
    assert "outside the spread of both: 1.5 ×" in normalization.agreement((1.0, 0.1), (1.45, 0.2))


def test_the_vector_field_leads_to_the_unit_circle():
    field = normalization.vector_field(LearnedNormalizer.shipped("accurate"), "[16, 16]")
    assert field.inputs.shape == field.outputs.shape == (17 * 17, 2)
    assert np.abs(field.inputs).max() == pytest.approx(1.6)
    lengths = np.linalg.norm(field.outputs, axis=1)[np.linalg.norm(field.inputs, axis=1) > 0.1]
    np.testing.assert_allclose(lengths, 1, atol=0.05)


@pytest.mark.slow
def test_a_small_set_is_trained_compared_and_drawn(tmp_path, monkeypatch):
    recipe = normalizers.replace(normalizers.QUICK_RECIPE, samples=800, epochs=20)
    monkeypatch.setattr(normalizers, "QUICK_RECIPE", recipe)
    monkeypatch.setattr(normalization, "QUICK_RECIPE", recipe)
    result = normalization.run(Settings(quick=True, folder=tmp_path), lambda done, total: None)
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
