"""The agent with an internal model of its body: what each part finds out, and what all reach."""

import runpy
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmc_gym._errors import UserError
from mmc_gym.agents.body_model.agent import Parts, ik_body, mmc_body
from mmc_gym.agents.body_model.arm import command_of, commanded_turn, expected_turn
from mmc_gym.agents.body_model.body import BodyEvidence, Locks
from mmc_gym.agents.body_model.drive import Drive
from mmc_gym.agents.body_model.imagination import start_offsets
from mmc_gym.agents.body_model.obstacles import LONG, MOST, NOWHERE, RADIUS, SHORT, Contacts, room
from mmc_gym.agents.body_model.senses import Delay, PostureTrack, TargetTrack
from mmc_gym.envs.perturbations import VisuomotorRotation
from mmc_gym.interface import ReachInterface
from mmc_gym.measures import episode_seeds, run_episodes
from mmc_gym.measures.speed import minimum_jerk_correlation, velocity_peaks

KNOWN_BODY = Path(__file__).parents[2] / "studies" / "body_model" / "known_body.py"
STEP = 0.02
ARMS = 20
INTERFACE = ReachInterface((1.0, 1.0, 1.0), "joint_position", 6.0, 12.0, STEP)


def postures(looks: int, seed: int = 0) -> np.ndarray:
    """Arms that move from somewhere by small steps, (looks, ARMS, 3)."""
    random = np.random.default_rng(seed)
    start, velocity = random.uniform(-3, 3, (2, ARMS, 3))
    return start + 0.05 * np.arange(looks)[:, None, None] * velocity


def believed(lengths, angle, shift, looks, noise=0.0):
    """The body that arms of this kind believe in after some looks at their hand."""
    random, evidence = np.random.default_rng(1), BodyEvidence.start((1.0, 1.0, 1.0), ARMS)
    for joint_angles in postures(looks):
        felt = (np.array(lengths) * np.exp(1j * np.cumsum(joint_angles, axis=-1))).sum(axis=-1)
        normals = random.standard_normal((2, ARMS))
        seen = np.exp(1j * angle) * felt + shift + noise * (normals[0] + 1j * normals[1])
        evidence = evidence.observed(joint_angles, seen)
    return evidence.best


@pytest.mark.parametrize(
    ("lengths", "angle", "shift", "looks"),
    [
        ((1.0, 1.0, 1.0), 0.0, 0.0, 1),
        ((1.0, 1.0, 1.0), 0.5, 0.0, 2),
        ((1.0, 1.0, 1.5), 0.0, 0.0, 3),
        ((1.2, 0.8, 1.3), 0.0, 0.0, 15),
        ((1.0, 1.0, 1.4), -0.7, 0.0, 15),
        ((1.0, 1.0, 1.0), 0.6, 0.4 - 0.8j, 10),
    ],
    ids=["as told", "turned", "longer", "all lengths", "turned and longer", "another centre"],
)
def test_the_body_is_found_from_hand_and_posture(lengths, angle, shift, looks):
    body = believed(lengths, angle, shift, looks)
    is_right = np.abs(body.lengths - lengths).max(axis=-1) < 0.02
    is_right &= np.abs(body.turn - np.exp(1j * angle)) < 0.02
    is_right &= np.abs(body.shift - shift) < 0.05
    assert is_right.mean() >= 0.9


def test_noise_is_not_taken_for_another_body():
    body = believed((1.0, 1.0, 1.0), 0.0, 0.0, 50, noise=0.1)
    assert (body.lengths == 1.0).all() and (body.turn == 1.0).all()
    assert (np.abs(body.shift) < 0.05).all()


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_posture_and_its_noise_are_estimated(noise):
    random = np.random.default_rng(2)
    path = postures(80)
    speeds = (path[1] - path[0]) / STEP
    seen = path + noise * random.standard_normal(path.shape)
    track = PostureTrack.start(seen[0], speeds)
    for joint_angles in seen[1:]:
        track = track.observed(joint_angles, speeds, STEP)
    assert np.median(track.deviation) == pytest.approx(noise, rel=0.3, abs=1e-9)
    error = np.abs(track.joint_angles - path[-1])
    assert np.median(error) <= 0.5 * noise + 1e-9


