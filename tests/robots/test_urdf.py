"""What a URDF may have between base and tip, against forward kinematics written out here."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from mmc_gym import HingeArm, HingeNetwork, UserError

pytest.importorskip("yourdfpy", reason='it takes the extra "urdf"')
XACRO = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="a"/>
  {}
</robot>"""
# A body with two arms; `left` is held at 0.6, 0.3 is beside the chains.
TWO_ARMS = """<robot name="two">
  <link name="body"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="left"/>
  <link name="r1"/><link name="r2"/><link name="right"/><link name="head"/>
  <joint name="l_shoulder" type="revolute"><parent link="body"/><child link="l1"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.3 -0.4 0.5"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-1" upper="2"/></joint>
  <joint name="l_held" type="revolute"><parent link="l1"/><child link="l2"/>
    <origin xyz="0.2 0.1 0" rpy="1 0 0"/><axis xyz="3 0 4"/>
    <limit lower="0.6" upper="0.6"/></joint>
  <joint name="l_elbow" type="continuous"><parent link="l2"/><child link="l3"/>
    <origin xyz="0 0.4 0.1" rpy="0 0.7 0.1"/><axis xyz="1 0 0"/></joint>
  <joint name="l_wrist" type="fixed"><parent link="l3"/><child link="left"/>
    <origin xyz="0.3 0 0" rpy="0 0 1.2"/></joint>
  <joint name="r_shoulder" type="revolute"><parent link="body"/><child link="r1"/>
    <origin xyz="0.1 -0.2 0.3" rpy="-0.3 -0.4 -0.5"/><axis xyz="0 -1 0"/>
    <limit lower="-2" upper="1"/></joint>
  <joint name="r_elbow" type="revolute"><parent link="r1"/><child link="r2"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 1 0.5"/><limit lower="-2" upper="2"/></joint>
  <joint name="r_wrist" type="revolute"><parent link="r2"/><child link="right"/>
    <origin xyz="0.3 0 0.1" rpy="0.1 0.2 0.3"/><axis xyz="1 0 0"/><limit lower="-2" upper="2"/>
  </joint>
  <joint name="neck" type="floating"><parent link="body"/><child link="head"/></joint>
</robot>"""


LINKS = "".join(f'<link name="{link}"/>' for link in "abcdefgh")
# A SCARA: its last joint turns about the slide.
SCARA = f"""<robot name="scara">{LINKS}
  <joint name="shoulder" type="revolute"><parent link="a"/><child link="b"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 0 1"/><limit lower="-2.5" upper="2.5"/></joint>
  <joint name="elbow" type="revolute"><parent link="b"/><child link="c"/>
    <origin xyz="0.35 0 0"/><axis xyz="0 0 1"/><limit lower="-2.4" upper="2.4"/></joint>
  <joint name="quill" type="prismatic"><parent link="c"/><child link="d"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 0 2"/><limit lower="-0.2" upper="0.05"/></joint>
  <joint name="turn" type="continuous"><parent link="d"/><child link="e"/>
    <axis xyz="0 0 1"/></joint>
  <joint name="tool" type="fixed"><parent link="e"/><child link="h"/>
    <origin xyz="0.02 0 -0.1"/></joint>
</robot>"""
# Two joints follow two others, so that the hand stays level, but for 0.1; `stop` is held.
PALLETIZER = f"""<robot name="palletizer">{LINKS}
  <joint name="waist" type="revolute"><parent link="a"/><child link="b"/>
    <origin xyz="0 0 0.4"/><axis xyz="0 0 1"/><limit lower="-2.9" upper="2.9"/></joint>
  <joint name="upper" type="revolute"><parent link="b"/><child link="c"/>
    <origin xyz="0.2 0 0"/><axis xyz="0 1 0"/><limit lower="-0.7" upper="1.4"/></joint>
  <joint name="lower" type="revolute"><parent link="c"/><child link="d"/>
    <origin xyz="0 0 0.8"/><axis xyz="0 1 0"/><limit lower="-1.2" upper="1.2"/></joint>
  <joint name="level" type="revolute"><parent link="d"/><child link="e"/>
    <origin xyz="0.7 0 0"/><axis xyz="0 1 0"/><mimic joint="lower" multiplier="-1"/></joint>
  <joint name="level_too" type="revolute"><parent link="e"/><child link="f"/>
    <axis xyz="0 1 0"/><mimic joint="upper" multiplier="-1" offset="0.1"/></joint>
  <joint name="turn" type="revolute"><parent link="f"/><child link="g"/>
    <origin xyz="0.1 0 -0.1"/><axis xyz="0 0 1"/><limit lower="-3" upper="3"/></joint>
  <joint name="stop" type="prismatic"><parent link="g"/><child link="h"/>
    <axis xyz="0 3 4"/><limit lower="0.2" upper="0.2"/></joint>
</robot>"""
# Two slides on a hinge, the second shorter; a hinge and a nut that follow the first, as a screw.
TELESCOPE = f"""<robot name="telescope">{LINKS}
  <joint name="base" type="continuous"><parent link="a"/><child link="b"/>
    <origin rpy="0.2 0.1 0"/><axis xyz="0 0 1"/></joint>
  <joint name="pitch" type="revolute"><parent link="b"/><child link="c"/>
    <origin xyz="0 0 0.4"/><axis xyz="0 1 0"/><limit lower="-1.5" upper="0.5"/></joint>
  <joint name="out" type="prismatic"><parent link="c"/><child link="d"/>
    <origin xyz="0.5 0 0"/><axis xyz="1 0 0"/><limit lower="0" upper="0.4"/></joint>
  <joint name="further" type="prismatic"><parent link="d"/><child link="e"/>
    <origin xyz="0.1 0 0"/><axis xyz="1 0 0"/>
    <mimic joint="out" multiplier="0.8" offset="0.05"/></joint>
  <joint name="screw" type="revolute"><parent link="e"/><child link="f"/>
    <origin xyz="0.1 0 0.1"/><axis xyz="1 0 0.1"/>
    <mimic joint="further" multiplier="2.5" offset="-0.3"/></joint>
  <joint name="fan" type="revolute"><parent link="f"/><child link="h"/>
    <origin xyz="0 0.2 0"/><axis xyz="0 0 1"/><limit lower="-2" upper="2"/></joint>
</robot>"""


