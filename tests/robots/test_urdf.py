"""What a URDF may have between base and tip, against forward kinematics written out here."""

from xml.etree import ElementTree

import numpy as np
import pytest

from mmc_gym import HingeArm, UserError

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
