"""Trained policies: complete, checked, free of code; as good as their cards, and as in sb3."""

import contextlib
import json
import shutil
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import torch
from sb3_contrib.tqc.policies import TQCPolicy
from stable_baselines3.common.policies import ActorCriticPolicy, MultiInputActorCriticPolicy
from stable_baselines3.sac.policies import SACPolicy

from mmc_gym import MismatchWarning, UserError, make_agent
from mmc_gym._files import digest_of
from mmc_gym.agents import AGENTS, policy
from mmc_gym.agents.policy import PRETRAINED, load_policy
from mmc_gym.agents.policy_network import History, PolicyNetwork
from mmc_gym.interface import ObservationLayout
from mmc_gym.measures.rollout import evaluate, run_episodes
from mmc_gym.training.hyperparameters import names, read_recipe
from mmc_gym.training.policies import ACTIVATIONS, TQCGoalPolicy, export_policy
from mmc_gym.training.training import evaluate_policy

MEBIBYTE = 2**20
SHIPPED = [(name, seed) for name, entry in AGENTS.items() for seed in range(entry.training_seeds)]
BY_DAY = [pytest.param(*cell, marks=[pytest.mark.slow] if cell[1] else []) for cell in SHIPPED]
"""The first training of each agent; the others are slow."""


@pytest.fixture
def copy(tmp_path):
    for file in PRETRAINED.glob("ppo-0.*"):
        shutil.copy(file, tmp_path)
    return tmp_path / "ppo-0.json"


@pytest.mark.parametrize(("name", "seed"), [cell for cell in SHIPPED if cell[0] in names()])
def test_what_ships_is_complete_and_of_the_shipped_hyperparameters(name, seed):
    network, card = load_policy(PRETRAINED / f"{name}-{seed}.json")
    assert (card.name, card.seed) == (name, seed)
    recipe = read_recipe(name)
    assert (card.env_id, card.hyperparameters) == (recipe.env_id, recipe.hyperparameters)
    assert card.training_steps == card.learning_curve[-1]["steps"]
    assert len(card.learning_curve) >= 8
    options = recipe.settings["policy_kwargs"]
    sizes = [len(network.tensors[f"hidden.{layer}.bias"]) for layer in range(2)]
    assert sizes == (options["net_arch"] if options else [256, 256])
    assert {"python", "torch", "stable-baselines3", "mmc-gym"} <= set(card.versions)


@pytest.mark.parametrize("name", [name for name, seed in SHIPPED if seed == 0])
def test_what_ships_does_as_well_as_its_card_says(name):
    network, card = load_policy(PRETRAINED / f"{name}-0.json")
    scores = evaluate_policy(network, card, policy.EVALUATION_EPISODES)
    last = card.learning_curve[-1]
    # Another machine's arithmetic may end a few episodes otherwise; mean returns may be near 0.
    for measure, most in (("success", 0.02), ("final_distance", 0.02), ("episode_return", 1.0)):
        assert scores[measure] == pytest.approx(last[measure], rel=0.05, abs=most)


@pytest.mark.parametrize(("name", "seed"), BY_DAY)
def test_what_ships_reaches_alike_on_both_engines(name, seed):
    network, card = load_policy(PRETRAINED / f"{name}-{seed}.json")
    arguments = {**card.hyperparameters["env_kwargs"], "control": card.control}
    arguments |= {"perturbations": (), "observe_context": card.context}
    make = partial(policy.PolicyAgent, network, card)
    solved, exact = (
        evaluate(make, card.env_id, arguments | {"engine": engine}, 300 if seed else 100)["success"]
        for engine in ("pymunk", "analytic")
    )
    assert min(solved, exact) >= 0.96
    assert solved == pytest.approx(exact, abs=0.02)


def test_nothing_else_ships():
    suffixes = ("json", "safetensors")
    expected = {f"{name}-{seed}.{suffix}" for name, seed in SHIPPED for suffix in suffixes}
    assert {path.name for path in PRETRAINED.iterdir()} == expected
    assert sum(path.stat().st_size for path in PRETRAINED.iterdir()) < 10 * MEBIBYTE


def test_damaged_weights_are_an_error(copy, tmp_path):
    network, card = load_policy(copy)
    weights = copy.with_suffix(".safetensors")
    weights.write_bytes(weights.read_bytes()[:-1] + b"x")
    with pytest.raises(ValueError, match="its weights are not those of its card"):
        load_policy(copy)
    network.tensors["mean.bias"] = np.full_like(network.tensors["mean.bias"], np.nan)
    policy.save_policy(network, card, tmp_path)
    with pytest.raises(ValueError, match="its weights must be finite"):
        load_policy(copy)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"activation": "os.system"}, "activation must be 'relu' or 'tanh', got 'os.sys"),
        ({"segment_count": 4}, "body must have 4 segments"),
        ({"extra": 1}, "extra is not known"),
        ({"learning_curve": [{"steps": 100, "success": None}]}, "learning_curve must have .* in e"),
        ({"base_agent": "pmp"}, "base_agent must be one of \\['mmc'\\] or empty"),
        ({"distribution": "squashed"}, "distribution must be that of 'ppo'"),
        ({"body": {"segment_lengths": [1, -1, 1]}}, "body segment_lengths must be positive"),
        ({"name": "../../elsewhere"}, "card: name .*pattern"),
        ({"name": ".."}, "card: name .*pattern"),
        ({"name": "C:elsewhere"}, "card: name .*pattern"),
        ({"blocks": [1, 2]}, "network must take 35 features, got 15"),
    ],
)
def test_a_card_that_does_not_fit_is_an_error(copy, changes, message):
    entries = json.loads(copy.read_text()) | changes
    del entries[policy._DIGEST]  # and its writer wrote the digest that belongs to it
    copy.write_text(json.dumps({**entries, policy._DIGEST: digest_of(entries)}))
    with pytest.raises(ValueError, match=message):
        make_agent(copy, gym.make("MMCReach-v0"))


