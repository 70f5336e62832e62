"""Every agent, in every environment that it can act in."""

from dataclasses import replace
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.wrappers import vector
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

from mmc_gym import UserError, make_agent
from mmc_gym.agents import AGENTS, resolve
from mmc_gym.agents.inverse_kinematics import InverseKinematicsAgent
from mmc_gym.agents.mmc import MMCAgent, TimedMMCAgent, bend_where_stuck
from mmc_gym.agents.policy import shipped_file
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.interface import CannotActError, ReachInterface, Sensed
from mmc_gym.measures import run_episodes
from mmc_gym.network import MMCNetwork
from mmc_gym.training.vec_env import GymnasiumVecEnv
from tests.conftest import by_night

NETWORKS = [name for name, entry in AGENTS.items() if entry.knowledge.kind == "network"]
JOINT_TARGET_AGENTS = [
    name
    for name, entry in AGENTS.items()
    if entry.knowledge.kind in ("network", "inverse kinematics", "planner", "optimal control")
]
DAILY = ("mmc", "mmc-body", "ik-dls", "minimum-jerk", "optimal-control", "ppo-memory")
"""One agent of each family; the others are `slow`."""


def moments(name, envs, steps, seed=0):
    """Yield actions, memory, observations and infos after each step."""
    (observations, _), state, agent = envs.reset(seed=seed), None, make_agent(name, envs)
    for _ in range(steps):
        actions, state = agent.predict(observations, state, deterministic=True)
        observations, _, _, _, infos = envs.step(actions)
        yield actions, state, observations, infos


def success_rate(name, episodes, env_id="MMCReach-v0", **options):
    envs = gym.make_vec(env_id, num_envs=episodes, **options)
    *_, (_, _, _, infos) = moments(name, envs, 99)  # the step after would begin the next episodes
    return infos["is_success"].mean()


@pytest.mark.parametrize("env_id", ["MMCReach-v0", "MMCReachGoal-v0"])
@pytest.mark.parametrize("name", AGENTS)
def test_actions_lie_in_the_action_space_single_and_batched(name, env_id):
    options = {"control": AGENTS[name].control or "joint_delta", **resolve(name).arguments}
    agent = make_agent(name, gym.make(env_id, **options))
    for env in (gym.make(env_id, **options), gym.make_vec(env_id, 2, **options)):
        action, _ = agent.predict(env.reset(seed=0)[0])
        assert env.action_space.contains(action)  # float32 as well


WORLDS = {
    "no trouble": [{}],
    "limits": [{"joint_limits": ((-2.5, 2.5),) * 3}],
    **{family: [{"perturbations": (family,)}] for family in FAMILIES},
}
WORLDS["all mixed"] = [
    {"task": "pursuit", "max_episode_steps": 500},
    {"task": "double-step-100"},
    {"perturbations": ("shorter-80", "rotation")},
    *({"perturbations": (family,)} for family in FAMILIES),
]


@pytest.mark.filterwarnings("ignore::mmc_gym.MismatchWarning")
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", by_night([name for name in AGENTS if name != "random"], DAILY))
def test_an_arm_acts_in_any_batch_as_it_does_alone(name, world):
    """Bit for bit; of policies, sums in single precision may differ in their last bits."""
    count = 1 if world == "all mixed" else 9
    shown = {"control": AGENTS[name].control or "joint_delta", **resolve(name).arguments}
    make = partial(gym.make_vec, "MMCReach-v0", count, **shown)
    envs = [make(**options) for options in WORLDS[world]]
    agent, together = make_agent(name, envs[0]), None
    observations = np.concatenate([vector.reset(seed=60_000)[0] for vector in envs])
    batches = [*(range(len(observations)) if count == 1 else (2, 5)), [8, 2, 0, 3]]
    states = [None] * len(batches)
    for _ in range(40):
        actions, together = agent.predict(observations, together, deterministic=True)
        for place, batch in enumerate(batches):
            alone, states[place] = agent.predict(observations[batch], states[place], None, True)
            most = 4e-6 if AGENTS[name].knowledge.kind == "learned" else 0
            np.testing.assert_allclose(alone, actions[batch], rtol=0, atol=most)
        parts = np.split(actions, len(envs))
        moved = [vector.step(part)[0] for vector, part in zip(envs, parts, strict=True)]
        observations = np.concatenate(moved)


