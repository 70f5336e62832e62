"""Environments of others, Reacher-v5 among them: agents act in them, and tools measure it."""

import re
from dataclasses import replace
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from examples import reacher
from mmc_gym import UserError, check_interface, make_agent
from mmc_gym.benchmark.compare import compare
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.store import read_episodes
from mmc_gym.cli import main
from mmc_gym.geometry import segments_from_joint_angles
from mmc_gym.interface import InterfacedEnv, ReachInterface, Seen
from mmc_gym.report import write_report
from mmc_gym.robots import HingeArm
from studies.other_bodies.reacher import BODIES, FAULTS, play

LENGTHS = (1.0, 1.1)
PANDA = HingeArm.named("panda")
METRES = 0.1  # the environment's lengths are in metres, segment lengths are a tenth of that


class Drawer(gym.Env):
    """Two joints that turn by what the action says; nothing of this package."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (8,), np.float64)
    action_space = gym.spaces.Box(-0.1, 0.1, (2,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.angles, self.speeds = self.np_random.uniform(-1, 1, 2), np.zeros(2)
        radius, angle = self.np_random.uniform((0.05, -np.pi), (0.2, np.pi))
        self.target = radius * np.array([np.cos(angle), np.sin(angle)])
        return self.observation(), {}

    def observation(self):
        hand = METRES * segments_from_joint_angles(self.angles, LENGTHS).sum(axis=0)
        return np.concatenate([self.target, hand, self.angles, self.speeds])

    def step(self, action):
        self.speeds = np.clip(action, -0.1, 0.1) / 0.02
        self.angles = self.angles + 0.02 * self.speeds
        seen = self.observation()
        near = np.linalg.norm(seen[:2] - seen[2:4]) < 0.01
        return seen, -1.0, False, False, {"is_success": near}


class DrawerInterface(ReachInterface):
    def see(self, observation):
        target, hand, angles, speeds = np.split(observation, 4, axis=-1)
        return Seen(angles, target / METRES, joint_speeds=speeds, hand=hand / METRES)

    def act(self, joint_targets, sensed):
        return np.clip(self.turn(sensed.joint_angles, joint_targets), -0.1, 0.1)


INTERFACE = DrawerInterface(LENGTHS, "joint_position", 5.0, 50.0, 0.02, success_distance=0.1)
STATES_NO_DISTANCE = replace(INTERFACE, success_distance=None)
LIMITED = replace(INTERFACE, joint_limits=((-2.0, 2.0), (-np.inf, 2.5)))


def changed(seen=lambda seen: seen, action=lambda action: action, **fields):
    """Return an interface that changes what is seen, fields of it or the action."""

    class Changed(DrawerInterface):
        def see(self, observation):
            view = super().see(observation)
            values = {name: change(view) for name, change in fields.items()}
            return seen(replace(view, **values))

        def act(self, joint_targets, sensed):
            return action(super().act(joint_targets, sensed))

    return Changed(*vars(INTERFACE).values())


def strided(seen):
    """Numbers of float32 with others between them."""
    values = {name: np.float32(value).repeat(2, axis=-1) for name, value in vars(seen).items()}
    return replace(seen, **{name: value[..., ::2] for name, value in values.items()})


def make_drawer():
    return gym.wrappers.TimeLimit(Drawer(), 80)


def last_info(agent, env, seed):
    observation, info = env.reset(seed=seed)
    state, truncated = None, False
    while not truncated:
        action, state = agent.predict(observation, state)
        observation, _, _, truncated, info = env.step(action)
    return info


@pytest.mark.parametrize("name", ["mmc-body", "ik-body", "mmc", "ik-dls", "minimum-jerk"])
def test_agents_reach_in_an_environment_that_an_interface_describes(name):
    """In many at once as in one, and whatever float type it returns."""
    env = make_drawer()
    agent = make_agent(name, env, interface=INTERFACE)
    assert all(last_info(agent, env, seed)["is_success"] for seed in range(5))
    seen = np.stack([env.reset(seed=seed)[0] for seed in range(3)])
    together, _ = agent.predict(seen)
    np.testing.assert_allclose(together, [agent.predict(observation)[0] for observation in seen])
    single = make_agent(name, env, interface=changed(strided, np.float32))
    assert last_info(single, env, 3)["is_success"]


@pytest.mark.parametrize("interface", [INTERFACE, lambda env: INTERFACE, f"{__name__}:INTERFACE"])
def test_an_interface_is_given_as_an_object_by_a_function_or_by_name(interface):
    assert ReachInterface.of(InterfacedEnv(make_drawer(), interface)) == INTERFACE


def test_random_actions_are_drawn_from_the_action_space():
    agent = make_agent("random", make_drawer(), interface=INTERFACE)
    drawn = np.array([agent.predict(Drawer().reset(seed=0)[0])[0] for _ in range(200)])
    assert drawn.shape == (200, 2)
    assert 0.09 < np.abs(drawn).max() <= 0.1


def test_infos_tell_what_the_interface_sees():
    env = InterfacedEnv(make_drawer(), INTERFACE)
    observation, info = env.reset(seed=0)
    np.testing.assert_allclose(info["target"] * METRES, observation[:2])
    apart = np.linalg.norm(info["target"] - info["end_effector"])
    assert info["distance"] == pytest.approx(apart)
    assert info["is_success"] == (info["distance"] <= INTERFACE.success_distance)
    _, info = InterfacedEnv(make_drawer(), STATES_NO_DISTANCE).reset(seed=0)
    assert "is_success" not in info


@pytest.mark.parametrize(
    ("name", "interface", "message"),
    [
        ("ppo", INTERFACE, "DrawerInterface"),  # it reads our observations
        ("ik-dls", replace(INTERFACE, segment_lengths=(), arm=PANDA), "in the plane"),
        *(
            ("mmc", wrong, "interface")
            for wrong in (3, "nowhere:interface", lambda env: None, DrawerInterface)
        ),
    ],
)
def test_an_interface_of_another_kind_and_what_is_none_are_refused(name, interface, message):
    with pytest.raises(UserError, match=message):
        make_agent(name, make_drawer(), interface=interface)


def test_agents_are_compared_and_what_the_environment_does_not_say_is_left_out(tmp_path):
    agents = {"mine": lambda env: make_agent("ik-dls", env), "mmc-body": "mmc-body"}
    comparison = compare(agents, make_drawer, 3, interface=INTERFACE, out=tmp_path)
    assert comparison.headline.startswith("success at the end: mine 100.0 %, mmc-body 100.0 %")
    assert "joint work" not in str(comparison)  # the torques are unknown
    assert "within 0.1" in comparison.explanation
    returns = comparison.episodes.loc[comparison.episodes["agent"] == "mine", "episode_return"]
    assert list(returns) == [-80.0] * 3
    assert comparison.episodes["maximal_deviation"].notna().any()
    assert (tmp_path / "paths_and_profiles.png").stat().st_size > 1_000


def test_without_a_success_distance_the_environment_says_what_succeeds():
    comparison = compare("mmc-body", make_drawer, 3, interface=STATES_NO_DISTANCE)
    assert list(comparison.episodes["success"]) == [1.0] * 3
    assert comparison.settings["tolerance"] is None
    assert "time to target" not in str(comparison)
    assert "as the environment says" in comparison.explanation


def test_episodes_of_other_environments_are_kept_resumed_and_reported(tmp_path):
    play_in = partial(benchmark, ["mmc-body", "ik-dls"], tmp_path, episodes=2, jobs=2)
    unknown = partial(InterfacedEnv, make_drawer(), STATES_NO_DISTANCE)
    for reused in (0, 2):
        manifest = play_in({"drawer": make_drawer}, interface=LIMITED)
        assert manifest.reused == reused
        assert len(read_episodes(tmp_path)) == 4
    play_in({"unknown": unknown})
    assert "as it says" in write_report(tmp_path, tmp_path / "report.html").read_text()


def test_the_command_line_takes_an_interface_and_without_one_the_environment_is_refused(
    tmp_path, capsys
):
    where = ("--scenarios", f"{__name__}:make_drawer", "--interface", f"{__name__}:INTERFACE")
    main(["compare", "--agents", "ik-dls", "--episodes", "2", "--out", str(tmp_path), *where])
    assert "ik-dls 100.0 %" in capsys.readouterr().out
    with pytest.raises(UserError, match="interface="):
        compare("mmc", make_drawer, 2)


def success_and_return(name, body, folder):
    """Success, and mean return, of an agent in the same episodes."""
    true_body = {**BODIES, **FAULTS}[body]
    envs = [true_body.make(folder) for _ in range(12)]
    episodes = play(make_agent(name, envs[0], interface=reacher.INTERFACE), envs, list(range(12)))
    starts, targets = episodes.to_numpy()[:, 2:4], episodes.to_numpy()[:, 4:]
    missed = episodes["distance"] - true_body.nearest(starts, targets)
    return (missed < 0.01).mean(), episodes["return"].mean()


def test_mmc_body_earns_what_the_environment_asks_for_without_training(tmp_path):
    success, mean_return = success_and_return("mmc-body", "as given", tmp_path)
    assert success == 1.0
    assert mean_return > gym.spec("Reacher-v5").reward_threshold


@pytest.mark.parametrize(
    "body",
    [
        "second link 20 % longer",
        "first joint held",
        "motor 2 pushed",
        "sensor 1 stuck",
        "sensor 2 stuck",
        "a tool of 5 cm",
    ],
)
def test_a_changed_body_is_identified(body, tmp_path):
    success, mean_return = success_and_return("mmc-body", body, tmp_path)
    assert success > 0.9
    assert mean_return > success_and_return("ik-dls", body, tmp_path)[1] + 0.3


def test_the_servo_is_the_solution_of_the_riccati_equation():
    goal, left, speeds = np.array([0.4, -1.2]), np.array([0.7, -0.5]), np.array([1.0, -2.0])
    lengths = np.array(reacher.INTERFACE.segment_lengths)
    base, elbow = np.cumsum(segments_from_joint_angles(goal, lengths)[::-1], axis=0)[::-1]
    jacobian = reacher.METRES * np.array([[-base[1], -elbow[1]], [base[0], elbow[0]]])
    weight = jacobian.T @ jacobian / np.linalg.norm(jacobian @ left)
    zero, eye = np.zeros((2, 2)), np.eye(2)
    system = np.block([[zero, eye], [zero, -eye]]), np.vstack([zero, reacher.GEAR * eye])
    cost = np.block([[weight, zero], [zero, zero]])
    gains = system[1].T @ solve_continuous_are(*system, cost, eye)
    seen = Seen(goal - left, np.zeros(2), joint_speeds=speeds, hand=np.zeros(2))
    expected = -gains @ np.concatenate([-left, speeds])
    np.testing.assert_allclose(reacher.INTERFACE.act(goal, seen), expected, atol=1e-5)
    np.testing.assert_allclose(reacher.root(weight) @ reacher.root(weight), weight)


class Late(gym.ObservationWrapper):
    """What was seen two control steps ago; at first the start."""

    def reset(self, **arguments):
        self.seen = []
        return super().reset(**arguments)

    def observation(self, observation):
        self.seen.append(observation)
        return self.seen[max(0, len(self.seen) - 3)]


def test_late_angles_and_speeds_are_bridged_where_act_is_your_own(tmp_path):
    envs = [Late(BODIES["as given"].make(tmp_path)) for _ in range(8)]
    episodes = play(make_agent("mmc-body", envs[0], interface=reacher.INTERFACE), envs, [*range(8)])
    assert (episodes["distance"] < 0.01).all()


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ({}, None),
        ({"action": lambda action: 9 * action}, "0.9, is not of the action space, -0.1 to 0.1"),
        ({"action": lambda action: action[..., :1]}, r"of shape \(2,\), .* got \(1,\)"),
        ({"action": lambda action: None}, "what act returns must be .* return missing.*None"),
        ({"hand": lambda seen: 0.1 * seen.hand}, "hand of see is 0.1 times"),
        ({"hand": lambda seen: seen.hand + 1}, r"\[1.0, 1.0\] .* the base"),
        ({"hand": lambda seen: 0 * seen.hand}, "hand of see"),
        ({"joint_angles": lambda seen: np.degrees(seen.joint_angles)}, "in degrees"),
        ({"joint_angles": lambda seen: np.cumsum(seen.joint_angles, -1)}, "absolute"),
        ({"joint_speeds": lambda seen: 9 * seen.joint_speeds}, "joint_speeds of see are .* times"),
        ({"joint_speeds": lambda seen: seen.hand[:1]}, "joint_speeds of see must"),
        ({"action": lambda action: -action}, "act turns joint 0 away from"),
        ({"action": lambda action: action * [1, 0]}, "act turns joint 1 hardly toward"),
        ({"action": lambda action: action if action.ndim == 1 else action[0]}, "a batch"),
    ],
)
def test_a_check_says_in_one_line_what_is_wrong_with_an_interface(wrong, line):
    lines = check_interface(make_drawer(), changed(**wrong))
    assert (lines == []) if line is None else any(re.search(line, text) for text in lines)
    assert not any("\n" in text for text in lines)


def test_a_joint_without_a_limit_turns_the_short_way_and_one_with_an_end_stops_there():
    ends = ((-np.inf, np.inf), (-np.inf, 1.0))
    open_ended = ReachInterface(LENGTHS, "joint_delta", 5.0, 5.0, 0.02, joint_limits=ends)
    turn = open_ended.turn(np.array([3.0, 0.5]), np.array([-3.0, 2.0]))
    np.testing.assert_allclose(turn, [2 * np.pi - 6.0, 0.5])
    agent = make_agent("mmc-body", make_drawer(), interface=replace(INTERFACE, joint_limits=ends))
    assert last_info(agent, make_drawer(), 3)["is_success"]


@pytest.mark.parametrize("name", ["mmc-body", "ik-dls"])
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"hand": lambda seen: seen.hand * np.nan}, "hand of see"),
        ({"target": lambda seen: seen.target[:1]}, "target of see"),
        ({"joint_speeds": lambda seen: None}, "joint_speeds of see"),
        ({"seen": lambda seen: (seen.hand, seen.target)}, "what see returns must be a Seen"),
        ({"action": lambda action: action * np.inf}, "what act returns"),
        ({"action": lambda action: None}, "what act returns must be an action: .*, got None"),
        ({"action": lambda action: [action, action]}, "what act returns"),
    ],
)
def test_what_an_interface_returns_is_checked(wrong, message, name):
    env, interface = make_drawer(), changed(**wrong)
    agent = make_agent(name, env, interface=interface)
    with pytest.raises(UserError, match=message):
        agent.predict(env.reset(seed=1)[0])
    if "action" not in wrong:
        with pytest.raises(UserError, match=message):
            InterfacedEnv(env, interface).reset(seed=1)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("segment_lengths", (1.0, -1.0)),
        ("control", "by hand"),
        ("speed_limit", 0.0),
        ("servo_gain", np.inf),
        ("control_step", -0.02),
        ("success_distance", np.nan),
        ("joint_limits", ((-1.0, 1.0),)),
        ("joint_limits", ((-1.0, 1.0), (1.0, -1.0))),
        ("lockable_joints", (2,)),
        ("has_drive", "yes"),
        ("arm", "panda"),
        ("segment_lengths", ()),
    ],
)
def test_fields_of_an_interface_are_checked_when_it_is_made(field, value):
    with pytest.raises(UserError, match=field):
        replace(INTERFACE, **{field: value})


def test_lengths_of_an_arm_in_space_are_its_own_and_limits_may_be_an_array():
    in_space = partial(replace, INTERFACE, arm=PANDA)
    interface = in_space(segment_lengths=(), joint_limits=PANDA.limits)
    lengths = np.linalg.norm(np.diff(PANDA.nodes(np.zeros(7)), axis=0), axis=1)
    np.testing.assert_allclose(interface.segment_lengths, lengths)
    assert interface.joint_limits == tuple(map(tuple, PANDA.limits.tolist()))
    within = interface.within_limits(np.full(7, 0.01))
    assert within[3] == pytest.approx(PANDA.limits[3, 1])
    assert in_space(segment_lengths=lengths.round(2)).segment_lengths == tuple(lengths.round(2))
    for wrong in ((9, 9, 9), (0.33, 0.39), None, "far"):
        with pytest.raises(UserError, match=r"segment_lengths must be those of arm, \[0.32"):
            in_space(segment_lengths=wrong)
    for wrong in (PANDA.limits[:5], PANDA.limits[:, ::-1], PANDA.limits * np.nan):
        with pytest.raises(UserError, match="joint_limits must be 7 pairs"):
            in_space(segment_lengths=(), joint_limits=wrong)


class Turned(DrawerInterface):
    def see(self, observation):
        seen = super().see(observation)
        return replace(seen, joint_angles=seen.joint_angles % (2 * np.pi))


def test_a_check_finds_angles_of_limited_joints_beyond_their_limits():
    fields = {**vars(INTERFACE), "joint_limits": np.array([[-2.0, 2.0], [-np.inf, 2.5]])}
    assert check_interface(make_drawer(), DrawerInterface(**fields)) == []
    lines = check_interface(make_drawer(), Turned(**fields))[-2:]
    for joint, line in enumerate(lines):
        pattern = rf"joint_angles of see are (\S+) for joint {joint}, beyond .*: (\S+) is the same"
        angle, turned = map(float, re.fullmatch(pattern, line).groups())
        assert angle - turned == pytest.approx(2 * np.pi, abs=0.02)
    assert check_interface(make_drawer(), Turned(**{**fields, "joint_limits": None})) == []
    narrow = {**fields, "joint_limits": ((-0.1, 0.1), (-3, 3))}
    (line,) = check_interface(make_drawer(), DrawerInterface(**narrow))
    assert re.fullmatch(r"joint_angles .* joint 0, beyond its limits -0.1 and 0.1", line)


def test_an_action_of_another_size_is_refused_before_the_environment_gets_it():
    env = InterfacedEnv(make_drawer(), INTERFACE)
    env.reset(seed=0)
    with pytest.raises(UserError, match=r"action must be of shape \(2,\), .* got \(3,\)"):
        env.step(np.zeros(3))


@pytest.mark.parametrize("env", ["rotation-30", "MMCReach-v0"])
def test_an_interface_is_refused_for_scenarios_of_this_package(env, tmp_path):
    for play_in in (partial(compare, "ik-dls"), partial(benchmark, "ik-dls", tmp_path)):
        with pytest.raises(UserError, match="interface must be left out"):
            play_in(env, interface=INTERFACE)