def test_a_moving_target_is_foreseen_and_a_jump_is_followed_at_once():
    times = STEP * np.arange(40)
    path = np.exp(2j * times) + 0.5 * times
    track = TargetTrack.start(path[:1])
    for place in path[1:30]:
        track = track.observed(np.array([place]), STEP)
    assert track.is_moving.all()
    assert abs(track.ahead(np.array([5.0]))[0] - path[34]) < 0.01
    track = track.observed(path[30:31] + 1.0, STEP)
    assert track.has_jumped.all()
    assert track.ahead(np.zeros(1))[0] == path[30] + 1.0


def test_a_target_that_stands_is_averaged():
    random, track = np.random.default_rng(3), TargetTrack.start(np.full(ARMS, 1.0 + 1.0j))
    for _ in range(100):
        normals = random.standard_normal((2, ARMS))
        track = track.observed(1.0 + 1.0j + 0.1 * (normals[0] + 1j * normals[1]), STEP)
    assert np.median(np.abs(track.ahead(np.zeros(ARMS)) - (1.0 + 1.0j))) < 0.03


def test_first_looks_that_agree_by_chance_are_outweighed_by_later_ones():
    random, track = np.random.default_rng(3), TargetTrack.start(np.full(ARMS, 0.1 + 0.0j))
    for look in range(100):
        normals = random.standard_normal((2, ARMS)) if look > 4 else np.array([[1.0], [0.0]])
        track = track.observed(0.1 * (normals[0] + 1j * normals[1]) * np.ones(ARMS), STEP)
    assert np.median(np.abs(track.ahead(np.zeros(ARMS)))) < 0.03


@pytest.mark.parametrize("noise", [0.0, 0.5], ids=["exact", "noisy speeds"])
@pytest.mark.parametrize("late", [0, 7])
def test_delay_is_the_time_until_a_movement_is_felt(late, noise):
    still = np.zeros((1, 3))
    posture, delay = PostureTrack.start(still, still + noise), Delay.start(still)
    for look in range(12):
        delay = delay.sent(posture.joint_angles + 1.0, posture, INTERFACE)
        turn = 3.0 * (look >= late)  # what is late stays as it was, with its noise
        before, speeds = posture, still + (turn or noise)
        posture = before.observed(before.seen + STEP * turn, speeds, STEP)
        delay = delay.observed(before, posture)
    assert delay.late == late


def test_a_lock_is_found_and_a_false_one_freed():
    still = np.zeros((1, 3))
    asked, is_felt = np.array([[0.1, 0.1, 0.0]]), np.array([True])
    second = np.array([[0.0, 1.0, 0.0]])
    posture, locks = PostureTrack.start(still, still), Locks.start(still)
    for _ in range(8):  # the first joint is held, the second turns as asked
        turned = posture.joint_angles + 0.1 * second
        posture = posture.observed(turned, 5.0 * second, STEP)
        locks = locks.observed(posture, asked, is_felt)
    assert locks.is_locked.tolist() == [[True, False, False]]
    for _ in range(3):
        posture = posture.observed(posture.joint_angles + 0.1, still + 5.0, STEP)
        locks = locks.observed(posture, asked, is_felt)
    assert not locks.is_locked.any()


def test_a_joint_told_to_lock_is_found_sooner():
    first, asked, steps = np.array([[1.0, 0.0, 0.0]]), np.full((1, 3), 0.05), []
    for lockable in ((1,), ()):
        posture, step = PostureTrack.start(*np.zeros((2, 1, 3))), 0
        locks = Locks.start(posture.joint_angles)
        while not locks.is_locked.any():
            step += 1
            turned = posture.joint_angles + 0.1 * first
            posture = posture.observed(turned, 5.0 * first, STEP)
            locks = locks.observed(posture, asked, np.array([True]), lockable=lockable)
        assert locks.is_locked[0, 1]
        steps.append(step)
    assert steps[0] < steps[1] < 20


def posture_of(joint_angles, turn):
    return PostureTrack.start(joint_angles, turn / STEP)._replace(turn=turn)


HELD = np.array([[0.05, 0.0, -0.25]])
"""Turn about the middle of the last of three segments: 2.5 · 0.05 − 0.5 · 0.25 = 0."""


