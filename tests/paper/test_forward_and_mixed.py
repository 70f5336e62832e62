"""One network solves forward, inverse and mixed tasks, by what is clamped."""

import numpy as np
import pytest

from mmc_gym.network import LearnedNormalizer, MMCNetwork
from mmc_gym.network.model import linear_operator
from mmc_gym.paper.experiment import Settings
from mmc_gym.paper.experiments.forward_and_mixed import (
    EXPERIMENT,
    NETWORKS,
    TASKS,
    errors,
    factor,
    random_tasks,
)

FORWARD = next(iter(TASKS))


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
    learned = MMCNetwork(normalizer=LearnedNormalizer.shipped("paper"))
    np.testing.assert_array_equal(errors_of(learned, FORWARD), errors_of(MMCNetwork(), FORWARD))


@pytest.mark.parametrize("normalizer", ["Euclidean", "accurate"])
@pytest.mark.parametrize("task", [task for task in TASKS if task != FORWARD])
def test_mixed_and_inverse_tasks_are_solved(task, normalizer):
    network = MMCNetwork()
    if normalizer == "accurate":
        network = MMCNetwork(normalizer=LearnedNormalizer.shipped("accurate"))
    course = errors_of(network, task, iterations=500)
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


def test_the_experiment_gives_every_task_to_every_network():
    result = EXPERIMENT.run(Settings(quick=True), lambda done, total: None)
    assert set(result.figures) == set(result.captions)
    frame = result.data["forward_and_mixed"]
    assert frame.shape == (500, 1 + len(NETWORKS) * 3 * len(TASKS))
    assert any("0.94142" in str(row.ours) for row in result.rows)
