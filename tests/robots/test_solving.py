"""What a robot is asked to do: whole turns, mistakes, rotations, tools, directions, postures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from mmc_gym import HingeArm, HingeNetwork, UserError

UR5, PANDA = HingeArm.named("ur5"), HingeArm.named("panda")
ENDLESS = replace(UR5, limits=np.tile([-np.inf, np.inf], (6, 1)))


def poses_of(arm, count, seed=7):
    low, high = np.clip(arm.limits, -np.pi, np.pi).T
    return arm.forward(np.random.default_rng(seed).uniform(low, high, (count, len(low))))


def is_nearest_turn(angles, reference, arm):
    """Return whether a whole turn more or less leads farther away, or beyond the limits."""
    turned = angles + 2 * np.pi * np.array([-1, 1])[:, None, None]
    is_farther = np.abs(turned - reference) > np.abs(angles - reference) - 1e-9
    return (is_farther | (turned < arm.limits[:, 0]) | (turned > arm.limits[:, 1])).all(axis=0)


@pytest.mark.parametrize("arm", [UR5, PANDA, ENDLESS, replace(UR5, limits=UR5.limits + 1)])
@pytest.mark.parametrize("has_rotation", [True, False])
def test_without_a_start_joints_take_the_turn_nearest_to_the_middle(arm, has_rotation):
    poses = poses_of(arm, 60)
    rotation = poses[:, :3, :3] if has_rotation else None
    solution = HingeNetwork(arm).solve(poses[:, :3, 3], rotation)
    middle = np.where(np.isinf(arm.limits), 0, arm.limits).mean(axis=1)
    assert solution.is_solved.all()
    assert is_nearest_turn(solution.joint_angles, middle, arm).all()
    low, high = arm.limits.T
    assert ((low <= solution.joint_angles) & (solution.joint_angles <= high)).all()
    hand = arm.forward(solution.joint_angles)[:, :3, 3]
    np.testing.assert_allclose(hand, poses[:, :3, 3], atol=1e-3)


def test_a_robot_of_two_turns_stays_within_half_a_turn():
    angles = HingeNetwork(UR5).solve([0.3, 0.2, 0.4]).joint_angles
    assert np.abs(angles).max() <= np.pi


@pytest.mark.parametrize("endless", [1e9, 1e16, 1e100, 1e308])
def test_limits_that_stand_for_endless_are_none(endless):
    arm = replace(UR5, limits=np.tile([-endless, endless], (6, 1)))
    assert np.isinf(arm.limits).all()
    poses = poses_of(arm, 20)
    solution = HingeNetwork(arm).solve(poses[:, :3, 3], poses[:, :3, :3])
    assert solution.is_solved.all()
    assert np.abs(solution.joint_angles).max() <= np.pi


def test_a_joint_may_have_a_limit_on_one_side():
    arm = replace(UR5, limits=[[2, np.inf], [-np.inf, -5], *UR5.limits[2:]])
    poses = poses_of(UR5, 20)
    solution = HingeNetwork(arm).solve(poses[:, :3, 3], poses[:, :3, :3])
    assert solution.is_solved.all()
    first, second = solution.joint_angles[:, :2].T
    assert ((first >= 2) & (first <= 2 + 2 * np.pi)).all()
    assert ((second <= -5) & (second >= -5 - 2 * np.pi)).all()


def test_a_lock_that_single_precision_puts_beyond_its_limit_is_at_the_limit():
    network = HingeNetwork(PANDA)
    for joint, limits in enumerate(PANDA.limits):
        for limit in limits:
            measured = np.nextafter(np.float32(limit), np.float32(10 * limit))
            solution = network.solve(held={joint: float(measured)})
            assert abs(solution.joint_angles[joint] - limit) < 1e-6
            assert PANDA.limits[joint, 0] <= solution.joint_angles[joint] <= PANDA.limits[joint, 1]


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ({"tolerance": 1e-4}, "tolerance must be two .* m and .* radians, got 0.0001"),
        ({"tolerance": (1e-4,)}, r"tolerance must be two .* got \(0.0001,\)"),
        ({"tolerance": (1e-4, 0)}, "tolerance must be two positive"),
        ({"tolerance": None}, "tolerance must be two .* got None"),
        ({"held": [0]}, r"held must be a mapping of joints, .* to angles, got \[0\]"),
        ({"held": 3}, "held must be a mapping"),
        ({"points": [[0, 0, 1]]}, "points must be a mapping of nodes"),
        ({"held": {0: 2.89735}}, "within the limits of 'panda_joint1', -2.8973 to 2.8973 rad"),
        ({"seed": -1}, "seed must be a whole number of at least 0, got -1"),
        ({"seed": None}, "seed must be a whole number of at least 0, got None"),
        ({"seed": "x"}, "seed must be a whole number of at least 0, got 'x'"),
        ({"starts": None}, "starts must be a whole number of at least 1, got None"),
        ({"starts": "x"}, "starts must be a whole number of at least 1, got 'x'"),
        ({"iterations": 0}, "iterations must be a whole number of at least 1"),
        ({"position": None}, "solve must be given a task: .*position"),
    ],
)
def test_a_mistake_is_named_with_what_is_accepted(task, message):
    with pytest.raises(UserError, match=message):
        HingeNetwork(PANDA).solve(**{"position": [0.4, 0.2, 0.5], **task})


def test_rotations_that_are_rounded_count_as_the_nearest():
    poses = poses_of(PANDA, 50)
    turns = poses[:, :3, :3].round(4)
    solution = HingeNetwork(PANDA).solve(poses[:, :3, 3], turns, tolerance=(1e-6, 1e-6))
    assert solution.is_solved.all()
    reached = PANDA.forward(solution.joint_angles)[:, :3, :3]
    # The nearest rotation R to a matrix A makes Rᵀ A symmetric.
    product = np.swapaxes(reached, -1, -2) @ turns
    np.testing.assert_allclose(product, np.swapaxes(product, -1, -2), atol=5e-6)
    np.testing.assert_allclose(reached, poses[:, :3, :3], atol=2e-4)


def test_a_product_of_a_hundred_rotations_in_single_precision_is_a_rotation():
    step = PANDA.forward([0.1, 0.2, 0.3, -1, 0.2, 1, 0.3])[:3, :3].astype(np.float32)
    turn = np.eye(3, dtype=np.float32)
    for _ in range(100):
        turn = turn @ step * np.float32(1 + 1e-7)
    network = HingeNetwork(PANDA)
    assert network.clamp(rotation=turn).hold.has_rotation
    home = PANDA.home.round(6) + 1e-4 * np.eye(4, k=1) * (np.arange(4)[:, None] < 2)
    assert np.allclose(replace(PANDA, home=home).home, PANDA.home, atol=2e-4)


@pytest.mark.parametrize("matrix", [1.01 * np.eye(3), np.eye(3) + 0.01 * np.eye(3, k=1)])
def test_a_matrix_that_is_no_rotation_is_refused(matrix):
    with pytest.raises(UserError, match=r"rotation, orthogonal within 0\.001 .* off by 0\.0"):
        HingeNetwork(PANDA).solve(rotation=matrix)


def forward(arm, angles):
    """Return the pose of the hand by matrix exponentials, without the package."""
    pose = np.eye(4)
    for axis, point, angle in zip(arm.axes, arm.points, angles):
        twist = np.zeros((4, 4))
        twist[:3, :3] = np.cross(np.eye(3), axis)
        twist[:3, 3] = -np.cross(axis, point)
        pose = pose @ expm(angle * twist)
    return pose @ arm.home


def angle_between(turn, other):
    return np.arccos(np.clip((np.trace(turn.T @ other) - 1) / 2, -1, 1))


@pytest.mark.parametrize("arm", [UR5, PANDA, ENDLESS])
def test_the_jacobian_is_that_of_finite_differences(arm):
    for angles in np.random.default_rng(2).uniform(-2, 2, (5, arm.joint_count)):
        pose, jacobian = forward(arm, angles), arm.jacobian(angles)
        np.testing.assert_allclose(arm.forward(angles), pose, atol=1e-12)
        for joint, nudge in enumerate(1e-6 * np.eye(arm.joint_count)):
            rate = (forward(arm, angles + nudge) - forward(arm, angles - nudge)) / 2e-6
            spin = rate[:3, :3] @ pose[:3, :3].T
            turning = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
            np.testing.assert_allclose(jacobian[:, joint], [*rate[:3, 3], *turning], atol=1e-8)
    batch = np.zeros((2, 3, arm.joint_count))
    assert arm.jacobian(batch).shape == (2, 3, 6, arm.joint_count)


def test_a_rotation_may_be_a_matrix_a_quaternion_or_of_scipy_and_a_pose_is_whole():
    network, poses = HingeNetwork(PANDA), poses_of(PANDA, 6)
    turns, places = Rotation.from_matrix(poses[:, :3, :3]), poses[:, :3, 3]
    expected = network.clamp(places, poses[:, :3, :3]).tasks
    quaternions = turns.as_quat()
    tasks = [network.clamp(places, kind).tasks for kind in (turns, quaternions, -quaternions)]
    tasks.append(network.clamp(pose=poses).tasks)
    tasks.append(network.clamp(places.reshape(2, 3, 3), quaternions.reshape(2, 3, 4)).tasks.ravel())
    for name in expected.dtype.names:
        for task in tasks:
            np.testing.assert_allclose(task[name], expected[name], atol=1e-14)
    single = network.solve(places[0], turns[0], tolerance=(1e-6, 1e-6))
    assert single.is_solved.shape == ()
    np.testing.assert_allclose(forward(PANDA, single.joint_angles), poses[0], atol=2e-6)


@pytest.mark.parametrize("arm", [UR5, PANDA])
@pytest.mark.parametrize("has_pose", [True, False])
def test_a_tool_is_where_the_hand_would_be(arm, has_pose):
    tool = np.eye(4)
    tool[:3, :3] = Rotation.from_rotvec([0.3, -0.5, 1.0]).as_matrix()
    tool[:3, 3] = 0.05, -0.1, 0.2
    poses = poses_of(arm, 20) @ tool
    network, tolerance = HingeNetwork(arm), (1e-6, 1e-6)
    if has_pose:
        solution = network.solve(pose=poses, tool=tool, tolerance=tolerance)
    else:
        solution = network.solve(poses[:, :3, 3], tool=tool[:3, 3], tolerance=tolerance)
    assert solution.is_solved.all()
    for angles, pose in zip(solution.joint_angles, poses):
        reached = forward(arm, angles) @ tool
        np.testing.assert_allclose(reached[:3, 3], pose[:3, 3], atol=2e-6)
        assert not has_pose or angle_between(reached[:3, :3], pose[:3, :3]) < 2e-6


def test_a_tool_leaves_the_nodes_as_they_are():
    """The hand's own node may be held beside the tool, and the tool settles in `run`, too."""
    angles, tool = np.array([0.3, 0.4, -0.2, -1.8, 0.5, 1.6, 0.1]), [0.1, 0, 0.1]
    network, nodes, hand = HingeNetwork(PANDA), PANDA.nodes(angles), forward(PANDA, angles)
    tip = (hand @ [*tool, 1])[:3]
    points = {1: nodes[1], 3: nodes[3]}
    solution = network.solve(tip, points=points, tool=tool, tolerance=(1e-6, 1e-6))
    assert solution.is_solved
    np.testing.assert_allclose(PANDA.nodes(solution.joint_angles)[[1, 3]], nodes[[1, 3]], atol=1e-5)
    clamps = network.clamp(tip, tool=tool)
    settled = network.run(network.state(angles + 0.1), clamps, 300).joint_angles
    np.testing.assert_allclose((forward(PANDA, settled) @ [*tool, 1])[:3], tip, atol=1e-3)


