"""Arms of hinges in space, and the network that settles on their poses."""

from dataclasses import replace

import numpy as np
import pytest

from mmc_gym import HingeArm, HingeNetwork, UserError

ROBOTS = ("panda", "ur5", "iiwa")
PANDA = HingeArm.named("panda")
POSTURE = np.array([0.3, 0.4, -0.2, -1.8, 0.5, 1.6, 0.1])
SHIPPED = {
    "panda": ("franka_panda/panda.urdf", "panda_link0", "panda_link8"),
    "iiwa": ("kuka_iiwa/model.urdf", "lbr_iiwa_link_0", "lbr_iiwa_link_7"),
}
EXACT = 1e-6, 1e-6
ODD = """<robot name="odd">
  <link name="a"/><link name="b"/><link name="c"/><link name="d"/><link name="e"/>
  <joint name="one" type="revolute"><parent link="a"/><child link="b"/>
    <origin xyz="0.1 -0.2 0.3" rpy="0.3 -0.4 0.5"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-1" upper="2" effort="1" velocity="1"/></joint>
  <joint name="two" type="fixed"><parent link="b"/><child link="c"/>
    <origin xyz="0.2 0.1 0" rpy="1 0 0"/></joint>
  <joint name="three" type="continuous"><parent link="c"/><child link="d"/>
    <origin xyz="0 0.4 0.1" rpy="0 0.7 0.1"/><axis xyz="1 0 0"/></joint>
  <joint name="four" type="{kind}"><parent link="d"/><child link="e"/>
    <origin xyz="0.3 0 0" rpy="0 0 1.2"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
</robot>"""


def postures(arm, count, seed=3):
    return np.random.default_rng(seed).uniform(*arm.limits.T, (count, arm.joint_count))


def test_a_file_gives_the_poses_that_its_parser_gives(tmp_path):
    yourdfpy = pytest.importorskip("yourdfpy", reason='it takes the extra "urdf"')
    path = tmp_path / "odd.urdf"
    path.write_text(ODD.format(kind="revolute"))
    arm = HingeArm.from_urdf(path, base="a", tip="e")
    robot = yourdfpy.URDF.load(str(path))
    for angles in np.random.default_rng(0).uniform(-1, 2, (5, 3)):
        robot.update_cfg(angles)
        np.testing.assert_allclose(arm.forward(angles), robot.get_transform("e", "a"), atol=1e-12)
    assert arm.limits.tolist() == [[-1, 2], [-np.inf, np.inf], [-2, 2]]
    assert arm.joint_names == ("one", "three", "four")


@pytest.mark.parametrize(
    ("before", "after", "named"),
    [
        ("{kind}", "planar", "joint 'four' of line 10 .*'planar'"),
        ("<limit", "<mimic joint='one'/><limit", "'one' of line 3 .*<mimic>"),
        ('xyz="0.1 -0.2', "xyz=0.1 -0.2", "XML: .*line 4"),
        ("0.1 -0.2 0.3", "0.1 0.2", "joint 'one' of line 3"),
        ("0.1 -0.2 0.3", "nan 0 0", "'one' of line 3 .*<origin>"),
        ("0 0.6 0.8", "0 0 0", "joint 'one' of line 3 .*<axis>"),
        ('lower="-1"', "", "joint 'one' of line 3 .*<limit>"),
        ('lower="-1"', 'lower="3"', "'one' of line 3 .*limits .*3 and 2"),
        ('<parent link="a"/>', "", "joint 'one' of line 3 .*<parent link"),
        ('<link name="a"/>', "", "base 'a' is not accepted"),
        ('<link name="e"/>', "", "tip 'e' is not accepted"),
        ('<parent link="c"/>', '<parent link="e"/>', "joint 'four' of line 10 .*circle"),
        ('<child link="c"/>', '<child link="b"/>', "'b' .*'one' .*'two'"),
        ('<parent link="a"/>', '<parent link="z"/>', "base 'a', .*'z'"),
        ("<robot", '<!DOCTYPE r [<!ENTITY x "y">]><robot', "DOCTYPE"),
        ("robot", "sdf", "<robot>"),
    ],
)
def test_a_file_that_describes_no_arm_of_hinges_is_refused(before, after, named, tmp_path):
    pytest.importorskip("yourdfpy", reason='it takes the extra "urdf"')
    path, text = tmp_path / "odd.urdf", ODD.replace(before, after, -1 if before == "robot" else 1)
    path.write_text(text.replace("{kind}", "revolute"))
    with pytest.raises(UserError, match=named):
        HingeArm.from_urdf(path, base="a", tip="e")