@pytest.mark.parametrize("late", [(), ("delay-40",)])
@pytest.mark.parametrize("name", by_night([*JOINT_TARGET_AGENTS, "ppo-memory"], DAILY))
def test_a_new_episode_knows_nothing_of_the_last_and_changes_no_other(name, late):
    envs = gym.make_vec("MMCReach-v0", num_envs=3, perturbations=("longer-20", "locked", *late))
    predict = partial(make_agent(name, envs).predict, deterministic=True)
    *_, (_, state, observations, _) = moments(name, envs, 9, seed=60_002)
    resumed, _ = predict(observations, state)
    fresh, fresh_state = predict(observations)
    assert not np.array_equal(fresh[1], resumed[1])
    restarted, state = predict(observations, state, [False, True, False])
    np.testing.assert_array_equal(restarted, [resumed[0], fresh[1], resumed[2]])
    after = [predict(observations, memory)[0] for memory in (state, fresh_state)]
    np.testing.assert_array_equal(after[0][1], after[1][1])


@pytest.mark.parametrize("bearing", [0.7, pytest.param(0.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("count", by_night([2, 3, 4, 6], daily=[3]))
@pytest.mark.parametrize("name", by_night([*NETWORKS, "ik-dls"], DAILY))
def test_an_arm_in_one_line_with_its_target_gets_there(name, count, bearing):
    """No method of iteration does, unless it is bent a little; all get the same help."""
    direction = np.array([np.cos(bearing), np.sin(bearing)])
    options = [
        {"joint_angles": [bearing, *[bend] * (count - 1)], "target": count * part * direction}
        for bend, part in ((0, 2 / 3), (0, -1 / 2), (0, 0.0), (np.pi, 0.6))
    ]
    envs = gym.make_vec("MMCReach-v0", len(options), segment_lengths=(1.0,) * count)
    is_slow = name == "mmc-classical" or (name == "mmc-bell" and count == 6)
    for episode in run_episodes(make_agent(name, envs), envs, range(len(options)), options=options):
        start, end = episode.distances[[0, -1]]
        assert end <= (0.9 * start if is_slow else 0.02)


def test_of_a_batch_of_networks_only_those_that_are_stuck_are_bent():
    network, straight = MMCNetwork(), np.zeros(3)
    postures = [straight, straight, straight, [0.0, 0.1, 0.0], [0.5, 1.0, 0.5]]
    targets = [[2.0, 0.0], [2.0, 1.0], [3.0, 0.0], [2.0, 0.0], [2.0, 0.0]]
    state = network.state_from_joint_angles(postures)
    after = bend_where_stuck(network, state, network.inverse(targets))
    is_bent = (after.values != state.values).any(axis=(0, 1))
    np.testing.assert_array_equal(is_bent, [True, False, False, False, False])


LIMITS = ((-3.0, 3.0), (-2.0, 2.0), (-2.0, 2.0))


@pytest.mark.parametrize("name", by_night([*JOINT_TARGET_AGENTS], ("mmc", "ik-dls")))
def test_joint_limits_are_known_and_delta_control_does_as_well_as_position_control(name):
    """No agent searches for ways round: targets that are missed are behind an obstacle."""
    least = {"mmc-bell": 0.45, "mmc-classical": 0.2, "optimal-control": 0.6}.get(name, 0.7)
    controls = ("joint_delta", "joint_position")
    rates = [success_rate(name, 50, control=control, joint_limits=LIMITS) for control in controls]
    assert min(rates) >= least
    assert abs(rates[0] - rates[1]) <= 0.06


@pytest.mark.parametrize("name", by_night(JOINT_TARGET_AGENTS, DAILY))
def test_no_joint_is_sent_beyond_its_limits(name):
    limits = ((-1.5, 1.5), (0.0, 2.5), (-1.0, 2.0))
    envs = gym.make_vec("MMCReach-v0", 10, control="joint_position", joint_limits=limits)
    low, high = np.transpose(limits) / np.pi
    for actions, *_ in moments(name, envs, 60):
        assert ((actions >= low - 1e-6) & (actions <= high + 1e-6)).all()


def test_delta_control_goes_the_way_that_limits_leave():
    interface = replace(
        ReachInterface.of(gym.make("MMCReach-v0", control="joint_delta")), joint_limits=LIMITS
    )
    sensed = Sensed(np.array([2.9, 0.0, 1.9]), np.zeros(2))
    assert interface.act(np.array([-2.9, 0.0, 2.5]), sensed)[0] == -1.0  # not across pi
    assert 0 < interface.act(np.array([2.9, 0.0, 2.5]), sensed)[2] < 0.2  # to 2, no farther


WITH_STATES = ("mmc-bell", *DAILY)


@pytest.mark.parametrize("name", WITH_STATES)
def test_a_state_of_another_agent_or_of_other_arms_is_an_error(name):
    env, longer = (gym.make("MMCReach-v0", segment_lengths=(1.0,) * n) for n in (3, 4))
    agent, (observation, _) = make_agent(name, env), env.reset(seed=0)
    others = [make_agent(other, env) for other in WITH_STATES if other != name]
    many = np.stack([observation] * 4)
    _, state = agent.predict(many)
    wrong = [state, *(other.predict(observation)[1] for other in others)]
    if name != "ppo-memory":  # trained for three segments
        wrong.append(make_agent(name, longer).predict(longer.reset(seed=0)[0])[1])
    for memory in (*wrong, "abc", 3, {"posture": 1}, [0.1, 0.2, 0.3], np.zeros((7, 5))):
        with pytest.raises(UserError, match="state must be what predict returned for this agent"):
            agent.predict(observation, memory)
    with pytest.raises(UserError, match="state must be what predict returned for this agent"):
        agent.predict(many[:3], state)
    assert agent.predict(many[:0])[0].shape == (0, 3)
    with pytest.raises(UserError, match=r"episode_start must be of shape \(4,\)"):
        agent.predict(many, state, [True, False, False])


@pytest.mark.parametrize("name", ["ppo", "sac", "random"])
def test_an_agent_without_memory_takes_no_state(name, env):
    observation, _ = env.reset(seed=0)
    for state in (np.zeros(3), make_agent("mmc", env).predict(observation)[1]):
        with pytest.raises(UserError, match="state must be None"):
            make_agent(name, env).predict(observation, state)


WRAPPERS = (
    wrappers.NormalizeObservation,
    lambda env: wrappers.RescaleAction(env, np.float32(-2), np.float32(2)),
    lambda env: wrappers.FrameStackObservation(env, 2),
    lambda env: wrappers.RepeatAction(env, 2),
    lambda env: wrappers.TransformAction(env, lambda action: action / 2, None),
)


@pytest.mark.parametrize("agent", ["mmc", "ppo", "mmc-body", "random", str(shipped_file("ppo", 1))])
@pytest.mark.parametrize("wrap", WRAPPERS)
def test_wrappers_that_change_what_is_seen_or_done_are_refused_by_their_names(wrap, agent):
    wrapped = wrap(gym.make("MMCReach-v0"))
    name = type(wrapped).__name__
    envs = gym.make_vec("MMCReach-v0", 1, vectorization_mode="sync", wrappers=[wrap])
    for env in (wrapped, wrappers.RecordEpisodeStatistics(wrapped), envs):
        with pytest.raises(CannotActError, match=f"env must show its own .* got it in {name}: "):
            make_agent(agent, env)


def test_wrappers_of_vectors_are_refused_and_harmless_ones_are_not():
    native, many = gym.make_vec("MMCReach-v0", 2), make_vec_env("MMCReach-v0", n_envs=2)
    for env in (vector.NormalizeObservation(native), VecNormalize(many), VecFrameStack(many, 2)):
        with pytest.raises(CannotActError, match=f"got it in {type(env).__name__}: "):
            make_agent("mmc", env)
    yours = type("Paid", (gym.Wrapper,), {"__doc__": "A reward of your own."})
    harmless = (wrappers.ClipAction, wrappers.RecordEpisodeStatistics, yours)
    env = gym.make("MMCReach-v0", render_mode="rgb_array")
    for wrap in (*harmless, wrappers.RenderCollection, wrappers.NormalizeReward):
        env = wrap(env)
    for each in (env, vector.RecordEpisodeStatistics(native), VecNormalize(many, norm_obs=False)):
        assert make_agent("ppo", each)


@pytest.mark.parametrize("name", by_night(JOINT_TARGET_AGENTS, ("mmc", "ik-dls")))
def test_nearly_all_targets_are_reached_by_joint_targets_of_every_kind_and_other_arms(name):
    least = {"mmc": 1.0, "ik-dls": 1.0, "mmc-classical": 0.7}.get(name, 0.97)
    for control in ("joint_position", "joint_delta", "joint_velocity"):
        env_id = "MMCReachGoal-v0" if control == "joint_velocity" else "MMCReach-v0"
        assert success_rate(name, 40, env_id, control=control) >= least
    for lengths in ((1.0, 1.0), (2.0, 1.0, 0.5), (2.0, 1.0, 0.5, 0.25), (0.5,) * 7):
        rate = success_rate(name, 40, segment_lengths=lengths, success_distance=0.1)
        assert rate >= (0.4 if name == "mmc-classical" else 0.9)


def test_stable_baselines3_evaluates_them():
    env = make_vec_env("MMCReach-v0", n_envs=4, seed=0)
    reward, _ = evaluate_policy(make_agent("mmc", env), env, n_eval_episodes=8, warn=False)
    assert reward > -100  # still hands get about −250


@pytest.mark.parametrize("name", ["random", "ppo"])
def test_what_is_drawn_at_random_is_the_same_at_every_run(name, env):
    observation, _ = env.reset(seed=0)
    agents = make_agent(name, env), make_agent(name, env)
    drawn, again = ([agent.predict(observation)[0] for _ in range(3)] for agent in agents)
    np.testing.assert_array_equal(drawn, again)
    assert not np.array_equal(drawn[0], drawn[1])


def test_vectors_of_any_kind_have_the_interface_of_their_environments():
    interface = ReachInterface.of(gym.make("MMCReach-v0"))
    native = gym.make_vec("MMCReach-v0", 2, autoreset_mode="SameStep")
    sync = gym.make_vec("MMCReach-v0", 2, vectorization_mode="sync")
    for envs in (native, sync, make_vec_env("MMCReach-v0", n_envs=2), GymnasiumVecEnv(native)):
        assert make_agent("mmc-body", envs).interface == interface


def make(name="mmc", **options):
    return make_agent(name, gym.make("MMCReach-v0", **options))


INTERFACE = ReachInterface.of(gym.make("MMCReach-v0"))
CONTROL = CannotActError, "control must be"
NETWORK = MMCNetwork()


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        *((partial(make, name, control="joint_torque"), *CONTROL) for name in JOINT_TARGET_AGENTS),
        (partial(make, "ppo", control="joint_torque"), *CONTROL),
        (partial(make, segment_lengths=(1.0,)), CannotActError, "two segments or more"),
        (partial(make, "mmc-body", segment_lengths=(1.0,)), CannotActError, "two segments or more"),
        (partial(make, "ppo", segment_lengths=(1.0,) * 2), CannotActError, "3 segments"),
        (lambda: make_agent("mmc", "Pendulum-v1"), UserError, "env must be a reaching environment"),
        (lambda: make_agent("mmc", gym.make("Pendulum-v1")), UserError, "env must be"),
        (lambda: make_agent("mmc", make_vec_env("Pendulum-v1")), UserError, "env must be"),
        (lambda: MMCAgent("env", NETWORK), UserError, "interface"),
        (lambda: MMCAgent(INTERFACE, "mmc"), UserError, "network"),
        (lambda: MMCAgent(INTERFACE, MMCNetwork((1.0,) * 4)), UserError, "network"),
        (lambda: TimedMMCAgent(INTERFACE, NETWORK, 0), UserError, "iterations_per_step"),
        (lambda: InverseKinematicsAgent(INTERFACE, 0), UserError, "iterations_per_step"),
    ],
)
def test_what_an_agent_cannot_act_in_and_wrong_arguments_are_refused(call, error, message):
    with pytest.raises(error, match=message):
        call()