def test_a_hand_beside_the_last_axis_may_be_held_together_with_its_tool():
    home = UR5.home.copy()
    home[:3, 3] += 0.1, 0.05, 0.02
    arm = replace(UR5, home=home)
    assert arm.joint_nodes[-1] < arm.node_count - 1
    hand = arm.forward([0.5, -1.2, 1.6, -0.7, 1.1, 0.4])
    tip = (hand @ [0.05, 0.1, 0.1, 1])[:3]
    solution = HingeNetwork(arm).solve(
        tip, points={4: hand[:3, 3]}, tool=[0.05, 0.1, 0.1], tolerance=(1e-6, 1e-6)
    )
    assert solution.is_solved
    reached = forward(arm, solution.joint_angles)
    np.testing.assert_allclose(reached[:3, 3], hand[:3, 3], atol=2e-6)
    np.testing.assert_allclose((reached @ [0.05, 0.1, 0.1, 1])[:3], tip, atol=2e-6)


@pytest.mark.parametrize("arm", [UR5, PANDA])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("has_tool", [True, False])
def test_one_axis_of_the_hand_points_in_a_direction(arm, axis, has_tool):
    tool = np.eye(4)
    if has_tool:
        tool[:3, :3] = Rotation.from_rotvec([0.3, -0.5, 1.0]).as_matrix()
        tool[:3, 3] = 0.05, -0.1, 0.2
    poses, column = poses_of(arm, 40) @ tool, "xyz".index(axis)
    directions = poses[:, :3, column]
    for bound in (1e-2, 1e-6):
        solution = HingeNetwork(arm).solve(
            poses[:, :3, 3],
            direction=3 * directions,
            axis=axis,
            tool=tool if has_tool else None,
            tolerance=(bound / 10, bound),
        )
        assert solution.is_solved.all()
        reached = np.array([forward(arm, angles) for angles in solution.joint_angles]) @ tool
        np.testing.assert_allclose(reached[:, :3, 3], poses[:, :3, 3], atol=bound)
        away = np.linalg.norm(np.cross(reached[:, :3, column], directions), axis=-1)
        np.testing.assert_allclose(away, solution.rotation_error, atol=1e-6)
        assert away.max() < 1.01 * bound
        assert ((reached[:, :3, column] * directions).sum(axis=-1) > 0).all()


