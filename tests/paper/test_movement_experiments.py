"""The experiments on movements say, draw and keep what they measured, whatever was trained."""

import numpy as np
import pytest

from mmc_gym.network import LearnedNormalizer
from mmc_gym.paper import protocol as summaries
from mmc_gym.paper.experiment import Settings, write_result
from mmc_gym.paper.experiments import dynamic, example, kinematic
from mmc_gym.paper.networks import TrainedArchitecture

NONE = np.zeros((2, 0))
RUNS = tuple(LearnedNormalizer.shipped(name) for name in ("paper", "accurate"))


def trained(settings, progress, architectures=((16,), (16, 16))):
    """Instead of training: two 2-16-16-2 networks for every architecture."""
    return {
        units: TrainedArchitecture(units, RUNS, NONE, NONE, np.zeros(2), np.zeros(2))
        for units in architectures
    }


@pytest.fixture(scope="module")
def results():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(summaries, "trained_architectures", trained)
        patch.setattr(example, "trained_architectures", trained)
        return {
            module.EXPERIMENT.name: module.EXPERIMENT.run(Settings(), lambda done, total: None)
            for module in (kinematic, dynamic, example)
        }


def ours(result, quantity):
    return next(row.ours for row in result.rows if row.quantity.startswith(quantity))


def test_every_figure_has_a_caption_and_every_result_its_data(results, tmp_path):
    for name, result in results.items():
        assert set(result.captions) == set(result.figures)
        written = write_result(result, tmp_path / name)
        assert len(written) == 2 * len(result.figures) + len(result.data)


def test_rows_without_learned_weights_agree_with_the_data_to_the_digit(results):
    rows = [
        row
        for name in ("kinematic", "dynamic")
        for row in results[name].rows
        if row.quantity.startswith("Euclidean") and row.data is not None
    ]
    assert len(rows) == 13
    for row in rows:
        if row.quantity.endswith("500 iterations"):
            assert row.ours == pytest.approx(row.data, abs=5e-5)
        else:
            assert str(row.ours) == str(row.data)


def test_the_classical_rows_agree_with_the_data(results):
    for row in results["dynamic"].rows:
        if row.quantity.startswith("classical") and not row.quantity.endswith("at iteration"):
            assert float(row.ours) == pytest.approx(row.data, abs=5e-4)
    assert ours(results["dynamic"], "classical (Euclidean): peak") == "0.1082 at 2"
    assert ours(results["example"], "kinematic (Euclidean)") == "0.00977"


def test_the_shape_of_single_movements_is_that_of_the_data(results):
    # 3.4 and 0 for the classical network, 2.6 and 0.15 for the dynamic one.
    point = results["dynamic"].points[5]
    assert "classical 3.37, 0.00 (" in point
    assert "dynamic (Euclidean) 2.61, 0.15 (" in point


def test_the_example_s_second_peak_is_given_for_each_network(results):
    (found,) = (row for row in results["example"].rows if "second velocity peak" in row.quantity)
    assert found.quantity.startswith("dynamic [16, 16], rule “reference”, decay 1")
    assert found.data == "0.0139 at 28"
    assert len(found.ours.split(", ")) == len(RUNS)
    for peak in found.ours.split(", "):
        height, iteration = peak.split(" at ")
        assert float(height) == pytest.approx(0.0139, rel=0.5)
        assert abs(int(iteration) - 28) <= 3


def test_runs_of_a_normalizer_are_given_with_their_range(results):
    assert " to " in ours(results["kinematic"], "[16, 16]: distance")
    table = results["kinematic"].data["kinematic_networks"]
    assert len(table) == 2 * (1 + 1 + 2 + 2)
    assert set(table["schedule"]) == {"delayed", "synchronous"}
    table = results["dynamic"].data["dynamic_networks"]
    assert len(table) == 9 * (1 + 1 + 2 + 2)


def test_the_points_on_movements_are_all_measured(results):
    points = {number for result in results.values() for number in result.points}
    assert points == {1, 2, 3, 4, 5, 6}
    assert "not within 40 iterations" in results["dynamic"].points[1]
    assert results["dynamic"].points[2].endswith("26 with Euclidean normalization")