def touched(contacts, joint_angles, turn, asked, before=None):
    """The memory after an arm of three unit segments, asked for one turn, makes another."""
    before = posture_of(joint_angles, turn if before is None else before)
    posture = posture_of(joint_angles, turn)
    return contacts.observed(before, posture, asked, np.ones((1, 3)), np.array([True]))


@pytest.mark.parametrize(("speed", "steps"), [(0.1, SHORT), (0.0, LONG)])
def test_a_contact_is_felt_where_the_arm_cannot_go_on(speed, steps):
    """The arm turns about the middle of its last segment, which is held up from above.

    It is felt sooner if the arm struck what holds it.
    """
    joint_angles, asked = np.zeros((1, 3)), np.array([[0.1, 0.0, 0.0]])
    contacts = touched(Contacts.start(1, 3), joint_angles, HELD, asked, np.eye(3)[:1] * speed)
    looks = 1
    while not contacts.met.any():
        contacts = touched(contacts, joint_angles, HELD, asked)
        looks += 1
    assert looks == steps
    assert abs(contacts.discs[0, 0] - (2.5 + 1j * RADIUS)) < 0.05


def test_many_contacts_with_one_obstacle_leave_room_for_others():
    contacts, asked = Contacts.start(1, 3), np.array([[0.1, 0.0, 0.0]])
    for bearing in [0.0] * MOST + [2.0]:
        joint_angles, is_felt = np.array([[bearing, 0.0, 0.0]]), False
        while not is_felt:
            contacts = touched(contacts, joint_angles, HELD, asked)
            is_felt = contacts.is_new.all()
    obstacles = (2.5 + 1j * RADIUS) * np.exp(1j * np.array([0.0, 2.0]))
    np.testing.assert_allclose(contacts.discs[0, :2], obstacles, atol=0.05)
    assert (contacts.discs[0, 2:] == NOWHERE).all()


def test_a_load_that_gathers_speed_is_no_contact():
    asked, contacts, joint_angles = np.full((1, 3), 0.1), Contacts.start(1, 3), np.zeros((1, 3))
    turns = 0.1 * np.linspace(0, 1, 50)[:, None, None]
    for before, turn in pairwise(np.broadcast_to(turns, (50, 1, 3))):
        joint_angles = joint_angles + turn
        contacts = touched(contacts, joint_angles, turn, asked, before)
    assert not contacts.met.any()


def test_a_movement_through_a_disc_is_not_free_and_one_round_it_is():
    start, end, discs = np.zeros(3), np.array([1.5, 0.0, 0.0]), np.array([2.0 + 1.5j])
    lengths, folded = np.ones(3), np.array([0.0, 2.0, 2.0])

    def spare(begin, goal):
        return room(INTERFACE, begin, goal, lengths, discs)[0]

    assert spare(start, end) < 0 < spare(start, -end)
    assert spare(folded, folded + end) > 0


def test_the_drive_inverts_the_servo():
    now, turn = np.zeros((1, 3)), np.array([[0.01, -0.05, 0.1]])
    left = 10 * turn
    targets, _ = Drive.start(1, 3).targets(now, turn, left, np.zeros((1, 1)), INTERFACE)
    np.testing.assert_allclose(expected_turn(INTERFACE, now, targets), turn, rtol=1e-6)


@pytest.mark.parametrize("control", ["joint_position", "joint_delta", "joint_velocity"])
def test_the_servo_model_foretells_where_the_joints_are(control):
    env = gym.make("MMCReach-v0", control=control)
    interface = ReachInterface.of(env)
    observation, _ = env.reset(seed=3, options={"joint_angles": [0.3, 0.6, 0.6]})
    goal = np.array([0.8, 0.1, 1.0])
    foretold = np.array([0.3, 0.6, 0.6])
    for _ in range(40):
        sensed = interface.sense(observation)
        foretold = foretold + expected_turn(interface, foretold, goal)
        observation, *_ = env.step(interface.act(goal, sensed))
    now = interface.sense(observation).joint_angles
    np.testing.assert_allclose(now, foretold, atol=0.02)


@pytest.mark.parametrize("control", ["joint_delta", "joint_velocity"])
def test_a_relative_command_turns_a_joint_alike_wherever_it_is(control):
    interface = replace(INTERFACE, control=control)
    believed, goal = np.array([0.1, -0.4, 0.0]), np.array([0.3, -1.5, 0.0])
    command = command_of(interface, believed, goal)
    turns = [commanded_turn(interface, believed + error, command) for error in (0.0, 0.2)]
    np.testing.assert_array_equal(*turns)
    np.testing.assert_allclose(turns[0], expected_turn(interface, believed, goal))