def test_what_lies_beside_the_chain_may_slide_or_close_a_circle(tmp_path):
    pytest.importorskip("yourdfpy", reason='it takes the extra "urdf"')
    path = tmp_path / "odd.urdf"
    path.write_text(ODD.format(kind="prismatic"))
    assert HingeArm.from_urdf(path, base="a", tip="d").joint_count == 2
    with pytest.raises(UserError, match="between base 'b' and tip 'c' must be a hinge"):
        HingeArm.from_urdf(path, base="b", tip="c")
    ring = '<joint name="up" type="fixed"><parent link="e"/><child link="a"/></joint></robot>'
    path.write_text(ODD.format(kind="revolute").replace("</robot>", ring))
    assert HingeArm.from_urdf(path, base="a", tip="e").joint_count == 3


@pytest.mark.slow  # loads robots in pybullet
@pytest.mark.parametrize("name", SHIPPED)
def test_tables_agree_with_pybullet_in_both_directions(name):
    """Its forward kinematics puts the hand where ours does, and where the network wanted it."""
    bullet = pytest.importorskip("pybullet")
    folder = pytest.importorskip("pybullet_data").getDataPath()
    file, _, tip = SHIPPED[name]
    client = bullet.connect(bullet.DIRECT)
    body = bullet.loadURDF(f"{folder}/{file}", useFixedBase=True, physicsClientId=client)
    infos = [bullet.getJointInfo(body, j, client) for j in range(bullet.getNumJoints(body, client))]
    link = [info[12].decode() for info in infos].index(tip)
    arm = HingeArm.named(name)

    def bullet_pose(angles):
        for joint, angle in enumerate(angles):
            bullet.resetJointState(body, joint, angle, physicsClientId=client)
        state = bullet.getLinkState(body, link, computeForwardKinematics=1, physicsClientId=client)
        pose = np.eye(4)
        pose[:3, 3] = state[4]
        pose[:3, :3] = np.reshape(bullet.getMatrixFromQuaternion(state[5]), (3, 3))
        return pose

    angles = postures(arm, 20)
    poses = np.array([bullet_pose(each) for each in angles])
    np.testing.assert_allclose(arm.forward(angles), poses, atol=1e-6)
    ends = HingeNetwork(arm).solve(poses[:, :3, 3], poses[:, :3, :3], tolerance=EXACT).joint_angles
    np.testing.assert_allclose([bullet_pose(each) for each in ends], poses, atol=1e-5)
    bullet.disconnect(client)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_rule_makes_a_robot_a_chain_of_three_rigid_segments(name):
    arm = HingeArm.named(name)
    segments = np.linalg.norm(np.diff(arm.nodes(postures(arm, 50)), axis=1), axis=-1)
    assert segments.shape == (50, 3)
    assert segments.min() > 0.05
    np.testing.assert_allclose(segments, np.broadcast_to(segments[0], (50, 3)), atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_it_finds_random_poses_within_the_limits(name):
    arm = HingeArm.named(name)
    poses = arm.forward(postures(arm, 200))
    network = HingeNetwork(arm)
    solution = network.solve(poses[:, :3, 3], poses[:, :3, :3], tolerance=EXACT)
    assert solution.is_solved.all()
    np.testing.assert_allclose(arm.forward(solution.joint_angles), poses, atol=2e-5)
    low, high = arm.limits.T
    assert ((solution.joint_angles >= low) & (solution.joint_angles <= high)).all()


def planar(joints):
    points = np.linspace(0, 1, joints, endpoint=False)[:, None] * [1, 0, 0]
    home = np.eye(4) + np.eye(4, k=3)
    return HingeArm(np.tile([0, 0, 1], (joints, 1)), points, home, np.tile([-3, 3], (joints, 1)))


def resized(by):
    home = PANDA.home.copy()
    home[:3, 3] *= by
    return replace(PANDA, points=by * PANDA.points, home=home)


@pytest.mark.parametrize("arm", [*map(planar, (1, 2, 3, 4, 6)), *map(resized, (0.1, 50.0))])
def test_an_arm_in_the_plane_or_of_any_size_finds_its_poses(arm):
    poses = arm.forward(postures(arm, 100))
    assert HingeNetwork(arm).solve(poses[:, :3, 3]).is_solved.all()
    assert HingeNetwork(arm).solve(poses[:, :3, 3], poses[:, :3, :3]).is_solved.all()


@pytest.mark.parametrize("free", [(), (3,), (1, 3), (1, 3, 5)])
def test_a_robot_with_few_free_joints_finds_its_poses_and_none_is_the_forward_task(free):
    angles = postures(PANDA, 100)
    poses, held = PANDA.forward(angles), {i: angles[:, i] for i in range(7) if i not in free}
    solution = HingeNetwork(PANDA).solve(poses[:, :3, 3], poses[:, :3, :3], held=held)
    assert solution.is_solved.all()
    np.testing.assert_array_equal(solution.joint_angles[:, list(held)], angles[:, list(held)])


def test_the_hand_and_the_elbow_are_at_points_with_a_joint_locked_by_its_name():
    nodes, network = PANDA.nodes(POSTURE), HingeNetwork(PANDA)
    task = {"position": nodes[-1], "points": {1: nodes[1]}, "held": {"panda_joint6": 1.6}}
    solution = network.solve(**task, tolerance=EXACT)
    assert solution.is_solved
    np.testing.assert_allclose(PANDA.nodes(solution.joint_angles)[[1, 3]], nodes[[1, 3]], atol=1e-5)
    assert solution.joint_angles[5] == 1.6


def test_a_target_out_of_reach_gives_the_stretched_arm():
    arm = HingeArm.named("ur5")
    solution = HingeNetwork(arm).solve([3.0, 0.0, 0.089159], starts=16)
    assert not solution.is_solved
    hand = arm.forward(solution.joint_angles)[:3, 3]
    reach = 0.425 + 0.39225 + np.hypot(0.0823, 0.09465)
    assert np.linalg.norm(hand - [0, 0, 0.089159]) > reach - 0.02
    assert np.abs(hand[1:] - [0.0, 0.089159]).max() < 0.05


@pytest.mark.parametrize("name", ROBOTS)
def test_a_path_is_followed_without_a_jump(name):
    """A warm start stays in its posture, where the nearest of many others would win a race."""
    arm = HingeArm.named(name)
    network = HingeNetwork(arm)
    times = np.linspace(0.0, np.pi, 100)[:, None]
    middle = np.array([0.3, 0.4, -0.5, -1.2, 0.5, 1.2, 0.1])[: arm.joint_count]
    path = middle + 0.4 * np.sin(times * np.arange(1, arm.joint_count + 1) / 2)
    now = path[0]
    for pose in arm.forward(path[1:]):
        solution = network.solve(pose[:3, 3], pose[:3, :3], start=now)
        assert solution.is_solved
        assert np.abs(solution.joint_angles - now).max() < 0.15
        now = solution.joint_angles


def test_no_joint_turns_by_a_whole_turn_more_than_its_limits_require():
    arm = HingeArm.named("ur5")
    poses, start = arm.forward(postures(arm, 50)), postures(arm, 50, seed=4)
    solved = HingeNetwork(arm).solve(poses[:, :3, 3], poses[:, :3, :3], start=start).joint_angles
    for turned in (solved - 2 * np.pi, solved + 2 * np.pi):
        is_farther = np.abs(turned - start) > np.abs(solved - start) - 1e-9
        assert (is_farther | (turned < arm.limits[:, 0]) | (turned > arm.limits[:, 1])).all()


def test_one_start_is_no_other():
    away = PANDA.forward(-POSTURE)[:3, 3]
    network = HingeNetwork(PANDA)
    alone = network.solve(away, start=POSTURE, starts=1).joint_angles
    start, clamps = network.state(POSTURE), network.clamp(away)
    path = [network.run(start, clamps, iterations).joint_angles for iterations in range(151)]
    assert any(np.array_equal(alone, posture) for posture in path)


def test_batches_are_solved_as_their_tasks_alone():
    network = HingeNetwork(PANDA)
    poses = PANDA.forward(postures(PANDA, 6)).reshape(2, 3, 4, 4)
    held = {0: np.array([[0.1], [-0.4]])}
    together = network.solve(poses[..., :3, 3], held=held)
    assert together.joint_angles.shape == (2, 3, 7)
    alone = network.solve(poses[1, 2, :3, 3], held={0: -0.4})
    assert alone.joint_angles.tolist() == together.joint_angles[1, 2].tolist()


def test_a_rotation_in_single_precision_and_the_limits_themselves_are_accepted():
    turns = PANDA.forward(postures(PANDA, 500))[:, :3, :3].astype(np.float32)
    assert HingeNetwork(PANDA).clamp(rotation=turns).tasks.shape == (500,)
    assert HingeNetwork(PANDA).clamp(rotation=turns[:0]).tasks.shape == (0,)
    assert HingeNetwork(PANDA).clamp(held={3: PANDA.limits[3]}).tasks.shape == (2,)


MIRRORED = np.diag([1.0, 1.0, -1.0])
TURNS = np.array([[np.eye(3)] * 3, [MIRRORED, np.eye(3), MIRRORED]])


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda n: n.solve([1.0, 2.0]), r"position .* \(..., 3\)"),
        (lambda n: n.solve([np.nan, 0, 0]), "position .* finite"),
        (lambda n: n.solve(rotation=np.eye(4)), r"rotation .* \(..., 3, 3\)"),
        (lambda n: n.solve(rotation=np.zeros((3, 3))), "off by 1 and has the determinant 0"),
        (lambda n: n.solve(rotation=MIRRORED), "off by 0 and has the determinant -1"),
        (lambda n: n.solve(rotation=np.eye(3) * (1 + 1e-3)), "off by 0.002 .* determinant 1"),
        (lambda n: n.clamp(rotation=TURNS), r"rotation\[1, 0\] is off by 0"),
        (lambda n: n.solve(held={7: 0.0}), "joint 7 .*panda_joint7 or an index from 0 to 6"),
        (lambda n: n.solve(held={"joint2": 0.0}), "did you mean 'panda_joint2'"),
        (lambda n: n.solve(held={1: 0.0, "panda_joint2": 0.1}), "held .* different joints"),
        (
            lambda n: n.clamp(held={3: [-1, 0.5]}),
            "limits of 'panda_joint4', -3.0718 to -0.0698",
        ),
        (lambda n: n.clamp(held={3: PANDA.limits[3, 1] + 1e-6}), "held .* limits"),
        (lambda n: n.solve(points={0: [0, 0, 0]}), "node 0"),
        (lambda n: n.solve(start=np.full(7, np.nan)), "start .* finite"),
        (lambda n: n.solve(np.zeros((2, 3)), start=np.zeros((3, 7))), "start .* batch axes"),
        (lambda n: n.solve(start=np.zeros(6)), r"start .* \(..., 7\)"),
        (lambda n: HingeNetwork(PANDA, damping=1.5), "damping .* more than"),
        (lambda n: replace(PANDA, limits=PANDA.limits[:, ::-1]), "limits .* pairs"),
        (lambda n: replace(PANDA, points=PANDA.points[1:]), r"points .* \(7, 3\)"),
        (lambda n: replace(PANDA, points=np.full((7, 3), np.inf)), "points"),
        (lambda n: replace(PANDA, home=np.diag([1, 1, -1, 1])), "home .* rotation.*determinant -1"),
        (lambda n: replace(PANDA, home=np.diag([1, 1, 1, 2])), "home .* pose"),
        (lambda n: replace(PANDA, joint_names=("a",) * 7), "joint_names .* 7 different names"),
        (lambda n: HingeArm.named("pandas"), "did you mean 'panda'"),
    ],
)
def test_a_task_that_does_not_fit_and_what_is_no_arm_or_network_are_refused(call, named):
    with np.errstate(invalid="ignore"), pytest.raises(UserError, match=named):
        call(HingeNetwork(PANDA))
