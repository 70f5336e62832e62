"""The plain network acts as the stable-baselines3 policy that its weights are from."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from sb3_contrib.tqc.policies import TQCPolicy
from stable_baselines3.common.policies import ActorCriticPolicy, MultiInputActorCriticPolicy
from stable_baselines3.sac.policies import SACPolicy

from mmc_gym.agents.policy_network import History, PolicyNetwork
from mmc_gym.interface import ObservationLayout
from mmc_gym.training.policies import ACTIVATIONS, TQCGoalPolicy, export_policy

ENV_IDS = {
    "ActorCriticPolicy": "MMCReach-v0",  # PPO's "MlpPolicy", as are SACPolicy and TQCPolicy theirs
    "SACPolicy": "MMCReach-v0",
    "TQCPolicy": "MMCReach-v0",
    "TQCGoalPolicy": "MMCReachGoal-v0",
}
POLICIES = (ActorCriticPolicy, SACPolicy, TQCPolicy, TQCGoalPolicy)
KINDS = {kind.__name__: kind for kind in POLICIES}

LAYOUT = ObservationLayout(joint_count=3, reach=3.0)


def make_policy(name, env_id, **options):
    env = gym.make(env_id)
    torch.manual_seed(0)
    if "activation_fn" in options:
        options["activation_fn"] = ACTIVATIONS[options["activation_fn"]]
    kind = KINDS[name]
    options["net_arch"] = [16, 8]
    policy = kind(env.observation_space, env.action_space, lambda _: 1e-3, **options)
    for parameter in policy.parameters():  # an untrained policy's actions are all but zero
        parameter.data += 0.3 * torch.randn(parameter.shape)
    policy.set_training_mode(False)
    return policy


def observations(env_id, count=20):
    envs = gym.make_vec(env_id, count)
    envs.reset(seed=0)
    for actions in np.random.default_rng(0).uniform(-1, 1, (5, count, 3)).astype(np.float32):
        observed = envs.step(actions)[0]
    return observed


def act(network, observed, random=None):
    return network.act(LAYOUT.flatten(observed).astype(np.float32), random)


@pytest.mark.parametrize("activation", ["relu", "tanh"])
@pytest.mark.parametrize(("name", "env_id"), ENV_IDS.items())
def test_it_acts_as_the_policy_it_is_exported_from(name, env_id, activation):
    policy = make_policy(name, env_id, activation_fn=activation)
    observed = observations(env_id)
    expected, _ = policy.predict(observed, deterministic=True)
    actual = act(export_policy(policy), observed)
    np.testing.assert_allclose(actual, expected, atol=2e-6)
    assert np.abs(actual).max() <= 1.0
    assert actual.dtype == np.float32


@pytest.mark.parametrize("name", ["ActorCriticPolicy", "SACPolicy"])
def test_exploring_it_draws_from_the_same_distribution(name):
    policy = make_policy(name, "MMCReach-v0")
    network = export_policy(policy)
    many = np.repeat(observations("MMCReach-v0", 1), 20_000, axis=0)
    torch.manual_seed(0)
    expected, _ = policy.predict(many, deterministic=False)
    actual = act(network, many, np.random.default_rng(0))
    np.testing.assert_allclose(actual.mean(0), expected.mean(0), atol=0.02)
    np.testing.assert_allclose(actual.std(0), expected.std(0), atol=0.02)


def test_a_policy_that_sees_something_else_is_refused():
    env = gym.make("MMCReachGoal-v0")
    policy = MultiInputActorCriticPolicy(env.observation_space, env.action_space, lambda _: 1e-3)
    with pytest.raises(ValueError, match="policy must see the observation as it is"):
        export_policy(policy)


def test_a_missing_tensor_is_named():
    tensors = dict(export_policy(make_policy("ActorCriticPolicy", "MMCReach-v0")).tensors)
    del tensors["mean.bias"]
    with pytest.raises(ValueError, match=r"tensors must have 'mean\.bias'"):
        PolicyNetwork(tensors, "relu", "gaussian")


def test_a_history_has_what_was_seen_and_done_less_what_is_seen_now():
    env = gym.make("MMCReach-v0", engine="analytic")
    seen = [env.reset(seed=1)[0]]
    seen = np.array(seen + [env.step(np.full(3, 0.5, np.float32))[0] for _ in range(3)])
    history = History(LAYOUT, (1, 2, 3))
    before = history.recall(history.observed(seen[0]), history.start(seen[0]))
    np.testing.assert_allclose(before, 0.0, atol=1e-6)
    memory, action = history.start(seen[0]), np.full(3, 0.5, np.float32)
    for one in seen[:-1]:
        memory = history.extended(history.observed(one, memory), action, memory)
    recalled = history.recall(history.observed(seen[-1], memory), memory).reshape(3, 10)
    angles = np.unwrap(np.arctan2(seen[:, 3:6], seen[:, :3]), axis=0)
    np.testing.assert_allclose(recalled[0, :3], angles[-2] - angles[-1], atol=1e-5)
    np.testing.assert_allclose(recalled[1, :3], angles[[0, 1]].mean(0) - angles[-1], atol=1e-5)
    np.testing.assert_allclose(recalled[:, 5:7], 0.0, atol=1e-5)  # the target stays
    np.testing.assert_allclose(recalled[:2, 7:], 0.5)
    np.testing.assert_allclose(recalled[2, 7:], 0.0)  # nothing was done before the episode
