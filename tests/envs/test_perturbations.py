"""Facts about the perturbations: what goes wrong, by how much, and what stays as it was."""

import copy
import math

import gymnasium as gym
import numpy as np
import pytest

from mmc_gym import UserError
from mmc_gym.agents import make_agent
from mmc_gym.body import ArmParameters
from mmc_gym.envs.buffers import Noise
from mmc_gym.envs.cursor import Cursor
from mmc_gym.envs.names import parse_change
from mmc_gym.envs.perturbations import (
    FOUR_DISCS,
    CursorGain,
    CursorJump,
    CursorMirror,
    LockedJoint,
    Obstacles,
    SegmentLength,
    Timed,
    VisuomotorRotation,
)
from mmc_gym.envs.reach import MMCReachEnv
from mmc_gym.envs.senses import Senses
from mmc_gym.envs.vector import MMCReachGoalVectorEnv, MMCReachVectorEnv
from mmc_gym.envs.workspace import Workspace
from mmc_gym.geometry import node_positions, segments_from_joint_angles, wrap_angle
from mmc_gym.interface import CONTROLS, ReachInterface, Seen
from mmc_gym.measures import run_episodes
from tests.conftest import by_night
from tests.envs.conftest import random_actions

DISCS = FOUR_DISCS[:2]
BLOCKED = {"obstacles": (*DISCS, DISCS[0]), "substep": 0.0025, "substeps": 8}
LONG = {"segment_lengths": (2, 0.5, 1), "torque_limit": 500.0}


def movement(env, seed=0, steps=100, options=None):
    """The episode of the MMC agent."""
    limited = gym.wrappers.TimeLimit(env, steps)
    (episode,) = run_episodes(make_agent("mmc", env), limited, [seed], options=[options or {}])
    return episode


def joint_angles(env):
    return np.array(env.arm.joint_angles)


@pytest.mark.parametrize(
    ("perturbations", "body", "is_known"),
    [
        (["force-field-3", "force-field-4"], {"force_field": ((1.0, 7.0), (-7.0, 1.0))}, False),
        (["hand-mass-1", "hand-mass-2"], {"hand_mass": 3.5}, False),
        ([SegmentLength(2.0, 0), SegmentLength(0.5, 1)], LONG, False),
        (["obstacles", "obstacles-1"], BLOCKED, False),
        ("locked", {"lockable_joints": (1,)}, False),
        ("locked-known", {"lockable_joints": (1,)}, True),
        ("gravity-60", {"gravity": (1.0, -62.0)}, True),
    ],
)
def test_perturbations_of_the_body_change_it_and_add_up(perturbations, body, is_known):
    unchanged = {"force_field": ((1.0, 0.0), (0.0, 1.0)), "hand_mass": 0.5, "gravity": (1.0, -2.0)}
    env = MMCReachEnv(perturbations=perturbations, **unchanged)
    assert env.episode.body == ArmParameters(**{**unchanged, **body})
    assert env.parameters == (env.episode.body if is_known else ArmParameters(**unchanged))


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("factor", [0.5, 1.2])
def test_an_agent_that_is_not_given_a_length_misses_by_its_change(factor, known):
    change = SegmentLength(factor, known=known)
    env = MMCReachEnv(perturbations=change)
    assert env.episode.body.segment_lengths == pytest.approx((1.0, 1.0, factor))
    lengths = (1.0, 1.0, factor if known else 1.0)
    assert env.parameters.segment_lengths == pytest.approx(lengths)
    expected = 0.0 if known else abs(factor - 1)
    for seed in range(5):
        assert movement(env, seed).distances[-1] == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("joint", range(3))
def test_targets_of_a_locked_arm_can_be_reached_by_its_other_joints(joint):
    env = MMCReachEnv(perturbations=LockedJoint(joint))
    for seed in range(200):
        target = env.reset(seed=seed)[1]["target"]
        nodes = node_positions(segments_from_joint_angles(joint_angles(env), (1.0,) * 3))
        start, elbow, hand = np.delete(nodes, joint, axis=0)  # the joints that are free, and it
        upper, lower = np.linalg.norm(elbow - start), np.linalg.norm(hand - elbow)
        distance = np.linalg.norm(target - start)
        assert abs(upper - lower) - 1e-8 <= distance <= upper + lower + 1e-8
        assert np.linalg.norm(target) <= 3 + 1e-8