def test_a_direction_leaves_the_turn_about_it_free():
    """Five joints of a UR5 reach any place in any direction that six do, not in any rotation."""
    poses = poses_of(UR5, 40)
    task = {"held": {5: 0.0}, "tolerance": (1e-4, 1e-3)}
    network = HingeNetwork(UR5)
    solution = network.solve(poses[:, :3, 3], direction=poses[:, :3, 2], **task)
    assert solution.is_solved.all()
    assert not network.solve(pose=poses, **task).is_solved.any()


EYE = np.eye(4)


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ({"rotation": [0, 0, 0, 2.0]}, "rotation must be a quaternion x, y, z, w of length 1"),
        ({"rotation": EYE}, r"rotation must be of shape \(..., 3, 3\)"),
        ({"rotation": "x"}, "rotation must be an array"),
        ({"rotation": EYE[:3, :3], "direction": [0, 0, 1]}, "direction must be without rotation"),
        ({"direction": [0, 0, 0]}, "direction must be other than zero"),
        ({"direction": [0, 0, 1], "axis": "w"}, "axis 'w' is not accepted"),
        ({"pose": EYE}, "pose must be without position"),
        ({"pose": 2 * EYE, "position": None}, "pose must be a pose"),
        ({"pose": EYE[:3, :3], "position": None}, r"pose must be of shape \(..., 4, 4\)"),
        ({"tool": [0, 0]}, r"tool must be of shape \(3,\) or \(4, 4\)"),
        ({"tool": [0, 0, np.inf]}, "tool must be finite"),
        ({"tool": np.diag([2, 1, 1, 1])}, "tool must be a rotation"),
    ],
)
def test_a_target_or_a_tool_that_does_not_fit_is_refused(task, message):
    with pytest.raises(UserError, match=message):
        HingeNetwork(PANDA).solve(**{"position": [0.4, 0.2, 0.5], **task})