def rotation(axis, angle):
    """Rodrigues' formula, as a sum over the components of the axis."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    outer, cross = np.outer([x, y, z], [x, y, z]), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.cos(angle) * np.eye(3) + (1 - np.cos(angle)) * outer + np.sin(angle) * cross


def pose_between(text, base, tip, values):
    """The pose of `tip` seen from `base`: all links are placed from the root of the tree on.

    `values` are those of joints by name; of the others, the lower limit.
    """
    joints = {joint.get("name"): joint for joint in ElementTree.fromstring(text).iter("joint")}

    def numbers(joint, tag, name, default):
        element = joint.find(tag)
        words = default if element is None else element.get(name, default)
        return [float(word) for word in words.split()]

    def value(joint):
        if (mimic := joint.find("mimic")) is not None:
            ratio, offset = float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))
            return ratio * value(joints[mimic.get("joint")]) + offset
        return values.get(joint.get("name")) or numbers(joint, "limit", "lower", "0")[0]

    def placed(link):
        (joint,) = [j for j in joints.values() if j.find("child").get("link") == link] or [None]
        if joint is None:
            return np.eye(4)
        origin, motion = np.eye(4), np.eye(4)
        origin[:3, 3] = numbers(joint, "origin", "xyz", "0 0 0")
        roll, pitch, yaw = numbers(joint, "origin", "rpy", "0 0 0")
        about_z, about_y = rotation([0, 0, 1], yaw), rotation([0, 1, 0], pitch)
        origin[:3, :3] = about_z @ about_y @ rotation([1, 0, 0], roll)
        axis = numbers(joint, "axis", "xyz", "1 0 0")
        if joint.get("type") in ("revolute", "continuous"):
            motion[:3, :3] = rotation(axis, value(joint))
        if joint.get("type") == "prismatic":
            motion[:3, 3] = value(joint) * np.array(axis) / np.linalg.norm(axis)
        return placed(joint.find("parent").get("link")) @ origin @ motion

    return np.linalg.inv(placed(base)) @ placed(tip)


def read(tmp_path, text, base, tip):
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return HingeArm.from_urdf(path, base=base, tip=tip)


def check_poses(arm, text, base, tip):
    low, high = np.clip(arm.limits, -3, 3).T
    angles = np.random.default_rng(0).uniform(low, high, (20, arm.joint_count))
    expected = [pose_between(text, base, tip, dict(zip(arm.joint_names, row))) for row in angles]
    np.testing.assert_allclose(arm.forward(angles), expected, atol=1e-12)
    return angles, np.array(expected)


@pytest.mark.parametrize(
    ("base", "tip", "names"),
    [
        ("body", "left", ("l_shoulder", "l_elbow")),  # the joint between is held
        ("left", "body", ("l_elbow", "l_shoulder")),
        ("l2", "r2", ("l_shoulder", "r_shoulder", "r_elbow")),
        ("right", "left", ("r_wrist", "r_elbow", "r_shoulder", "l_shoulder", "l_elbow")),
    ],
)
def test_a_chain_may_lead_up_the_tree_and_equal_limits_hold_a_joint(base, tip, names, tmp_path):
    arm = read(tmp_path, TWO_ARMS, base, tip)
    assert arm.joint_names == names
    limits = {"l_shoulder": [-1, 2], "l_elbow": [-np.inf, np.inf], "r_shoulder": [-2, 1]}
    assert arm.limits.tolist() == [limits.get(name, [-2, 2]) for name in names]
    check_poses(arm, TWO_ARMS, base, tip)


CHAINS = [
    (SCARA, ["shoulder", "elbow", "quill", "turn"]),
    (PALLETIZER, ["waist", "upper", "lower", "turn"]),
    (TELESCOPE, ["base", "pitch", "out", "fan"]),
]


@pytest.mark.parametrize(("text", "names"), CHAINS, ids=["scara", "palletizer", "telescope"])
def test_slides_and_followers_put_the_hand_where_the_file_does(text, names, tmp_path):
    for base, tip, order in (("a", "h", names), ("h", "a", None)):
        arm = read(tmp_path, text, base, tip)
        assert sorted(arm.joint_names) == sorted(names)
        assert order is None or list(arm.joint_names) == order
        angles, _ = check_poses(arm, text, base, tip)
        assert not arm.has_only_hinges
        # The rule of the nodes: a hinge turns nothing of its node, and all that is beyond it.
        frames, least = arm.frames(angles), np.eye(arm.joint_count) * 1e-6
        for joint in range(arm.joint_count):
            moved = (arm.nodes(angles + least[joint]) - arm.nodes(angles - least[joint])) / 2e-6
            lever = np.zeros_like(moved)
            for axis, node in enumerate(arm.joint_nodes):
                if arm.axis_joints[axis] == joint:
                    along, beyond = frames.axes[:, axis, None], frames.nodes[:, node + 1 :]
                    turned = np.cross(along, beyond - frames.nodes[:, node, None])
                    slid = along if arm.is_slide[axis] else turned
                    lever[:, node + 1 :] += arm.ratios[axis] * slid
            np.testing.assert_allclose(lever, moved, atol=1e-8)


@pytest.mark.slow  # numba compiles for each
@pytest.mark.parametrize(("text", "names"), CHAINS, ids=["scara", "palletizer", "telescope"])
def test_slides_and_followers_find_their_poses_as_hinges_do(text, names, tmp_path):
    arm = read(tmp_path, text, "a", "h")
    angles, poses = check_poses(arm, text, "a", "h")
    network = HingeNetwork(arm)
    for rotation_of_hand in (None, poses[:, :3, :3]):
        solution = network.solve(poses[:, :3, 3], rotation_of_hand, tolerance=(1e-6, 1e-6))
        assert solution.is_solved.all()
        assert (solution.joint_angles >= arm.limits[:, 0]).all()
        assert (solution.joint_angles <= arm.limits[:, 1]).all()
        reached = arm.forward(solution.joint_angles)
        np.testing.assert_allclose(reached[:, :3, 3], poses[:, :3, 3], atol=2e-6)
    np.testing.assert_allclose(reached, poses, atol=2e-5)
    # Without Newton's method: the iteration itself settles from near, and stays there.
    start, clamps = network.state(angles + 0.01), network.clamp(poses[:, :3, 3], poses[:, :3, :3])
    settled = network.run(start, clamps, 2000).joint_angles
    np.testing.assert_allclose(arm.forward(settled), poses, atol=1e-3)
    held = {name: angles[:, joint] for joint, name in enumerate(names[:3])}
    last = network.solve(poses[:, :3, 3], poses[:, :3, :3], held=held)
    assert last.is_solved.all()
    np.testing.assert_array_equal(last.joint_angles[:, :3], angles[:, :3])


def test_slides_do_not_turn_back_and_do_not_go_beyond_what_is_out_of_reach(tmp_path):
    arm = read(
        tmp_path, SCARA.replace('lower="-0.2" upper="0.05"', 'lower="-8" upper="8"'), "a", "h"
    )
    network = HingeNetwork(arm)
    far = network.solve([0.4, 0.2, 7.5], start=[0, 0.5, 0, 0])
    assert far.is_solved
    assert far.joint_angles[2] == pytest.approx(7.3, abs=2e-3)
    beyond = network.solve([0.4, 0.2, 9.0], starts=16)
    assert not beyond.is_solved
    assert beyond.position_error == pytest.approx(0.8, abs=2e-3)


@pytest.mark.parametrize(("text", "names"), CHAINS, ids=["scara", "palletizer", "telescope"])
@pytest.mark.parametrize(("base", "tip"), [("a", "h"), ("h", "a")])
def test_the_jacobian_of_slides_and_followers_is_that_of_finite_differences(
    text, names, base, tip, tmp_path
):
    arm = read(tmp_path, text, base, tip)
    angles, poses = check_poses(arm, text, base, tip)
    jacobian = arm.jacobian(angles)
    assert jacobian.shape == (20, 6, len(names))
    for joint, nudge in enumerate(1e-6 * np.eye(arm.joint_count)):
        rate = (arm.forward(angles + nudge) - arm.forward(angles - nudge)) / 2e-6
        spin = rate[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
        turning = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
        moving = np.concatenate([rate[:, :3, 3], turning], axis=-1)
        np.testing.assert_allclose(jacobian[..., joint], moving, atol=1e-8)


def test_slides_and_followers_take_tools_directions_preferences_and_several_solutions(tmp_path):
    arm, tool, exact = read(tmp_path, TELESCOPE, "a", "h"), np.eye(4), (1e-6, 1e-6)
    tool[:3, :3], tool[:3, 3] = rotation([1, 2, 3], 0.8), [0.05, -0.1, 0.2]
    angles, poses = check_poses(arm, TELESCOPE, "a", "h")
    poses, network = poses @ tool, HingeNetwork(arm)
    places = poses[:, :3, 3]

    whole = network.solve(pose=poses, tool=tool, tolerance=exact)
    assert whole.is_solved.all()
    np.testing.assert_allclose(arm.forward(whole.joint_angles) @ tool, poses, atol=2e-5)

    aimed = network.solve(
        places, direction=poses[:, :3, 0], axis="x", tool=tool, tolerance=(1e-6, 1e-5)
    )
    assert aimed.is_solved.all()
    reached = arm.forward(aimed.joint_angles) @ tool
    np.testing.assert_allclose(reached[:, :3, 3], places, atol=2e-6)
    np.testing.assert_allclose(reached[:, :3, 0], poses[:, :3, 0], atol=2e-5)

    turned = angles + np.array([2 * np.pi, 0, 0, 0])  # the first joint is continuous
    preferred = network.solve(pose=poses, tool=tool, prefer=turned, tolerance=exact)
    np.testing.assert_allclose(preferred.joint_angles, turned, atol=1e-3)

    several = network.solve(places, tool=tool, solutions=3, prefer=angles, tolerance=exact)
    assert several.joint_angles.shape == (20, 3, 4)
    assert several.is_solved[:, 0].all()
    assert several.is_solved.mean() > 0.5
    far = np.linalg.norm(several.joint_angles - angles[:, None], axis=-1)
    assert (np.diff(np.where(several.is_solved, far, np.inf)[:, :2]) >= 0).all()
    reached = (arm.forward(several.joint_angles) @ tool)[..., :3, 3] - places[:, None]
    assert np.linalg.norm(reached, axis=-1)[several.is_solved].max() < 2e-6

    other = rotation([1, 1, 0], 1.0) @ poses[:, :3, :3]  # four joints do not have it there
    first = network.solve(places, other, tool=tool, tolerance=exact)
    assert not first.is_solved.any()
    assert np.median(first.position_error) < 1e-6


@pytest.mark.parametrize(
    ("text", "joint", "message"),
    [
        (SCARA, "quill", "within the limits of 'quill', -0.2 to 0.05 m, got 3"),
        (SCARA, "elbow", "within the limits of 'elbow', -2.4 to 2.4 rad, got 3"),
        (TELESCOPE, "out", "within the limits of 'out', 0 to 0.4 m or rad, got 3"),
    ],
)
def test_a_lock_beyond_the_limits_is_told_in_the_unit_of_the_joint(text, joint, message, tmp_path):
    network = HingeNetwork(read(tmp_path, text, "a", "h"))
    with pytest.raises(UserError, match=message):
        network.solve([0, 0, 0], held={joint: 3})


def test_a_joint_that_follows_one_beside_the_chain_has_its_name_and_limits(tmp_path):
    follower = '<link name="i"/><joint name="finger" type="prismatic"><parent link="h"/>'
    follower += (
        '<child link="i"/><limit lower="0" upper="0"/><mimic joint="fan" multiplier="0.01"/>'
    )
    text = TELESCOPE.replace("</robot>", follower + "</joint></robot>")
    arm = read(tmp_path, text, "h", "i")
    assert (arm.joint_names, arm.limits.tolist()) == (("fan",), [[-2, 2]])
    check_poses(arm, text, "h", "i")
    assert str(arm) == "fan   -2.00 to  2.00  node 0 slides"
    held = text.replace('lower="-2" upper="2"', 'lower="1" upper="1"')
    with pytest.raises(UserError, match="between base 'h' and tip 'i' must be a hinge or a slide"):
        read(tmp_path, held, "h", "i")
    check_poses(read(tmp_path, held, "a", "i"), held, "a", "i")


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('joint="further"', 'joint="gone"', "'screw' of line .* a joint that moves, got 'gone'"),
        ('joint="out"', 'joint="screw"', "'screw' of line .* a joint that moves, got 'further'"),
        ('multiplier="2.5"', 'multiplier="twice"', "'screw' of line .* numbers, got .'twice'"),
        ('multiplier="2.5"', 'multiplier="inf"', "'screw' of line .* finite numbers, got .'inf'"),
        ('upper="0.4"', 'upper="1e9"', "'out' of line .* slide by 1000 m at most, got 0 and 1e"),
        ('upper="0.4"', "", "'out' of line .* <limit> .* as it is prismatic"),
        (
            'lower="-1.5"',
            'lower="0.6"',
            "'pitch' of line .* limits lower <= upper, got 0.6 and 0.5",
        ),
        ("prismatic", "planar", "'out' of line .* prismatic or fixed, got 'planar'"),
    ],
)
def test_a_joint_that_cannot_be_in_a_chain_is_named_with_its_line(before, after, message, tmp_path):
    with pytest.raises(UserError, match=message):
        read(tmp_path, TELESCOPE.replace(before, after, 1), "a", "h")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("axis_joints", (0, 1, 3, 4), "axis_joints must be 4 numbers"),
        ("axis_joints", (1, 0), "axis_joints must be 4 numbers"),
        ("ratios", (1, 1, 0, 1), "ratios must be 4 finite numbers"),
        ("is_slide", (True,), "is_slide must be 4 times"),
        ("is_slide", (False, False, False, True), "limits of 'turn' must be within ±1000"),
    ],
)
def test_axes_that_no_joint_can_move_are_refused(field, value, message, tmp_path):
    arm = read(tmp_path, SCARA, "a", "h")
    with pytest.raises(UserError, match=message):
        replace(arm, **{field: value})


def test_an_arm_with_fewer_hinges_is_made_of_another():
    arm = HingeArm.named("panda")
    shorter = {name: getattr(arm, name)[:5] for name in ("axes", "points", "limits", "joint_names")}
    arm = replace(arm, **shorter)
    assert (arm.joint_count, arm.axis_joints, arm.has_only_hinges) == (5, (0, 1, 2, 3, 4), True)


def test_what_is_not_joined_to_the_base_or_floats_or_is_all_held_is_refused(tmp_path):
    apart = TWO_ARMS.replace("</robot>", '<link name="table"/></robot>')
    with pytest.raises(
        UserError, match=r"tip 'left' must hang from base 'table', or .* from 'body'"
    ):
        read(tmp_path, apart, "table", "left")
    with pytest.raises(UserError, match=r"'neck' of line .* must be .* got 'floating'"):
        read(tmp_path, TWO_ARMS, "head", "left")
    with pytest.raises(UserError, match="between base 'l2' and tip 'l1' must be a hinge"):
        read(tmp_path, TWO_ARMS, "l2", "l1")


def test_a_prefix_that_is_not_declared_is_refused_until_it_is(tmp_path):
    urdf = TELESCOPE.replace("<limit ", '<limit drake:acceleration="1" ')
    with pytest.raises(UserError, match=r"drake .* is not defined, .* <robot name=.* xmlns:drake="):
        read(tmp_path, urdf, "a", "h")
    declared = urdf.replace("<robot ", '<robot xmlns:drake="drake" ')
    assert read(tmp_path, declared, "a", "h").joint_count > 1


@pytest.mark.parametrize(
    "line",
    [
        '<xacro:include filename="$(find arm)/arm.xacro"/>',
        '<joint name="one" type="fixed"><xacro:insert_block name="origin"/></joint>',
        '<joint name="one" type="fixed"><origin rpy="0 0 ${pi / 2}"/></joint>',
    ],
)
def test_a_file_of_macros_is_refused_with_the_command_that_expands_it(line, tmp_path):
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(XACRO.format(line))
    with pytest.raises(UserError, match=r"it is xacro, as line 3 shows: .* xacro \S+ > robot.urdf"):
        HingeArm.from_urdf(path, base="a", tip="b")
