"""The experiments on movements say, draw and keep what they measured, whatever was trained."""

import numpy as np
import pytest

from mmc_gym.network import EuclideanNormalizer, LearnedNormalizer, MMCNetwork
from mmc_gym.network.model import linear_operator
from studies.paper import protocol
from studies.paper.experiment import Settings, write_result
from studies.paper.experiments import movements
from studies.paper.experiments.bettered import (
    LENGTHS,
    measure,
    minimum_jerk_movements,
    record_timed_movements,
)
from studies.paper.experiments.forward_and_mixed import (
    NETWORKS,
    TASKS,
    errors,
    factor,
    random_tasks,
)
from studies.paper.networks import TrainedArchitecture, architecture_name
from studies.paper.protocol import OVERSHOOT, PAIRS, TARGETS
from studies.paper.run import EXPERIMENTS

pytestmark = pytest.mark.slow

ACCURATE = LearnedNormalizer.shipped("accurate")
RUNS = (LearnedNormalizer.shipped("paper"), ACCURATE)
NORMALIZERS = {"Euclidean": EuclideanNormalizer(), "accurate": ACCURATE}
FORWARD = next(iter(TASKS))


def trained(settings, architectures=((16,), (16, 16))):
    """Instead of training: two 2-16-16-2 networks for every architecture."""
    none = np.zeros((2, 0))
    return {
        architecture_name(units): TrainedArchitecture(RUNS, none, none, np.zeros(2), np.zeros(2))
        for units in architectures
    }


class Results(dict):
    """Results of the experiments by name, run when they are first asked for."""

    def __missing__(self, name):
        calls = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(protocol, "trained_architectures", trained)
            patch.setattr(movements, "trained_architectures", trained)
            quick = name in ("accurate", "bell-shaped", "forward-and-mixed")
            settings = Settings(quick, on_progress=lambda *report: calls.append(report))
            self[name] = EXPERIMENTS[name].run(settings)
        if name != "example":  # trains, and does nothing else that takes long
            assert calls == [(done, len(calls) - 1) for done in range(len(calls))] != []
        return self[name]


@pytest.fixture(scope="module")
def results():
    return Results()


def row(result, quantity):
    return next(row for row in result.rows if row.quantity.startswith(quantity))


@pytest.mark.parametrize(
    ("name", "rows", "figures"),
    [
        ("kinematic", 20, 2),
        ("dynamic", 41, 1),
        ("example", 6, 2),
        ("accurate", 12, 1),
        ("bell-shaped", 71, 3),
        ("forward-and-mixed", 30, 1),
    ],
)
def test_an_experiment_has_rows_captioned_figures_and_data(name, rows, figures, results, tmp_path):
    result = results[name]
    assert len(result.rows) == rows
    assert len(result.figures) == figures
    assert all(figure.caption for figure in result.figures.values())
    assert len(write_result(result, tmp_path)) == 2 * figures + len(result.data)


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
    for found in results["dynamic"].rows:
        if found.quantity.startswith("classical") and not found.quantity.endswith("at iteration"):
            assert float(found.ours) == pytest.approx(found.data, abs=5e-4)
    assert row(results["dynamic"], "classical (Euclidean): peak").ours == "0.1082 at 2"
    assert row(results["example"], "kinematic (Euclidean)").ours == "0.00977"
    deviation = row(results["dynamic"], "classical (Euclidean): standard deviation")
    assert float(deviation.ours) == pytest.approx(deviation.data, abs=5e-5)


def test_running_longer_brings_the_classical_network_nearer(results):
    assert (np.diff(results["kinematic"].data["longer"]["Euclidean"]) < 0).all()


def test_the_shape_of_single_movements_is_that_of_the_data(results):
    # 3.4 and 0 for the classical network, 2.6 and 0.15 for the dynamic one.
    point = results["dynamic"].points[5]
    assert "classical 3.37, 0.00 (" in point
    assert "dynamic (Euclidean) 2.61, 0.15 (" in point