@pytest.mark.parametrize("control", ["joint_position", "joint_delta", "joint_velocity"])
def test_an_old_posture_is_run_forward_with_the_commands_since(control):
    interface, random = replace(INTERFACE, control=control), np.random.default_rng(0)
    now = random.uniform(-1, 1, (3, 3))
    track = PostureTrack.start(now, np.zeros((3, 3)))
    delay, path = Delay.start(command_of(interface, now, now)), [now]
    for _ in range(10):
        command = command_of(interface, path[-1], random.uniform(-1, 1, (3, 3)))
        delay = delay.sent(command, track, interface)
        path.append(path[-1] + commanded_turn(interface, path[-1], command))
    steps = np.array([0, 4, 10])
    old = np.stack([path[10 - late][arm] for arm, late in enumerate(steps)])
    delay = delay._replace(late=steps.astype(float))
    np.testing.assert_allclose(delay.run_forward(interface, old), path[10], atol=1e-12)


@pytest.mark.parametrize(("joints", "count"), [(2, 9), (3, 27), (10, 27)])
def test_as_many_postures_are_imagined_for_long_arms(joints, count):
    offsets = start_offsets(joints)
    assert offsets.shape == (count, joints)
    assert not offsets[0].any()


def test_vigour_lies_between_0_and_1():
    with pytest.raises(UserError, match="vigour"):
        Parts(vigour=1.5)


def episodes(build, count=100, id="MMCReach-v0", **arguments):
    envs = gym.make_vec(id, num_envs=count, control="joint_position", **arguments)
    agent = build(ReachInterface.of(envs))
    return list(run_episodes(agent, envs.unwrapped, episode_seeds(4, count), records_effort=False))


@settings(max_examples=20)
@given(st.integers(2, 5), st.integers(0, 2**31), st.sampled_from([mmc_body, ik_body]))
def test_actions_are_valid_whatever_is_observed(count, seed, build):
    env = gym.make("MMCReach-v0", segment_lengths=(1.0,) * count)
    agent, random, state = build(ReachInterface.of(env)), np.random.default_rng(seed), None
    for _ in range(30):
        observation = random.uniform(-1, 1, 3 * count + 6).astype(np.float32)
        if random.random() < 0.2:
            observation[:] = 0.0
        action, state = agent.predict(observation, state)
        assert env.action_space.contains(action)


def success(played):
    return np.mean([episode.distances[-1] <= episode.tolerance for episode in played])


@cache
def movement(parts, perturbations=(), control="joint_position"):
    """Actions of an agent of these parts, (steps, arms, 3), and where 10 arms end."""
    options = {"control": control, "perturbations": perturbations, "engine": "analytic"}
    envs = gym.make_vec("MMCReach-v0", 10, **options)
    agent, state = ik_body(ReachInterface.of(envs), parts), None
    observations, actions = envs.reset(seed=2)[0], []
    for _ in range(80):
        action, state = agent.predict(observations, state)
        observations, *_, infos = envs.step(action)
        actions.append(action)
    return np.array(actions), infos["distance"]


@pytest.mark.parametrize("control", ["joint_position", "joint_delta"])
@pytest.mark.parametrize(
    ("part", "others", "tolerance"),
    [
        # Filters take for noise what the model of the servos leaves out.
        ("filters", ("delay-200", "rotation-30"), 0.1),
        ("bridges_delay", ("rotation-30", "locks-2"), 0.0),
        ("identifies_body", ("delay-200", "locks-2"), 0.0),
        ("finds_locks", ("delay-200", "rotation-30"), 0.0),
        ("avoids", ("rotation-30", "longer-20"), 0.0),
    ],
)
def test_a_part_that_is_off_changes_nothing_where_it_has_nothing_to_do(
    part, others, tolerance, control
):
    for perturbations in ((), others):
        actions, _ = movement(Parts(), perturbations, control)
        without, _ = movement(Parts(**{part: False}), perturbations, control)
        assert np.abs(actions - without).max() <= tolerance, perturbations