@pytest.mark.parametrize(("name", "step"), [("locked", 0), ("locks", 10)])
def test_a_joint_locks_at_its_time_and_for_the_episode(name, step, engine):
    env = MMCReachEnv(perturbations=name, engine=engine)
    moved = []
    for seed in range(5):
        angles = movement(env, seed, steps=40).joint_angles[:, 1]
        assert np.abs(wrap_angle(angles[step:] - angles[step])).max() < 0.02
        moved.append(np.abs(wrap_angle(angles[: step + 1] - angles[0])).max())
    assert (max(moved) > 0.2) == (step > 0)


def observed(perturbation):
    """Observations (4000, 15) of an arm at rest, and where targets and hands are seen (4000, 4)."""
    env = MMCReachEnv(control="joint_torque", perturbations=[perturbation])
    env.reset(seed=0, options={"joint_angles": [0.3, 0.5, -0.4], "target": (-1.0, 1.5)})
    no_action = np.zeros(3, np.float32)
    observations = np.array([env.step(no_action)[0] for _ in range(4000)], np.float64)
    shown = ReachInterface.of(env).see(observations)
    return observations, np.hstack([shown.target, shown.hand]), env.arm.end_effector


def assert_white(errors, std):
    """Zero mean, the stated spread, and no memory, within four standard errors."""
    count = len(errors)
    assert np.abs(errors.mean(axis=0)).max() < 4 * std / math.sqrt(count)
    np.testing.assert_allclose(errors.std(axis=0), std, rtol=4 / math.sqrt(2 * count))
    correlation = (errors[1:] * errors[:-1]).mean(axis=0) / std**2
    assert np.abs(correlation).max() < 4 / math.sqrt(count)


def test_noise_is_as_large_as_stated_and_white():
    observations, places, _ = observed("joint-noise-0.03")
    errors = np.arctan2(observations[:, 3:6], observations[:, :3]) - (0.3, 0.5, -0.4)
    assert_white(errors, 0.03)
    assert_white(observations[:, 6:9] * math.tau, 0.3)
    np.testing.assert_allclose(places, places[:1].repeat(4000, 0), atol=2e-6)
    assert np.abs(np.corrcoef(errors.T)[np.triu_indices(3, 1)]).max() < 0.07
    observations, both, hand = observed("vision-noise-0.05")
    assert_white(both - (-1.0, 1.5, *hand), 0.05)
    assert np.abs(np.corrcoef(both.T)[np.triu_indices(4, 1)]).max() < 0.07
    np.testing.assert_allclose(observations[:, :9], observations[:1, :9].repeat(4000, 0), atol=1e-6)


@pytest.mark.parametrize(("speed", "distance"), [(0.0, 0.0), (1.5, 1.0), (-3.0, 2.5)])
def test_joint_noise_grows_with_speed_and_vision_noise_with_distance(speed, distance):
    changes = "joint-noise-0.01", "joint-noise-speed-0.02"
    changes += "vision-noise-0.01", "vision-noise-distance-0.05"
    setup, count = MMCReachEnv(perturbations=changes).setup, 5000
    still, hands = np.zeros((count, 3)), np.zeros((count, 2))
    true = Seen(still, hands + np.array([0.0, distance]), still + speed, hands)
    arms, indices = setup.first.arms.rows(np.zeros(count, int)), np.arange(count)
    noise = Noise(count, 3, setup.layout.size, setup.touched)
    noise.begin(indices, arms)
    randoms = [np.random.default_rng(seed) for seed in range(count)]
    noise.draw(indices, 0 * indices, randoms)
    senses = Senses(
        count, 3, setup.layout.limits, setup.limits.delays, setup.touched, setup.control_step
    )
    seen, _ = senses.sense(indices, 0 * indices, true, arms, noise, hands)
    of_joints, of_sight = math.hypot(0.01, 0.02 * speed), math.hypot(0.01, 0.05 * distance)
    for errors, std in (
        (seen.joint_angles, of_joints),
        (seen.joint_speeds - speed, 10 * of_joints),
        (seen.hand, of_sight),
        (seen.target - (0.0, distance), of_sight),
    ):
        np.testing.assert_allclose(errors.std(axis=0), std, rtol=0.05)


@pytest.mark.parametrize("name", ["joint-noise", "vision-noise", "delay-100", "vision-delay-100"])
def test_noise_and_delay_change_neither_reward_nor_info(name):
    disturbed, plain = MMCReachEnv(perturbations=name), MMCReachEnv()
    for env in (disturbed, plain):
        env.reset(seed=0)
    for action in random_actions(plain, 50, hold=5):
        seen, known = disturbed.step(action), plain.step(action)
        assert not np.array_equal(seen[0], known[0])
        assert seen[1] == known[1]
        assert all(np.array_equal(seen[4][key], known[4][key]) for key in known[4])


