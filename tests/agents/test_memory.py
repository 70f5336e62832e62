"""Body agents that learn from movement to movement."""

import numpy as np
import pytest

from mmc_gym import UserError
from mmc_gym.agents.body_model.agent import ik_body, mmc_body
from mmc_gym.agents.body_model.obstacles import Contacts
from mmc_gym.agents.body_model.parts import Parts
from mmc_gym.experiments.experiment import Block, Experiment
from mmc_gym.experiments.trials import run_experiment
from mmc_gym.interface import ReachInterface


def angles_of(blocks, parts, build=mmc_body, subjects=1, noise=(), **env_kwargs):
    """Return the direction of the hand in each trial, at its fastest and at the end, degrees."""
    agents = {"learner": lambda env: build(ReachInterface.of(env), parts)}
    experiment = Experiment("short", tuple(blocks), noise=noise)
    result = run_experiment(experiment, agents, subjects, jobs=1, env_kwargs=env_kwargs)
    way = result.hands - result.hands[:, :1]
    fastest = np.linalg.norm(np.diff(way, axis=1), axis=-1).argmax(axis=1) + 1
    ways = [way[np.arange(len(way)), fastest], way[:, -1]]
    angles = [np.degrees(np.arctan2(way[:, 1], way[:, 0])) for way in ways]
    return [(angle - result.trials["target_angle"] + 180) % 360 - 180 for angle in angles]


def turned(trials, targets=(90.0,), **more):
    return Block("turned", trials, ("rotation-30",), targets, **more)


@pytest.mark.parametrize("build", [mmc_body, ik_body])
@pytest.mark.parametrize(
    ("rate", "retention"), [((0.2,), (0.9,)), ((0.4, 0.05), (0.6, 1.0)), ((1.0,), (1.0,))]
)
def test_a_turned_cursor_is_learned_and_forgotten_at_the_given_rates(build, rate, retention):
    parts = Parts(vigour=0.0, rate=rate, retention=retention)
    _, ends = angles_of([turned(6), Block("washout", 4, targets=(90.0,), rest=2.0)], parts, build)
    states, expected = np.zeros(len(rate)), []
    for trial in range(10):
        error = (30.0 if trial < 6 else 0.0) - states.sum()
        expected.append(-(states.sum() + sum(rate) * error))
        rest = 2.0 if trial == 5 else 0.0
        learned = np.array(retention) * states + np.array(rate) * error
        states = np.array(retention) ** rest * learned
    np.testing.assert_allclose(ends, expected, atol=1.0)


def test_what_is_learned_shows_at_the_beginning_of_a_movement():
    blocks = [Block("baseline", 4), turned(24, (0.0, 180.0)), Block("washout", 1)]
    first, _ = angles_of(blocks, Parts(vigour=0.0, rate=(0.3,), retention=(0.98,)))
    assert np.abs(first[:4]).max() < 8  # nothing is learned where nothing is wrong
    assert abs(first[4]) < 15 and np.abs(first[24:28] + 28).max() < 6 and first[28] < -12


def test_a_field_is_corrected_in_advance():
    targets, field = (90.0,), ("force-field-60",)
    blocks = [Block("field", 16, field, targets), Block("none", 1, (), targets)]
    parts = Parts(vigour=0.0, rate=(0.3,), retention=(1.0,))
    first, ends = angles_of(blocks, parts, torque_limit=120.0)
    pushed, _ = angles_of(blocks[:1], Parts(vigour=0.0), torque_limit=120.0)
    np.testing.assert_allclose(pushed[0], first[0], atol=0.5)
    assert np.ptp(pushed) < 0.1 < 10 < abs(first[0])  # without learning nothing changes
    assert abs(first[15]) < abs(first[0]) / 3 and first[16] * first[0] < 0  # an after-effect
    np.testing.assert_allclose(ends, 0.0, atol=1.0)


def test_contacts_are_looked_for_along_the_arm_that_was_learned(monkeypatch):
    felt, locate = [], Contacts.locate

    def noting(self, step, lengths, *others):
        felt.append(lengths[0])
        return locate(self, step, lengths, *others)

    monkeypatch.setattr(Contacts, "locate", noting)
    parts = Parts(vigour=0.0, rate=(1.0,), retention=(1.0,))
    angles_of([Block("longer", 2)], parts, noise=("longer-35",))
    np.testing.assert_allclose(felt[len(felt) // 2 :], [[1.0, 1.0, 1.35]] * 49, atol=0.02)


def test_subjects_learn_as_they_do_alone():
    parts, blocks = Parts(vigour=0.0, rate=(0.3,), retention=(0.9,)), [turned(3, (0.0, 90.0))]
    together = np.concatenate(angles_of(blocks, parts, subjects=3))
    alone = np.concatenate(angles_of(blocks, parts))
    assert (together.reshape(2, 3, 3)[:, 0] == alone.reshape(2, 3)).all()


def test_what_is_learned_holds_for_neighbouring_directions_if_it_is_tuned():
    directions = np.array([90.0] * 6 + [90.0, 70.0, 50.0, 270.0])
    probes = [Block("probe", 1, targets=(of,)) for of in directions[6:]]
    parts = Parts(vigour=0.0, rate=(0.5,), retention=(1.0,), width=20.0)
    _, ends = angles_of([turned(6), *probes], parts)
    beliefs, expected = np.zeros(10), []  # of the directions of all trials
    for trial, turn in enumerate([30.0] * 6 + [0.0] * 4):
        learned = 0.5 * (turn - beliefs[trial])
        expected.append(-(beliefs[trial] + learned))
        beliefs += learned * np.exp(-(((directions - directions[trial]) / 20.0) ** 2) / 2)
    np.testing.assert_allclose(ends, expected, atol=1.0)


@pytest.mark.parametrize("most", [3.0, 6.0])
def test_larger_errors_teach_no_more_than_the_largest_that_counts(most):
    parts = Parts(vigour=0.0, rate=(0.1,), retention=(1.0,), largest_error=most)
    blocks = [[Block("clamp", 5, (f"clamp-{error}",), (90.0,))] for error in (15, 45)]
    ends = np.array([angles_of(each, parts)[1] for each in blocks])
    np.testing.assert_allclose(ends, [-0.1 * most * np.arange(1, 6)] * 2, atol=0.5)


@pytest.mark.parametrize(
    ("settings", "argument"),
    [
        ({"rate": (1.5,)}, "rate"),
        ({"rate": (), "retention": ()}, "rate"),
        ({"rate": (0.7, 0.7), "retention": (0.5, 0.9)}, "rate"),
        ({"retention": (-1.0,)}, "retention"),
        ({"retention": (0.5, 0.9)}, "retention"),
        ({"width": 0.0}, "width"),
        ({"largest_error": 0.0}, "largest_error"),
        ({"vigour": 1.5}, "vigour"),
        ({"find_locks": True}, ".* did you mean 'finds_locks'"),
    ],
)
def test_parts_are_checked(settings, argument):
    with pytest.raises(UserError, match=f"^{argument}"):
        Parts(**settings)
