"""The study that trains `ppo-memory`: a short run, what the teacher sees, and its lessons."""

import numpy as np
import pytest
import torch

from mmc_gym.agents.policy import PolicyAgent, load_policy
from mmc_gym.interface import ReachInterface
from mmc_gym.training.training import Training, make_vec_env
from studies.learners import ppo_memory as study

pytestmark = pytest.mark.slow

ARMS = 8


def truthful(name="random"):
    plain = make_vec_env("MMCReach-v0", ARMS, {"engine": "analytic", "control": "joint_delta"})
    return study.TruthfulScenarios(plain, names=[name], groups=1)


def truth(name, steps, action=0.3):
    """The truth that follows observations of equal arms under equal actions, (steps, arms, …)."""
    env = truthful(name)
    env.seed(0)
    seen = [env.reset()]
    seen += [env.step(np.full((ARMS, 3), action, np.float32))[0] for _ in range(steps - 1)]
    assert all(env.observation_space.contains(one) for one in seen[-1])
    env.close()
    return np.array(seen)[..., 15:]


@pytest.mark.parametrize("name", ["delay-100", "vision-noise-0.1", "joint-noise-0.05"])
def test_the_truth_is_on_time_and_without_noise(name):
    np.testing.assert_allclose(truth(name, 20), truth("random", 20), atol=1e-6)


@pytest.mark.parametrize(
    ("name", "index", "expected"),
    [
        ("rotation-90", slice(0, 2), (1.0, -1.0)),
        ("force-field-90", 2, 0.9),
        ("hand-mass-3", 3, 0.3),
        ("gravity-60", 4, -0.6),
        ("longer-20", slice(5, 8), (0.0, 0.0, 0.2)),
        ("locked-2", slice(8, 11), (0.0, 1.0, 0.0)),
    ],
)
def test_the_truth_tells_of_the_body(name, index, expected):
    """After the observation and the target's velocity: turn, forces, lengths, locks."""
    (body,) = truth(name, 1)[..., 17:]
    np.testing.assert_allclose(body[:, index], np.broadcast_to(expected, body[:, index].shape))
    assert not np.delete(body, np.r_[index], axis=-1).any()


def test_the_velocity_of_a_target_is_true_and_a_jump_is_none():
    moving = truth("pursuit", 30, action=0.0)  # the first segment, which is the frame, stays
    np.testing.assert_allclose(
        moving[1:, :, 15:17], np.diff(moving[..., 9:11], axis=0) / 0.02, atol=1e-4
    )
    assert moving[1:, :, 15:17].any()
    assert not truth("double-step-100", 10)[..., 15:17].any()


def test_the_policy_that_is_kept_acts_and_remembers_as_the_model_that_was_trained(tmp_path):
    changes = {"n_timesteps": 1, "n_envs": 32, "n_steps": 8, "batch_size": 64}
    changes |= {"policy_kwargs": {"net_arch": [8], "teacher": [8]}}
    wrappers = [
        {f"{study.HERE}.TruthfulScenarios": {"names": ["random"], "groups": 1}},
        {f"{study.HERE}.Memory": {"blocks": [1, 2, 3]}},
    ]
    models = []
    recipe = study.taught_recipe(**changes, vec_env_wrapper=wrappers)
    one = study.TaughtTraining(recipe, 0, tmp_path, evaluations=1)
    one.save = lambda model: (models.append(model), Training.save(one, model))
    card = one.run()
    network, same = load_policy(tmp_path / "ppo-memory-0.json")
    assert (card.blocks, same.blocks) == ((1, 2, 3), (1, 2, 3))
    env = study.Memory(truthful(), card.blocks)
    agent, model = PolicyAgent(network, card, ReachInterface.of(env)), models[-1]
    shown, state, started = env.reset(), None, np.ones(ARMS, dtype=bool)
    for _ in range(120):  # over the end of episodes
        expected, _ = model.predict(shown, deterministic=True)
        actions, state = agent.predict(shown[:, :15], state, started, deterministic=True)
        np.testing.assert_allclose(actions, expected, atol=1e-5)
        shown, _, started, infos = env.step(actions)
        if started.any():
            assert {len(info["terminal_observation"]) for info in infos} == {shown.shape[1]}


def test_a_student_learns_to_act_as_its_teacher_which_stays_as_it_is():
    env = study.Memory(truthful(), (1, 2, 3))
    model = study.TaughtPPO(study.TaughtPolicy, env, lessons=1.0, n_steps=50, batch_size=50, seed=0)
    observations = torch.as_tensor(env.reset())

    def actions():
        with torch.no_grad():
            policies = model.policy.teacher_actions, model.policy.student_actions
            return [policy(observations).numpy() for policy in policies]

    taught, before = actions()
    model.learn(20 * 50 * ARMS)
    same, after = actions()
    assert np.square(after - taught).mean() < 0.1 * np.square(before - taught).mean()
    np.testing.assert_array_equal(taught, same)