@pytest.mark.parametrize(("name", "steps"), [("delay-40", 2), (["delay-40", "delay-200"], 12)])
def test_delay_is_gymnasiums_once_it_is_over_and_shows_the_start_before(name, steps):
    late = MMCReachEnv(perturbations=name)
    wrapped = gym.wrappers.DelayObservation(MMCReachEnv(), delay=steps)
    for seed in range(2):  # the second episode remembers nothing of the first
        start = MMCReachEnv().reset(seed=seed)[0]
        assert np.array_equal(late.reset(seed=seed)[0], start)
        wrapped.reset(seed=seed)
        for step, action in enumerate(random_actions(late, 40, seed, hold=5), start=1):
            seen, shown = late.step(action)[0], wrapped.step(action)[0]
            assert np.array_equal(seen, shown if step > steps else start)


def test_late_sight_shows_hand_and_target_late_and_the_joints_on_time():
    env, steps = MMCReachEnv(task="pursuit", perturbations="vision-delay-60"), 3
    observation, info = env.reset(seed=0)
    places = [(info["target"], info["end_effector"])] * (steps + 1)
    interface = ReachInterface.of(env)
    for action in random_actions(env, 20, hold=5):
        observation, _, _, _, info = env.step(action)
        places = [*places[1:], (info["target"], info["end_effector"])]
        seen = interface.see(observation)
        np.testing.assert_allclose((seen.target, seen.hand), places[0], atol=1e-6)
        assert np.abs(wrap_angle(seen.joint_angles - joint_angles(env))).max() < 1e-6
        np.testing.assert_allclose(seen.joint_speeds, env.arm.joint_velocities, atol=1e-5)


def turned(z, degrees):
    return np.exp(1j * math.radians(degrees)) * z


@pytest.mark.parametrize(
    ("task", "perturbations", "centre", "expected"),  # of a hand at z, and a share of 0.4 s
    [
        ("random", "rotation-40", 0j, lambda z, _: turned(z, 40)),
        ("random", VisuomotorRotation(30.0, centre=(0.0, 1.5)), 1.5j, lambda z, _: turned(z, 30)),
        # Around the point where all movements start.
        ("centre-out", "gain-1.4-over-0.4", 1.5j, lambda z, share: (1 + 0.4 * share) * z),
        ("centre-out", "rotation-60-over-0.4", 1.5j, lambda z, share: turned(z, 60 * share)),
        (
            *("centre-out", ["rotation-40", "rotation--80-at-0.4"], 1.5j),
            lambda z, share: turned(z, -40 if share == 1 else 40),
        ),
        ("centre-out", "mirror-at-0.4", 1.5j, lambda z, s: -z.conjugate() if s == 1 else z),
        ("centre-out", ["mirror-30", "rotation-20"], 1.5j, lambda z, _: turned(z.conjugate(), 80)),
    ],
)
def test_cursors_grow_add_up_and_are_seen_and_rewarded(task, perturbations, centre, expected):
    """And copies continue."""
    env = MMCReachEnv(task=task, perturbations=perturbations, precision_weight=0, control_weight=0)
    limits = env.setup.layout.limits[11:13]
    for seed in range(2):
        env.reset(seed=seed)
        for step, action in enumerate(random_actions(env, 40, seed, hold=5), start=1):
            other = copy.deepcopy(env)
            observation, reward, _, _, info = env.step(action)
            assert np.array_equal(other.step(action)[0], observation)
            hand, cursor = (complex(*info[name]) for name in ("end_effector", "cursor"))
            assert cursor - centre == pytest.approx(expected(hand - centre, min(step / 20, 1)))
            way = complex(*info["target"]) - cursor
            assert -reward == info["distance"] == pytest.approx(abs(way))
            offset = turned(way, -math.degrees(joint_angles(env)[0]))
            seen = np.clip([offset.real, offset.imag], -limits, limits)
            np.testing.assert_allclose(observation[11:13], seen, atol=1e-6)
            turn = env.cursor
            assert turn.hand(*info["cursor"]) == pytest.approx(tuple(info["end_effector"]))