SOLVABLE = np.array([0.5, -1.2, 1.6, -0.7, 1.1, 0.4])  # eight postures of a UR5 have its pose


def test_all_solutions_are_found_the_nearest_to_the_middle_first():
    pose = forward(UR5, SOLVABLE)
    solution = HingeNetwork(UR5).solve(pose=pose, solutions=10, tolerance=(1e-6, 1e-6))
    assert solution.is_solved.tolist() == [True] * 8 + [False] * 2
    assert np.isnan(solution.joint_angles[8:]).all()
    angles = solution.joint_angles[:8]
    for posture in angles:
        np.testing.assert_allclose(forward(UR5, posture), pose, atol=5e-6)
    apart = np.abs(angles[:, None] - angles[None]).max(axis=-1)
    assert (apart + np.eye(8) > 0.1).all()
    assert (np.diff(np.linalg.norm(angles, axis=-1)) >= 0).all()
    assert np.abs(angles - SOLVABLE).max(axis=-1).min() < 1e-4
    assert str(solution).startswith("8 of 10 solved; the worst misses by")


def test_of_all_solutions_the_nearest_to_what_is_preferred_wins():
    pose, network = forward(UR5, SOLVABLE), HingeNetwork(UR5)
    angles = network.solve(pose=pose, solutions=8, tolerance=(1e-6, 1e-6)).joint_angles
    turned = angles + 2 * np.pi * np.array([1, 0, 0, 0, 0, -1]) * np.sign(-angles[:, :1])
    turned = np.where((turned > UR5.limits[:, 0]) & (turned < UR5.limits[:, 1]), turned, angles)
    solution = network.solve(pose=pose, prefer=turned + 0.1, tolerance=(1e-6, 1e-6))
    np.testing.assert_allclose(solution.joint_angles, turned, atol=1e-4)


def test_a_preferred_posture_of_a_redundant_arm_is_nearer_than_one_that_is_followed():
    poses, rest = poses_of(PANDA, 30), PANDA.limits.mean(axis=1)
    network = HingeNetwork(PANDA)
    preferred = network.solve(pose=poses, prefer=rest)
    followed = network.solve(pose=poses, start=rest)
    assert preferred.is_solved.all()
    away = [np.linalg.norm(s.joint_angles - rest, axis=-1) for s in (preferred, followed)]
    assert (away[0] < away[1] + 0.1).all()
    assert away[0].mean() < 0.9 * away[1].mean()
    alone = network.solve(pose=poses[3], prefer=rest)
    np.testing.assert_array_equal(alone.joint_angles, preferred.joint_angles[3])