def test_a_card_is_loaded_as_it_was_written_or_not_at_all(copy):
    _, card = load_policy(copy)
    text = copy.read_bytes()
    entries = json.loads(text)
    copy.write_text(json.dumps(dict(reversed(entries.items()))))
    assert load_policy(copy)[1] == card
    del entries[policy._DIGEST]
    changed = text.replace(b'"training_steps": 516096', b'"training_steps": 516097')
    for content in (changed, json.dumps(entries).encode(), b"{", b"[]", b"\xff\xfe", b"[" * 10**5):
        copy.write_bytes(content)
        with pytest.raises(UserError, match=str(copy.with_suffix(""))):
            load_policy(copy)
    for bit in range(0, 8 * len(text), 211):
        flipped = bytearray(text)
        flipped[bit // 8] ^= 1 << bit % 8
        copy.write_bytes(flipped)
        with contextlib.suppress(UserError):  # of bits that are never read
            assert load_policy(copy)[1] == card


def test_a_policy_of_joint_deltas_moves_the_arm_alike_under_position_control():
    hands = []
    for control in ("joint_delta", "joint_position"):
        # Later rounding grows, where the hand dances about the target.
        env = gym.make("MMCReach-v0", control=control, max_episode_steps=12)
        (episode,) = run_episodes(make_agent("ppo", env), env, [5])
        hands.append(episode.hands)
    np.testing.assert_allclose(*hands, atol=1e-3)
    assert np.linalg.norm(hands[0][11] - hands[0][0]) > 0.1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"segment_lengths": (1, 1, 2)}, r"lengths .* in training, \(1.0, 1.0, 2.0\)"),
        ({"gravity": (0, -9), "hand_mass": 1}, "gravity .* here; hand_mass 0.0 in training, 1.0"),
        ({"substeps": 8}, "control_step 0.02 in training, 0.04 here"),
    ],
)
def test_a_policy_warns_of_another_arm_than_in_training(arguments, message):
    for env in (gym.make("MMCReach-v0", **arguments), gym.make_vec("MMCReach-v0", 2, **arguments)):
        with pytest.warns(MismatchWarning, match=f"ppo-0 was trained with another arm.*{message}"):
            make_agent("ppo-0", env)


def test_another_way_to_simulate_the_arm_and_a_perturbation_are_no_mismatch():
    arguments = {"engine": "analytic", "substep": 0.0025, "substeps": 8}
    env = gym.make("MMCReach-v0", perturbations=["longer-20-known", "hand-mass"], **arguments)
    assert make_agent("ppo-0", env)  # a warning is an error


LAYOUT = ObservationLayout(joint_count=3, reach=3.0)
POLICIES = [
    (ActorCriticPolicy, "MMCReach-v0"),  # PPO's "MlpPolicy", as the next two are SAC's and TQC's
    (SACPolicy, "MMCReach-v0"),
    (TQCPolicy, "MMCReach-v0"),
    (TQCGoalPolicy, "MMCReachGoal-v0"),
]


def make_policy(kind, env_id="MMCReach-v0", activation="relu"):
    env = gym.make(env_id)
    torch.manual_seed(0)
    options = {"net_arch": [16, 8], "activation_fn": ACTIVATIONS[activation]}
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
@pytest.mark.parametrize(("kind", "env_id"), POLICIES)
def test_it_acts_as_the_policy_it_is_exported_from(kind, env_id, activation):
    policy = make_policy(kind, env_id, activation)
    observed = observations(env_id)
    expected, _ = policy.predict(observed, deterministic=True)
    actual = act(export_policy(policy), observed)
    np.testing.assert_allclose(actual, expected, atol=2e-6)
    assert np.abs(actual).max() <= 1.0
    assert actual.dtype == np.float32


@pytest.mark.parametrize("kind", [ActorCriticPolicy, SACPolicy])
def test_exploring_it_draws_from_the_same_distribution(kind):
    policy = make_policy(kind)
    network = export_policy(policy)
    many = np.repeat(observations("MMCReach-v0", 1), 20_000, axis=0)
    torch.manual_seed(0)
    expected, _ = policy.predict(many, deterministic=False)
    actual = act(network, many, np.random.default_rng(0))
    np.testing.assert_allclose(actual.mean(0), expected.mean(0), atol=0.02)
    np.testing.assert_allclose(actual.std(0), expected.std(0), atol=0.02)


def test_a_policy_that_sees_something_else_and_a_missing_tensor_are_refused():
    with pytest.raises(ValueError, match="policy must see the observation as it is"):
        export_policy(make_policy(MultiInputActorCriticPolicy, "MMCReachGoal-v0"))
    tensors = dict(export_policy(make_policy(ActorCriticPolicy)).tensors)
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
    for observation in seen[:-1]:
        memory = history.extended(history.observed(observation, memory), action, memory)
    recalled = history.recall(history.observed(seen[-1], memory), memory).reshape(3, 10)
    angles = np.unwrap(np.arctan2(seen[:, 3:6], seen[:, :3]), axis=0)
    np.testing.assert_allclose(recalled[0, :3], angles[-2] - angles[-1], atol=1e-5)
    np.testing.assert_allclose(recalled[1, :3], angles[[0, 1]].mean(0) - angles[-1], atol=1e-5)
    np.testing.assert_allclose(recalled[:, 5:7], 0.0, atol=1e-5)  # the target stays
    np.testing.assert_allclose(recalled[:2, 7:], 0.5)
    np.testing.assert_allclose(recalled[2, 7:], 0.0)  # nothing was done before the episode