@pytest.mark.parametrize(
    "name", ["force-field", "hand-mass", "rotation", "mirror", "clamp", "vision-noise", "delay"]
)
def test_what_begins_at_the_start_is_always_there_and_what_begins_later_is_not(name, engine):
    change = parse_change(name)
    always, timed, later, never = (
        MMCReachEnv(perturbations=changes, engine=engine, control="joint_torque")
        for changes in ([change], [Timed(change)], [Timed(change, at=0.2)], [])
    )
    plain = name not in ("vision-noise", "clamp")  # no noise is drawn, no cursor shown without
    for seed in range(2):
        for env in (always, timed, later, never):
            env.reset(seed=seed, options={"target": (1.0, 1.0)})
        for step, action in enumerate(random_actions(never, 20, seed, hold=5), start=1):
            seen = [env.step(action)[0] for env in (always, timed, later, never)]
            assert np.array_equal(seen[0], seen[1])
            if plain and step < 10:
                np.testing.assert_allclose(seen[2], seen[3], atol=1e-6)
        assert not np.array_equal(seen[2], seen[3])


@pytest.mark.parametrize(
    ("names", "seen_at"),
    [("no-feedback", []), ("no-feedback-at-0.1", [1, 2, 3, 4]), ("endpoint-feedback", None)],
)
def test_a_hidden_hand_repeats_where_it_was_last_seen(names, seen_at):
    env = MMCReachEnv(task="centre-out", perturbations=[names, "rotation-20"])
    interface, agent, state = ReachInterface.of(env), make_agent("mmc", env), None
    observation, info = env.reset(seed=0, options={"trial": 1})
    hand, sightings, fastest = info["end_effector"], [], 0.0
    assert info["is_hand_seen"]
    last = info["cursor"]
    for step in range(1, 61):
        action, state = agent.predict(observation, state, np.array([step == 1]))
        observation, *_, info = env.step(action)
        speed, hand = math.dist(info["end_effector"], hand), info["end_effector"]
        fastest = max(fastest, speed)
        if info["is_hand_seen"]:
            last = info["cursor"]
            sightings.append(step)
            assert seen_at or speed < 0.05 * fastest
        np.testing.assert_allclose(interface.see(observation).hand, last, atol=1e-6)
        assert info["distance"] == pytest.approx(math.dist(info["cursor"], info["target"]))
    assert len(sightings) == 1 if seen_at is None else sightings == seen_at


def test_the_target_is_in_reach_all_the_time():
    changes = (CursorMirror(60.0, centre=(0.5, 1.0), at=1), CursorGain(2.0, over=1))
    env = MMCReachEnv(perturbations=(*changes, "locked-2", "obstacles-1"))
    for seed in range(100):
        target, posture = env.reset(seed=seed)[1]["target"], env.arm.joint_angles
        workspace = Workspace(env.episode.body, None, (1,))
        for step in range(0, 101, 5):
            arms = env.setup.episodes.arms(env.episode.numbers[None], step)
            cursor = Cursor.of(arms, env.setup.episodes.touched).row(0)
            assert cursor.at(*cursor.hand(*target), target) == pytest.approx(tuple(target))
            assert workspace.contains(cursor.hand(*target), posture)


def offsets(perturbation, trial):
    """Offsets of hand and cursor from the start, and of the target, in a centre-out trial."""
    env = MMCReachEnv(task="centre-out", perturbations=[perturbation])
    episode = movement(env, steps=40, options={"trial": trial})
    places = episode.hands, episode.cursors, episode.targets[0]
    return [place - episode.hands[0] for place in places]


@pytest.mark.parametrize("trial", [0, 3])
def test_a_clamped_cursor_keeps_its_direction_and_follows_the_hand_in_distance(trial):
    hands, cursors, target = offsets("clamp-20", trial)
    assert np.hypot(*cursors.T) == pytest.approx(np.hypot(*hands.T))
    turns = (cursors @ (target[0] - 1j * target[1], target[1] + 1j * target[0]))[5:]
    assert np.degrees(np.angle(turns)) == pytest.approx(20.0)


def test_a_cursor_jumps_to_the_left_once_the_hand_has_made_a_share_of_the_way():
    hands, cursors, target = offsets("cursor-jump-10", 3)
    has_jumped = hands @ target >= 0.25 * target @ target
    assert 0 < has_jumped.sum() < len(hands)
    left = 0.1 * np.array([-target[1], target[0]])
    np.testing.assert_allclose(cursors - hands, np.outer(has_jumped, left), atol=1e-9)
    # At a target that waits at the start it stays there.
    for change, cursor in (("clamp-15", (0.0, 1.5)), (CursorJump(10.0, share=0.2), (1.0, 1.0))):
        env = MMCReachEnv(task="centre-out", perturbations=change)
        assert env.cursor.at(1.0, 1.0, (0.0, 1.5)) == cursor