def test_solutions_of_a_batch_have_an_axis_and_out_of_reach_the_first_is_the_nearest():
    network, poses = HingeNetwork(PANDA), poses_of(PANDA, 6).reshape(2, 3, 4, 4)
    solution = network.solve(pose=poses, prefer=np.zeros(7), solutions=3)
    assert solution.joint_angles.shape == (2, 3, 3, 7)
    assert solution.is_solved.all()
    far = network.solve([0.4, 0.2, 1.5], solutions=2)
    assert not far.is_solved.any()
    assert abs(far.position_error[0] - network.solve([0.4, 0.2, 1.5]).position_error) < 1e-3
    assert np.isfinite(far.joint_angles).all(axis=-1).tolist() == [True, False]


def test_out_of_reach_starts_that_get_no_nearer_end_early():
    solution = HingeNetwork(PANDA).solve([0.4, 0.2, 1.5])
    assert not solution.is_solved
    assert solution.iterations < 256 * 50
    longer = HingeNetwork(PANDA).solve([0.4, 0.2, 1.5], start=solution.joint_angles, starts=1)
    assert solution.position_error - longer.position_error < 1e-6


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ({"solutions": 0}, "solutions must be a whole number of at least 1"),
        ({"solutions": 257}, "solutions must be at most 256"),
        ({"prefer": np.zeros(6)}, r"prefer must be of shape \(..., 7\)"),
        ({"prefer": np.zeros(7), "start": np.zeros(7)}, "start must be None beside prefer"),
        ({"solutions": 2, "start": np.zeros(7)}, "start must be None beside prefer or solutions"),
    ],
)
def test_what_is_preferred_has_to_fit(task, message):
    with pytest.raises(UserError, match=message):
        HingeNetwork(PANDA).solve([0.4, 0.2, 0.5], **task)


@pytest.mark.parametrize("kind", ["rotation", "direction"])
@pytest.mark.parametrize("bound", [1e-3, 1e-5])
@pytest.mark.parametrize("prefer", [None, np.zeros(6)])
def test_where_both_cannot_be_had_the_place_comes_first(kind, bound, prefer):
    """The rotation is then as near as the place leaves it: no small change is better."""
    arm = replace(UR5, limits=np.tile([-7, 7], (6, 1)))
    poses, count = poses_of(arm, 30), 5 if kind == "rotation" else 4
    held = dict.fromkeys(range(count, 6), 0.0)
    postures = np.random.default_rng(3).uniform(-np.pi, np.pi, (30, 6)) * (np.arange(6) < count)
    poses[:, :3, 3] = arm.forward(postures)[:, :3, 3]
    aim = {"rotation": poses[:, :3, :3], "direction": poses[:, :3, 2]}
    solution = HingeNetwork(arm).solve(
        poses[:, :3, 3], held=held, prefer=prefer, tolerance=(bound, bound), **{kind: aim[kind]}
    )
    assert not solution.is_solved.any()
    assert (solution.position_error < bound).mean() > 0.9
    assert np.median(solution.position_error) < 0.1 * bound
    slopes = []
    for angles, pose in zip(solution.joint_angles, poses):
        turn, jacobian = forward(arm, angles)[:3, :3], arm.jacobian(angles)[:, :count]
        vectors = turn.T if kind == "rotation" else turn.T[2:]
        targets = pose[:3, :3].T if kind == "rotation" else pose[:3, 2:3].T
        pull = jacobian[3:].T @ np.cross(vectors, targets).sum(axis=0)
        free = np.linalg.svd(jacobian[:3])[2][3:]
        slopes.append(np.abs(free @ pull).max())
    assert np.median(slopes) < 1e-3


def test_a_place_within_reach_is_met_whatever_the_rotation():
    postures = np.random.default_rng(1).uniform(*PANDA.limits.T, (60, 7))
    postures[:, [0, 2]] = 0.0  # the other five joints reach all places, but not any rotation there
    poses = PANDA.forward(postures)
    poses[:, :3, :3] = poses[::-1, :3, :3]
    solution = HingeNetwork(PANDA).solve(pose=poses, held={0: 0.0, 2: 0.0})
    assert not solution.is_solved.any()
    assert (solution.position_error < 1e-3).all()
