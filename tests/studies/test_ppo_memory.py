"""The study that trains `ppo-memory`: what its teacher is shown, and a short run."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import torch

from mmc_gym.agents.policy import PolicyAgent, load_policy, shipped_file
from mmc_gym.agents.policy_network import History
from mmc_gym.interface import ReachInterface
from studies.learners import ppo_memory as study

pytestmark = pytest.mark.slow

ARMS = 8
NAMES = ["delay-0..100", "vision-noise-0..0.1", "joint-noise-0..0.05", "rotation--60..60"]


def shown(choice, names=NAMES):
    """What the teacher is shown of arms that have drawn this option, under equal actions."""
    weights = [1.0 * (choice == number) for number in range(len(names))]
    perturbations = [{"one_of": names, "weights": weights}]
    envs = gym.make_vec("MMCReach-v0", ARMS, perturbations=perturbations, observe_context=True)
    env = envs.unwrapped
    env.reset = partial(env.reset, seed=0)  # whatever noise was drawn before
    history = History(ReachInterface.of(env).layout, (1, 2, 3))
    seen, true = study.episodes_of(env, history, lambda seen: np.full((ARMS, 3), 0.3, np.float32))
    assert seen.shape == (study.STEPS, ARMS, 15 + history.size)
    return true


def test_the_teacher_is_shown_what_is_true_when_late_actions_arrive():
    late, prompt = (
        shown(choice, ["action-delay-99..101", "gain-1..1.000001"]) for choice in range(2)
    )
    np.testing.assert_allclose(late[:-6, :, :15], prompt[:-6, :, :15], atol=1e-4)
    assert np.ptp(prompt[..., :15], axis=0).max() > 0.5, "the arm moves"


def test_the_teacher_is_shown_what_is_true_on_time_and_without_noise():
    delayed, blurred, trembling, turned = map(shown, range(4))
    np.testing.assert_allclose(delayed[..., :15], blurred[..., :15], atol=1e-6)
    np.testing.assert_allclose(delayed[..., :15], trembling[..., :15], atol=1e-6)
    assert np.abs(delayed - turned)[..., 11:13].max() > 0.1, "the hand is seen turned"
    np.testing.assert_array_equal(turned[0, :, 15:19], np.tile([0, 0, 0, 1], (ARMS, 1)))


def test_a_network_of_many_rows_acts_as_it_does_for_one():
    network, _ = load_policy(shipped_file("ppo-context", 0))
    rows = np.random.default_rng(0).uniform(-1, 1, (50, network.input_size)).astype(np.float32)
    np.testing.assert_allclose(study.actions_of(network, rows), network.act(rows), atol=1e-5)


def test_a_student_of_a_short_training_is_kept_and_acts(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "TASKS", {"MMCReach-v0": 32})
    monkeypatch.setattr(study, "EVALUATION_EPISODES", 4)
    monkeypatch.setattr(study, "FINAL_EPISODES", 4)
    torch.manual_seed(0)
    study.main(shipped_file("ppo-context", 0), rounds=3, out=tmp_path)
    network, card = load_policy(tmp_path / "ppo-memory-0.json")
    assert (card.blocks, card.context) == (study.BLOCKS, [])
    assert len(card.learning_curve) == 3
    env = gym.make("MMCReach-v0")
    agent = PolicyAgent(network, card, ReachInterface.of(env))
    action, _ = agent.predict(env.reset(seed=0)[0], deterministic=True)
    assert env.action_space.contains(action)