@pytest.mark.parametrize("part", ["filters", "imagines", "drives"])
def test_targets_are_reached_without_a_part_that_nothing_calls_for(part):
    for control in ("joint_position", "joint_delta"):
        assert (movement(Parts(**{part: False}), control=control)[1] < 0.02).all()


@pytest.mark.slow
@pytest.mark.parametrize("build", [mmc_body, ik_body])
def test_a_body_that_is_not_as_told_is_found_out_about(build):
    conditions = (
        [],
        ["rotation-60"],
        ["shorter-50"],
        ["locked-2"],
        ["vision-noise-0.1"],
        ["delay-400"],
        ["force-field"],
        ["hand-mass", "joint-noise"],
        [VisuomotorRotation(40.0, (0.5, 1.0)), "longer-20"],
    )
    for perturbations in conditions:
        assert success(episodes(build, perturbations=perturbations)) >= 0.95, perturbations


@pytest.mark.slow
@pytest.mark.skipif(not KNOWN_BODY.is_file(), reason="the benchmarks are not here")
@pytest.mark.parametrize("perturbations", ["locks-1", "locks-2", ["rotation-30", "delay-200"]])
def test_nothing_is_lost_by_having_to_find_out_about_the_body(perturbations):
    told_the_truth = runpy.run_path(str(KNOWN_BODY))["KnownBody"]
    envs = gym.make_vec(
        "MMCReach-v0", num_envs=100, control="joint_position", perturbations=perturbations
    )
    seeds = episode_seeds(4, 100)
    told = run_episodes(told_the_truth(envs), envs.unwrapped, seeds, records_effort=False)
    assert success(episodes(mmc_body, perturbations=perturbations)) >= success(told) - 0.02


@pytest.mark.slow
@pytest.mark.parametrize("build", [mmc_body, ik_body])
def test_arms_of_many_segments_reach_as_well(build):
    assert success(episodes(build, segment_lengths=(1.0,) * 10)) >= 0.98


@pytest.mark.slow
@pytest.mark.parametrize("build", [mmc_body, ik_body])
def test_targets_that_jump_or_move_and_goal_observations(build):
    assert success(episodes(build, task="double-step-200")) >= 0.97
    assert success(episodes(build, id="MMCReachGoal-v0", perturbations="longer-20")) >= 0.97
    pursued = episodes(build, 20, id="MMCReachPursuit-v0")
    distances = [episode.distances[50:] for episode in pursued]
    assert np.mean(np.array(distances) <= 0.05) >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    "perturbations",
    [[], "joint-noise", "vision-noise", "longer-50", "rotation-30", "delay-200", "force-field"],
)
def test_a_joint_that_is_free_is_seldom_taken_as_locked(perturbations):
    envs = gym.make_vec("MMCReach-v0", num_envs=50, perturbations=perturbations)
    agent, (observations, _), state = mmc_body(ReachInterface.of(envs)), envs.reset(seed=1), None
    for _ in range(60):
        actions, state = agent.predict(observations, state)
        observations, *_ = envs.step(actions)
    assert state.locks.is_locked.any(axis=-1).mean() <= 0.04


@pytest.mark.slow
def test_ways_round_obstacles_are_found():
    with_and_without = [
        success(
            episodes(lambda told, parts=parts: mmc_body(told, parts), perturbations="obstacles-4")
        )
        for parts in (Parts(), Parts(avoids=False))
    ]
    assert with_and_without[0] >= with_and_without[1] + 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("perturbations", "single_peaks"),
    [([], 0.95), ("rotation-60", 0.95), ("delay-200", 0.95), ("locked-2", 0.6)],
)
def test_without_vigour_the_hand_moves_as_people_do(perturbations, single_peaks):
    played = episodes(lambda told: mmc_body(told, Parts(vigour=0.0)), perturbations=perturbations)
    assert success(played) >= 0.99
    assert np.median([minimum_jerk_correlation(one) for one in played]) >= 0.95
    assert np.mean([velocity_peaks(one) == 1 for one in played]) >= single_peaks


@pytest.mark.slow
def test_without_vigour_a_target_that_moves_is_followed_nevertheless():
    pursued = episodes(lambda told: mmc_body(told, Parts(vigour=0.0)), 20, id="MMCReachPursuit-v0")
    distances = [episode.distances[75:] for episode in pursued]
    assert np.mean(np.array(distances) <= 0.05) >= 0.9