def test_the_example_s_second_peak_is_given_for_each_network(results):
    found = results["example"].rows[-1]
    assert found.quantity.startswith("dynamic [16, 16], rule “reference”, decay 1: second velocity")
    assert found.data == "0.0139 at 28"
    assert len(found.ours.split(", ")) == len(RUNS)
    for peak in found.ours.split(", "):
        height, iteration = peak.split(" at ")
        assert float(height) == pytest.approx(0.0139, rel=0.5)
        assert abs(int(iteration) - 28) <= 3


def test_runs_of_a_normalizer_are_given_with_their_range(results):
    result = results["kinematic"]
    assert " to " in row(result, "[16, 16]: distance").ours
    table = result.data["kinematic_networks"]
    assert len(table) == 2 * (1 + 1 + 2 + 2)
    assert set(table["schedule"]) == {"delayed", "synchronous"}
    # Run by run, as all runs together.
    runs = table.query("schedule == 'delayed' and normalizer == '[16, 16]'")
    together = result.data["final_distances"]["[16, 16]"].mean(axis=1)
    np.testing.assert_allclose(runs["final"], together)
    assert len(results["dynamic"].data["dynamic_networks"]) == 9 * (1 + 1 + 2 + 2)


def test_the_points_on_movements_are_all_measured(results):
    found = [results[name].points for name in ("kinematic", "dynamic", "example")]
    assert {number for points in found for number in points} == {1, 2, 3, 4, 5, 6}
    assert "not within 40 iterations" in results["dynamic"].points[1]
    assert results["dynamic"].points[2].endswith("26 with Euclidean normalization")


def test_the_exact_normalizer_has_no_errors():
    exact = measure(NORMALIZERS["Euclidean"], directions=36)
    assert exact.near_error < 1e-12
    assert exact.worst_error.max() < 1e-12
    np.testing.assert_allclose(exact.output_length, 1)
    final = exact.distance[:, -1]
    assert final.mean() == pytest.approx(0.02264, abs=1e-5)
    assert final.std() == pytest.approx(0.03198, abs=1e-5)


def test_the_accurate_normalizer_is_as_good_as_was_sought(results):
    result = results["accurate"]
    assert row(result, "accurate: mean angle error at lengths 0.9 to 1.1").ours <= 0.01
    assert row(result, "accurate: the same, as a multiple of the Euclidean").ours <= 1.02
    far = row(result, "accurate: movements that end above 0.1")
    assert far.ours <= 7
    assert far.note == "of 420; Euclidean 7"
    assert row(result, "paper's recipe: the same, as a multiple of the Euclidean").data == 2.03
    assert result.data["distance"]["accurate"].shape == (420, 100)
    assert len(result.data["angle_errors"]) == len(LENGTHS)


def test_no_length_up_to_three_is_turned_the_wrong_way(results):
    assert (LENGTHS.min(), LENGTHS.max()) == (1e-6, 3)
    assert row(results["accurate"], "accurate: worst angle error").ours < 5
    lengths = row(results["accurate"], "accurate: lengths of the outputs").ours
    shortest, longest = lengths.split(" to ")
    assert 0.99 < float(shortest) < 1 < float(longest) < 1.01


@pytest.fixture(scope="module")
def shapes(results):
    frame = results["bell-shaped"].data["bell_shape"].set_index(["name", "iterations"]).sort_index()
    return lambda name, iterations: frame.loc[name, iterations]


@pytest.mark.parametrize("iterations", [40, 100])
@pytest.mark.parametrize("name", ["time base (Euclidean)", "time base (accurate [16, 16])"])
def test_each_movement_is_bell_shaped_and_ends_as_near(name, iterations, shapes):
    found = shapes(name, iterations)
    assert found["correlation"].median() >= 0.98
    assert 1.8 <= found["peak_to_mean"].median() <= 2.0
    assert 0.45 <= found["time_to_peak"].median() <= 0.55
    assert (found["velocity_peaks"] == 1).mean() >= 0.95
    assert (found["overshoot"] > OVERSHOOT).sum() == 0
    for classical in ("kinematic (Euclidean)", "kinematic (Euclidean), synchronous"):
        assert found["final"].mean() <= shapes(classical, iterations)["final"].mean()


