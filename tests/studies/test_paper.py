"""Each experiment of the paper runs, and gives the published figures where nothing is learned."""

import doctest
import re
from dataclasses import replace

import numpy as np
import pytest

from mmc_gym.network import LearnedNormalizer
from studies.network.fitting import PAPER
from studies.paper import experiment, networks, protocol
from studies.paper.experiment import ExperimentSettings
from studies.paper.experiments import bettered, forward_and_mixed, movements, normalization
from studies.paper.experiments import population as hidden_units
from studies.paper.experiments.population import layer_tunings
from studies.paper.networks import architecture_name
from studies.paper.published import POINTS
from studies.paper.run import EXPERIMENTS, reproduce

pytestmark = pytest.mark.slow

ACCURATE = LearnedNormalizer.shipped("accurate")
SHIPPED = (LearnedNormalizer.shipped("paper"), ACCURATE)


def stand_in(settings, architectures=((16,), (16, 16))):
    """Instead of training: the two shipped 2-16-16-2 networks for every architecture."""
    none = np.zeros((2, 0))
    architecture = networks.TrainedArchitecture(SHIPPED, none, none, np.zeros(2), np.zeros(2))
    return {architecture_name(units): architecture for units in architectures}


class Results(dict):
    """Results of the experiments on movements by name, run when they are first used."""

    def __missing__(self, name):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(protocol, "trained_architectures", stand_in)
            patch.setattr(movements, "trained_architectures", stand_in)
            quick = name in ("accurate", "bell-shaped", "forward-and-mixed")
            self[name] = EXPERIMENTS[name].run(ExperimentSettings(quick))
        return self[name]


@pytest.fixture(scope="module")
def results():
    return Results()


def test_a_quick_run_writes_figures_data_and_a_table(tmp_path, capsys, monkeypatch):
    for module in (networks, normalization):
        monkeypatch.setattr(module, "QUICK_RECIPE", replace(PAPER, samples=400, epochs=6))
    names = ["normalization", "population"]
    assert list(reproduce(names, tmp_path, quick=True, jobs=1)) == names
    assert "[16]: validation MSE" in capsys.readouterr().out
    table = (tmp_path / "table.md").read_text("utf-8")
    assert "This is a quick run" in table
    assert "| [16]: validation MSE | 0.0042 | 0.00427 ± 0.00015 |" in table
    assert all(f"| {number} | {point.subject} |" in table for number, point in POINTS.items())
    assert "](population/tuning.png)" in table
    for file in ("population/tuning.png", "population/tuning.svg", "normalization/mse.csv"):
        assert (tmp_path / file).stat().st_size > 0
    # One more than the architectures: the population's [8, 8] with weight decay.
    trained = len(networks.QUICK_ARCHITECTURES) + 1
    assert len(list((tmp_path / "networks").iterdir())) == trained


@pytest.mark.parametrize("name", [*EXPERIMENTS][2:])  # those that train no networks
def test_an_experiment_has_rows_captioned_figures_and_data(name, results):
    result = results[name]
    assert result.rows and result.figures and result.data
    assert all(figure.caption for figure in result.figures.values())


def test_the_examples_in_docstrings_hold():
    modules = (experiment, protocol, bettered, forward_and_mixed, movements, normalization)
    flags = doctest.NORMALIZE_WHITESPACE
    tried = [doctest.testmod(module, optionflags=flags) for module in (*modules, hidden_units)]
    assert sum(result.attempted for result in tried) > 10
    assert not any(result.failed for result in tried)


def numbers(value):
    """Return the numbers in a value of the table."""
    return [float(text) for text in re.findall(r"\d+(?:\.\d+)?", str(value))]


@pytest.mark.parametrize(
    ("start", "number", "digits"), [("Euclidean", 13, 5e-5), ("classical (Euclidean): ", 6, 5e-4)]
)
def test_rows_without_learned_weights_agree_with_the_data(start, number, digits, results):
    rows = [row for name in ("kinematic", "dynamic") for row in results[name].rows]
    rows = [row for row in rows if row.quantity.startswith(start) and row.data is not None]
    for row in rows:
        assert numbers(row.ours) == pytest.approx(numbers(row.data), abs=digits)
    assert len(rows) >= number
    ours = {row.quantity: row.ours for row in results["example"].rows}
    assert next(ours[name] for name in ours if name.startswith("kinematic (Euclid")) == "0.00977"


def test_the_points_on_movements_are_all_measured(results):
    points_of_experiments = [results[name].points for name in ("kinematic", "dynamic", "example")]
    assert {number for points in points_of_experiments for number in points} == {1, 2, 3, 4, 5, 6}
    points = results["dynamic"].points
    assert "not within 40 iterations" in points[1]
    assert points[2].endswith("26 with Euclidean normalization")
    # 3.4 and 0 for the classical network, 2.6 and 0.15 for the dynamic one.
    assert "classical 3.37, 0.00 (" in points[5]
    assert "dynamic (Euclidean) 2.61, 0.15 (" in points[5]


@pytest.mark.parametrize("bias", [-1.0, 0.7])
@pytest.mark.parametrize("strength", [0.5, 3.0])
def test_a_first_layer_unit_prefers_the_direction_of_its_weights(strength, bias):
    # h(φ) = tanh(s cos(φ − φ_w) + b) is above half where cos(φ − φ_w) > (artanh(half) − b)/s.
    preferred = np.radians([10.0, 75.5, 300.0])
    weights = strength * np.stack([np.cos(preferred), np.sin(preferred)], axis=1)
    network = LearnedNormalizer([weights, np.ones((2, 3))], [[bias] * 3, [0, 0]])
    (tuning,) = layer_tunings(network)
    np.testing.assert_allclose(np.exp(1j * tuning.preferred), np.exp(1j * preferred), atol=1e-9)
    half = (np.tanh(bias + strength) + np.tanh(bias - strength)) / 2
    width = 2 * np.degrees(np.arccos((np.arctanh(half) - bias) / strength))
    np.testing.assert_allclose(tuning.width, width, atol=1.0)
