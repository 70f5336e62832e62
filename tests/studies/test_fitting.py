"""Trained normalizers: the same for the same seed, better than before, and as the recipe says."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from mmc_gym import UserError
from mmc_gym.network import LearnedNormalizer
from studies.network import fitting
from studies.network.fitting import ACCURATE, PAPER, train_normalizers

WIDTHS = (2, 5, 3, 2)
SHORT = replace(PAPER, samples=400, epochs=8)
SHORT_ACCURATE = replace(ACCURATE, samples=400, epochs=8, refinement_iterations=8)


def weights(normalizer):
    return np.concatenate([array.ravel() for array in (*normalizer.weights, *normalizer.biases)])


every_recipe = pytest.mark.parametrize("recipe", [SHORT, SHORT_ACCURATE], ids=["paper", "accurate"])


@every_recipe
def test_a_seed_gives_the_same_normalizers_in_any_company_and_another_seed_others(recipe):
    runs, again, others = (train_normalizers((5,), recipe, runs=2, seed=s) for s in (3, 3, 4))
    for a, b in zip(runs, again, strict=True):
        np.testing.assert_array_equal(weights(a.normalizer), weights(b.normalizer))
        np.testing.assert_array_equal(a.validation_mse, b.validation_mse)
        np.testing.assert_array_equal(a.training_mse, b.training_mse)
    assert len({weights(run.normalizer)[0] for run in (*runs, *others)}) == 4
    (alone,) = train_normalizers((5,), recipe, runs=1, seed=3)  # sums may be ordered differently
    np.testing.assert_allclose(weights(alone.normalizer), weights(runs[0].normalizer), atol=1e-4)


@every_recipe
def test_training_lowers_the_error_and_records_it(recipe):
    for run in train_normalizers((8,), recipe, runs=2):
        assert run.training_mse.shape == run.validation_mse.shape == (recipe.epochs,)
        assert run.training_mse[-1] < run.training_mse[0] / 2
        assert run.validation_mse[-1] < run.validation_mse[0] / 2
        final_mse, recorded = float(run.normalizer.card["validation_mse"]), run.validation_mse[-1]
        if recipe.refinement_iterations:
            assert final_mse < recorded
        else:
            assert final_mse == pytest.approx(recorded, rel=1e-3)
        has_biases = [bias.any() for bias in run.normalizer.biases]
        assert any(has_biases) == all(has_biases) == (recipe is SHORT)  # without, it is odd


def test_training_is_adam_on_the_error_with_a_penalty_on_the_weights():
    """Two updates by autograd: after the first, a penalty on the biases would show."""
    weight_decay = 0.05
    recipe = replace(PAPER, samples=20, epochs=2, weight_decay=weight_decay, precision="float64")
    generator = fitting._generator(0, 0)
    inputs, targets = fitting._draw_samples(recipe, generator)[:, recipe.held_out :].split(2)
    expected = fitting._initial_parameters(WIDTHS, generator).requires_grad_()
    mean, square = torch.zeros_like(expected), torch.zeros_like(expected)
    for update in (1, 2):
        output, layers = inputs, fitting._layers(expected[None], WIDTHS)
        for weights, biases in layers:
            output = torch.tanh(weights[0] @ output + biases[0])
        penalty = weight_decay * sum((weights**2).sum() for weights, _ in layers)
        loss = (output - targets).square().sum() / (2 * 16) + penalty
        (gradient,) = torch.autograd.grad(loss, expected)
        mean, square = 0.9 * mean + 0.1 * gradient, 0.999 * square + 0.001 * gradient**2
        rate = 0.001 * (1 - 0.999**update) ** 0.5 / (1 - 0.9**update)
        expected = (expected - rate * mean / (square.sqrt() + 1e-7)).detach().requires_grad_()
    trained = train_normalizers(WIDTHS[1:-1], recipe)[0].normalizer
    layers = zip(trained.weights, trained.biases)
    written = np.concatenate([part.ravel() for layer in layers for part in layer])
    np.testing.assert_allclose(written, expected.detach().numpy(), rtol=1e-9, atol=1e-12)


def test_the_command_writes_what_ships(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(fitting, "RECIPES", {"paper": SHORT})
    fitting.main(tmp_path)
    written = LearnedNormalizer.load(tmp_path / "paper-16x16.safetensors")
    assert (written.hidden_units, written.card["recipe"]) == ((16, 16), repr(SHORT))
    assert "paper-16x16.safetensors" in capsys.readouterr().out
    with pytest.raises(UserError, match="runs and hidden_units must be at least 1, got"):
        train_normalizers(hidden_units=(4, 0))