@pytest.mark.parametrize(
    "name", ["dynamic (Euclidean), decay 0.92", "kinematic (Euclidean), synchronous"]
)
def test_the_paper_s_networks_are_bell_shaped_on_average_only(name, shapes):
    found = shapes(name, 40)
    assert found["correlation"].median() < 0.1
    assert found["peak_to_mean"].median() > 2.5
    assert found["peak_to_mean"].min() >= 1
    assert found["time_to_peak"].median() < 0.2


@pytest.mark.parametrize("iterations", [40, 100])
def test_minimum_jerk_passes_every_measure(iterations, shapes):
    found, recording = shapes("minimum jerk", iterations), minimum_jerk_movements(iterations)
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


def test_the_shapes_of_all_movements_are_kept(results):
    frame = results["bell-shaped"].data["bell_shape"]
    assert frame.groupby(["name", "iterations"]).size().eq(420).all()
    assert frame["name"].nunique() * 7 + 1 == len(results["bell-shaped"].rows)


def errors_of(network, task, arms=100, iterations=300):
    state, vectors = random_tasks(network, arms, seed=1)
    clamps = network.clamp({pair: vectors[pair] for pair in TASKS[task]})
    return errors(network, state, clamps, iterations)


@pytest.mark.parametrize("damping", [4.0, 10.0, 30.0])
def test_the_forward_task_has_the_eigenvalues_of_its_equation(damping):
    operator = linear_operator(MMCNetwork(damping=damping), (0, 1, 2))[3:, 3:]
    expected = 1 - np.array([2 + np.sqrt(2), 2, 2 - np.sqrt(2)]) / damping
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(operator).real), expected, atol=1e-12)
    assert factor(damping) == pytest.approx(expected[-1])


@pytest.mark.parametrize("name", NETWORKS)
def test_the_forward_error_shrinks_by_the_factor(name):
    course = errors_of(NETWORKS[name], FORWARD).mean(axis=1)
    np.testing.assert_allclose(course[60:200] / course[59:199], factor(10), rtol=1e-4)
    assert course[-1] < 1e-6


def test_a_forward_task_is_the_same_with_every_normalizer():
    learned = MMCNetwork(normalizer=RUNS[0])
    np.testing.assert_array_equal(errors_of(learned, FORWARD), errors_of(MMCNetwork(), FORWARD))


@pytest.mark.parametrize("name", NORMALIZERS)
@pytest.mark.parametrize("task", [task for task in TASKS if task != FORWARD])
def test_mixed_and_inverse_tasks_are_solved(task, name):
    course = errors_of(MMCNetwork(normalizer=NORMALIZERS[name]), task, iterations=500)
    assert np.median(course[-1]) < 0.01
    assert course[-1].mean() < 0.03 * course[0].mean()


@pytest.mark.parametrize("task", TASKS)
def test_what_is_clamped_is_held(task):
    network = MMCNetwork(dynamics="paper", schedule="delayed")
    state, vectors = random_tasks(network, 5, seed=0)
    clamps = network.clamp({pair: vectors[pair] for pair in TASKS[task]})
    state = network.run(state, clamps, iterations=7)
    rows = [{(0, 1): 0, (1, 2): 1, (2, 3): 2, (0, 2): 3, (0, 3): 5}[pair] for pair in TASKS[task]]
    for row, pair in zip(rows, TASKS[task], strict=True):
        np.testing.assert_allclose(state.vectors[:, row], vectors[pair], atol=1e-12)
    lengths = np.linalg.norm(state.segments, axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-12)


def test_every_task_is_given_to_every_network(results):
    result = results["forward-and-mixed"]
    assert result.data["forward_and_mixed"].shape == (500, 1 + len(NETWORKS) * 3 * len(TASKS))
    assert any("0.94142" in str(found.ours) for found in result.rows)