def clearance(env):
    """Least distance between the surfaces of arms and obstacles; negative: how deep they are in."""
    body = env.setup.first.body
    angles = joint_angles(env) if isinstance(env, MMCReachEnv) else env.arms.joint_angles
    nodes = node_positions(segments_from_joint_angles(angles, body.segment_lengths))
    shares = np.linspace(0, 1, 101)[:, None]
    rods = nodes[..., :-1, None, :] + shares * np.diff(nodes, axis=-2)[..., None, :]
    return min(
        float(np.linalg.norm(rods - (x, y), axis=-1).min() - radius - body.segment_radius)
        for x, y, radius in body.obstacles
    )


@pytest.mark.parametrize("control", by_night(CONTROLS[1:], daily=["joint_delta"]))
@pytest.mark.parametrize("discs", ["obstacles-4", Obstacles(((0, 2.2, 1.0),))])
def test_segments_sink_no_deeper_into_obstacles_than_stated(control, discs):
    env = MMCReachVectorEnv(32, control=control, perturbations=discs)
    random, deepest = np.random.default_rng(0), 0.0
    env.reset(seed=0)
    for _ in range(30):
        actions = np.sign(random.uniform(-1, 1, (32, 3))).astype(np.float32)
        for _ in range(8):
            env.step(actions)
            deepest = max(deepest, -clearance(env))
    assert 0.01 < deepest < 0.07


def test_starts_and_targets_are_clear_of_obstacles():
    env = MMCReachEnv(perturbations="obstacles")
    env.reset(seed=0)
    for _ in range(200):
        target = env.reset()[1]["target"]
        assert clearance(env) > 0
        for x, y, radius in env.episode.body.obstacles:
            assert math.dist(target, (x, y)) > radius
    for options in ({"target": (1.5, 1.0)}, {"joint_angles": [math.atan2(1.0, 1.5), 0.0, 0.0]}):
        with pytest.raises(ValueError, match="clear of the obstacles"):
            env.reset(options=options)


@pytest.mark.parametrize(
    ("perturbations", "joint_limits"),
    [
        ([LockedJoint(0), LockedJoint(1), LockedJoint(2), "longer-50"], None),
        ([LockedJoint(0), LockedJoint(2), "shorter-50", "obstacles-4"], None),
        ([LockedJoint(1), "longer-50", "rotation-45"], ((0.0, 0.1), (-0.5, 0.5), (-2.5, 2.5))),
        # Few postures are clear of the disc.
        (["shorter-50", Obstacles(((1.7, 0.45, 0.3),))], ((0.0, 0.3), (-0.2, 0.2), (-0.2, 0.2))),
    ],
)
@pytest.mark.parametrize("task", ["random", "via-points"])
def test_what_can_be_made_can_be_reset_with_any_seed(perturbations, joint_limits, task):
    arm = {"task": task, "perturbations": perturbations, "joint_limits": joint_limits}
    env, vector = MMCReachEnv(**arm), MMCReachVectorEnv(**arm)
    for seed in range(30):
        observation, info = env.reset(seed=seed)
        assert env.observation_space.contains(observation)
        assert env.episode.workspace.contains(info["target"], env.arm.joint_angles)
        np.testing.assert_array_equal(vector.reset(seed=seed)[0][0], observation)


def test_a_posture_whose_locks_leave_no_target_is_refused_unless_there_is_one_already():
    env = MMCReachEnv(perturbations=[LockedJoint(1), LockedJoint(2), "longer-50"])
    env.reset(seed=0)
    state, stretched = env.np_random.bit_generator.state, [1.0, 0.0, 0.0]
    message = r"joint_angles'\] must be a posture with a target in reach"
    with pytest.raises(UserError, match=message):
        env.reset(seed=1, options={"joint_angles": stretched})
    assert env.np_random.bit_generator.state == state
    env.reset(seed=1, options={"joint_angles": stretched, "target": (1.0, 2.0)})
    assert env.arm.joint_angles == pytest.approx(stretched)


@pytest.mark.parametrize("known", ["", "-known"])
@pytest.mark.parametrize("length", ["longer-50", "shorter-50"])
@pytest.mark.parametrize("task", ["random", "pursuit"])
def test_goals_of_an_arm_of_another_length_are_in_their_space(length, known, task):
    changes = [f"{length}{known}", "rotation-45"]
    arguments = {"segment_lengths": (1.0, 0.4), "perturbations": changes}
    env = MMCReachGoalVectorEnv(5, task=task, **arguments)
    action = np.full(env.action_space.shape, 0.7, np.float32)
    assert env.observation_space.contains(env.reset(seed=0)[0])
    assert all(env.observation_space.contains(env.step(action)[0]) for _ in range(60))
