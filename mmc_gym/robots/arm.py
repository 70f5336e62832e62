"""Arms of hinges in space: axes, limits and home, by the product of exponentials.

In the zero posture hinge i turns about the line through the point a_i along the unit vector u_i,
and the hand has the pose M (Lynch & Park, Modern Robotics, Sect. 4.1).  Then

    T(q) = e^{[S_1] q_1} … e^{[S_n] q_n} M,      S_i = (u_i, a_i × u_i)

where e^{[S_i] q_i} turns everything that hinge i carries about its line by q_i.  A slide moves it
along u_i by q_i, S_i = (0, u_i).  A joint may move several axes, each by its ratio r_i of the
joint's displacement: then q_i is r_i times that of its joint.

**Nodes follow by a rule.**  The last node is the hand, and all last hinges whose axes go through it
belong to it.  From the base on, as many neighbouring hinges as possible share a node, the point
where their axes meet: shoulder, elbow and wrist of most robots.  If the axis of a hinge meets no
other, or if axes coincide, the node is the point on them nearest to the node before.  Each node
lies on the axes of its hinges, so neighbouring nodes keep their distance in all postures: the nodes
are the joints of a chain of rigid segments, with the base at node 0.  A slide belongs to the node
before it, and the next hinge begins another one: the segment between them is free along the slide.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import compress, takewhile
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from mmc_gym._errors import (
    UserError,
    is_whole,
    missing,
    require,
    require_array,
    require_choice,
    require_floats,
    unknown,
)
from mmc_gym._files import read_yaml
from mmc_gym.geometry import Floats

NamedArm = Literal["panda", "ur5", "iiwa"]
_TABLES = Path(__file__).with_name("arms.yml")
_LAST_ROW = [0.0, 0.0, 0.0, 1.0]  # of a pose
_MEET = 1e-4  # axes meet in a point if all pass it within this distance, m
# Largest deviation of a rotation times its transpose from the identity: as it is, and rounded.
_SQUARE, _ROUNDED = 1e-6, 1e-3
_UNDECLARED_PREFIX = 201  # of libxml2: XML_NS_ERR_UNDEFINED_NAMESPACE
_ENDLESS = 1e3  # limits beyond are none: files write such numbers for "no limit", radians or m
_LARGEST_FILE = 16 * 2**20  # bytes of a URDF file


class ArmFrames(NamedTuple):
    """An arm in a posture; all in the frame of its base, lengths in metres."""

    nodes: Floats  #: positions of the nodes, (..., N + 1, 3)
    axes: Floats  #: unit vectors of the hinges, (..., n, 3)
    points: Floats  #: where the points of `HingeArm.points` are now, (..., n, 3)
    hand: Floats  #: pose of the hand, (..., 4, 4)


def nearest_rotations(name: str, value: Floats) -> Floats:
    """Return rotations (..., 3, 3), the nearest to those that are rounded.

    Raise a `UserError` for the first matrix that is no rotation.
    """
    matrices = value.reshape(-1, 9).tolist()  # numpy takes four times as long for one matrix
    rounded = []
    for number, (a, b, c, d, e, f, g, h, i) in enumerate(matrices):
        # The rows (a, b, c) … must have length 1 and be at right angles.
        squares = abs(a * a + b * b + c * c - 1), abs(d * d + e * e + f * f - 1)
        across = abs(a * d + b * e + c * f), abs(a * g + b * h + c * i), abs(d * g + e * h + f * i)
        gap = max(*squares, abs(g * g + h * h + i * i - 1), *across)
        turn = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
        if not (gap <= _ROUNDED and turn > 0):  # refuses NaN too
            index = [int(row) for row in np.unravel_index(number, value.shape[:-2])]
            raise UserError(
                f"{name} must be a rotation, orthogonal within {_ROUNDED:g} and of determinant 1, "
                f"but {name}{index or ''} is off by {gap:.2g} and has the determinant {turn:.4g}"
            )
        if gap > _SQUARE:
            rounded.append(number)
    if not rounded:
        return value
    nearest: Floats = np.array(matrices).reshape(-1, 3, 3)
    left, _, right = np.linalg.svd(nearest[rounded])
    nearest[rounded] = left @ right
    return nearest.reshape(value.shape)


def require_poses(name: str, value: ArrayLike) -> Floats:
    """Return poses (..., 4, 4) with exact rotations; raise a `UserError` if one is no pose."""
    poses = require_floats(name, value, (4, 4)).astype(np.float64, copy=False)
    accepted = "a pose: a rotation, a position and the row 0, 0, 0, 1"
    are_poses = all(row == _LAST_ROW for row in poses[..., 3, :].reshape(-1, 4).tolist())
    require(are_poses, name, value, accepted)
    rotations = poses[..., :3, :3]
    nearest = nearest_rotations(name, rotations)
    if nearest is not rotations:
        poses[..., :3, :3] = nearest
    return poses


@dataclass(frozen=True, eq=False)
class HingeArm:
    """Description of an arm of n hinges; lengths in metres, angles in radians.

    Some of its joints may be slides: the "angles" of these are in metres.  Some may move several of
    its axes, as those do that others follow.

    >>> arm = HingeArm.named("panda")
    >>> arm.forward([0.0] * 7)[:3, 3].round(3).tolist()
    [0.088, 0.0, 0.926]
    >>> arm.nodes([0.0] * 7).round(2).tolist()  # shoulder, elbow, wrist, hand
    [[0.0, 0.0, 0.33], [0.08, 0.0, 0.65], [0.0, 0.0, 1.03], [0.09, 0.0, 0.93]]
    >>> print(HingeArm.named("ur5"))
    shoulder_pan_joint    -6.28 to  6.28  node 0
    shoulder_lift_joint   -6.28 to  6.28  node 0
    elbow_joint           -3.14 to  3.14  node 1
    wrist_1_joint         -6.28 to  6.28  node 2
    wrist_2_joint         -6.28 to  6.28  node 2
    wrist_3_joint         -6.28 to  6.28  node 3
    """

    #: directions of the axes in the zero posture, (a, 3), brought to length 1; a = n, a hinge each,
    #: but for what `axis_joints` and `is_slide` say
    axes: Floats
    points: Floats  #: a point on each axis in the zero posture, (a, 3)
    home: Floats  #: pose of the hand in the zero posture, (4, 4)
    #: least and largest angle of each joint, (n, 2); infinite without a limit, as are those that
    #: are given as beyond ±1,000 rad; a joint that moves a slide must have finite ones
    limits: Floats
    joint_names: tuple[str, ...] = ()  #: of the hinges, all different; "joint_0" … if not given
    axis_joints: tuple[int, ...] = ()  #: the joint that moves each axis, a numbers; () is its own
    ratios: tuple[float, ...] = ()  #: displacement of each axis per that of its joint; () is 1
    is_slide: tuple[bool, ...] = ()  #: whether each axis slides instead of turning; () is False

    def __post_init__(self) -> None:
        axes = np.shape(self.axes)[0] if np.ndim(self.axes) == 2 else 0
        require(axes > 0, "axes", np.shape(self.axes), "of shape (n, 3)")
        for name, plain in _PLAIN.items():
            values = tuple(getattr(self, name))
            # `replace` hands on those of an arm that may have another number of axes.
            values = plain(axes) if values == plain(len(values)) else values
            object.__setattr__(self, name, values)
        count = len(set(self.axis_joints))
        are_joints = len(self.axis_joints) == axes and set(self.axis_joints) == set(range(count))
        require(are_joints, "axis_joints", self.axis_joints, f"{axes} numbers, all from 0 on")
        are_ratios = len(self.ratios) == axes and all(0 < abs(r) < np.inf for r in self.ratios)
        require(are_ratios, "ratios", self.ratios, f"{axes} finite numbers other than 0")
        require(
            len(self.is_slide) == axes, "is_slide", self.is_slide, f"{axes} times True or False"
        )
        shapes = {"axes": (axes, 3), "points": (axes, 3), "home": (4, 4), "limits": (count, 2)}
        for name, shape in shapes.items():
            value = np.array(require_array(name, getattr(self, name)), np.float64)
            require(value.shape == shape, name, value.shape, f"of shape {shape}")
            require(not np.isnan(value).any(), name, value, "without nan")
            require(name == "limits" or bool(np.isfinite(value).all()), name, value, "finite")
            object.__setattr__(self, name, value)
        self.limits[np.abs(self.limits) > _ENDLESS] *= np.inf
        lengths = np.linalg.norm(self.axes, axis=1, keepdims=True)
        require(bool((lengths > 0).all()), "axes", self.axes, "other than zero")
        object.__setattr__(self, "axes", self.axes / lengths)
        below = bool((self.limits[:, 0] < self.limits[:, 1]).all())
        require(below, "limits", self.limits, "pairs of a lower and a higher angle")
        object.__setattr__(self, "home", require_poses("home", self.home))
        names = tuple(self.joint_names) or tuple(f"joint_{joint}" for joint in range(count))
        is_named = len(set(names)) == len(names) == count and all(isinstance(n, str) for n in names)
        require(is_named, "joint_names", names, f"{count} different names")
        object.__setattr__(self, "joint_names", names)
        for joint in compress(self.axis_joints, self.is_slide):
            accepted = f"within ±{_ENDLESS:g}, as it moves a slide"
            bounds = tuple(self.limits[joint].tolist())
            is_finite = bool(np.isfinite(bounds).all())
            require(is_finite, f"limits of {names[joint]!r}", bounds, accepted)

    def __str__(self) -> str:
        """Return a line for each joint, from base to hand: name, limits in radians or m, nodes."""
        width, lines = max(map(len, self.joint_names)), []
        for joint, (name, (low, high)) in enumerate(zip(self.joint_names, self.limits)):
            axes = [axis for axis, mover in enumerate(self.axis_joints) if mover == joint]
            kinds = (" slides" if self.is_slide[axis] else "" for axis in axes)
            places = (f"node {self.joint_nodes[axis]}{kind}" for axis, kind in zip(axes, kinds))
            lines.append(f"{name:{width}}  {low:6.2f} to {high:5.2f}  {', '.join(places)}")
        return "\n".join(lines)

    @classmethod
    def named(cls, name: NamedArm) -> HingeArm:
        """Return one of the robots that ship with the package.

        - `"panda"`: Franka Emika Panda, from `panda_link0` to the flange `panda_link8`.
        - `"ur5"`: Universal Robots UR5, from `base_link` to the flange `tool0`.
        - `"iiwa"`: KUKA LBR iiwa 14 R820, from `lbr_iiwa_link_0` to `lbr_iiwa_link_7`.

        Their numbers and sources are in `mmc_gym/robots/arms.yml`.
        """
        require_choice("name", name, get_args(NamedArm))
        return cls(**read_yaml(_TABLES.read_text(encoding="utf-8"))[name])

    @classmethod
    def from_urdf(cls, path: Path | str, base: str, tip: str) -> HingeArm:
        """Read the chain from link `base` to link `tip` of a URDF file, by yourdfpy.

        Joints may be revolute, continuous (hinges without limits), prismatic (slides) or fixed,
        which only add their offset.  A joint with two equal limits is fixed there.  One that
        follows another (`<mimic>`) is moved by that joint within its limits, even if that one is
        not between the two links.  The chain may lead up the tree, from a hand to its base or to
        another hand.  Only the file itself is read, no meshes.

        Raises:
            UserError: if the file is no XML or the links do not form a tree; if a joint between
                the two links is floating or planar, follows none that moves, is revolute or
                prismatic without limits, or cannot be read.  The message names the joint and its
                line.
            FileNotFoundError: if there is no file.
        """
        pose, limits = np.eye(4), dict[str, tuple[float, float]]()
        axes, points, joints, ratios, is_slide = [], [], [], [], []
        for passed in _joints_between(Path(path), base, tip):
            joint, leader, ratio, offset = passed.joint, passed.leader, passed.ratio, passed.offset
            origin = np.eye(4) if joint.origin is None else joint.origin
            pose = pose if passed.is_upward else pose @ origin
            if joint.type != "fixed":
                # Seen from the child, the parent moves the other way.
                axis = -joint.axis if passed.is_upward else joint.axis
                slides, (lower, upper) = joint.type == "prismatic", _limits(passed.where, leader)
                rest = offset + ratio * lower if lower == upper else offset
                if rest:
                    motion = np.eye(4)
                    if slides:
                        motion[:3, 3] = rest * axis / np.linalg.norm(axis)
                    else:
                        motion[:3, :3] = _turn(axis / np.linalg.norm(axis), rest)
                    pose = pose @ motion
                if lower < upper and ratio:
                    axes.append(pose[:3, :3] @ axis)
                    points.append(pose[:3, 3])
                    limits[leader.name] = lower, upper
                    joints.append([*limits].index(leader.name))
                    ratios.append(ratio)
                    is_slide.append(slides)
            pose = pose @ np.linalg.inv(origin) if passed.is_upward else pose
        if not axes:
            accepted = "a hinge or a slide, free to move"
            raise UserError(
                f"between base {base!r} and tip {tip!r} must be {accepted}; {path} has none there"
            )
        return cls(
            axes=np.array(axes),
            points=np.array(points),
            home=pose,
            limits=np.array([*limits.values()]),
            joint_names=tuple(limits),
            axis_joints=tuple(joints),
            ratios=tuple(ratios),
            is_slide=tuple(is_slide),
        )

    @property
    def joint_count(self) -> int:
        """Number of joints, n."""
        return len(self.limits)

    @property
    def has_only_hinges(self) -> bool:
        """Whether each joint turns one axis, by its own angle: no slides and no followers."""
        return (
            len(self.axes) == len(self.limits) and {*self.ratios} == {1} and not any(self.is_slide)
        )

    @property
    def segment_lengths(self) -> tuple[float, ...]:
        """Distances between neighbouring nodes in the zero posture, m, (N,)."""
        return tuple(np.linalg.norm(np.diff(self._rule[1], axis=0), axis=1).tolist())

    def joint_index(self, joint: int | str) -> int:
        """Return the index of a hinge, given by index or name."""
        if joint in self.joint_names:
            return self.joint_names.index(str(joint))
        if not (is_whole(joint) and 0 <= joint < self.joint_count):
            raise unknown(
                "joint", joint, self.joint_names, f"an index from 0 to {self.joint_count - 1}"
            )
        return int(joint)

    @cached_property
    def joint_nodes(self) -> tuple[int, ...]:
        """Index of the node that each axis belongs to."""
        return self._rule[0]

    @property
    def node_count(self) -> int:
        """Number of nodes, N + 1; the hand is the last one."""
        return len(self._rule[1])

    def forward(self, joint_angles: ArrayLike) -> Floats:
        """Return the poses of the hand (..., 4, 4) for joint angles (..., n)."""
        return self.frames(joint_angles).hand

    def nodes(self, joint_angles: ArrayLike) -> Floats:
        """Return the positions of the nodes (..., N + 1, 3) for joint angles (..., n)."""
        return self.frames(joint_angles).nodes

    def jacobian(self, joint_angles: ArrayLike) -> Floats:
        """Return how the hand moves with each joint, (..., 6, n), for joint angles (..., n).

        The first three rows are its velocity, m per radian (or per m of a slide), the last three
        its angular velocity, both in the frame of the base.
        """
        _, axes, points, hand = self.frames(joint_angles)
        velocity = np.cross(axes, hand[..., None, :3, 3] - points)
        is_slide = np.array(self.is_slide)[:, None]
        velocity, turn = np.where(is_slide, axes, velocity), np.where(is_slide, 0.0, axes)
        by_joint = np.zeros((self.joint_count, len(self.axes)))
        by_joint[self.axis_joints, range(len(self.axes))] = self.ratios
        jacobian: Floats = by_joint @ np.concatenate([velocity, turn], axis=-1)
        return np.swapaxes(jacobian, -1, -2)

    def frames(self, joint_angles: ArrayLike) -> ArmFrames:
        """Return nodes, axes, points on the axes and pose of the hand for joint angles (..., n)."""
        angles = require_array("joint_angles", joint_angles)
        accepted = f"of shape (..., {self.joint_count})"
        require(angles.shape[-1:] == (self.joint_count,), "joint_angles", angles.shape, accepted)
        batch, (joint_nodes, home_nodes) = angles.shape[:-1], self._rule
        nodes = np.broadcast_to(home_nodes, (*batch, *home_nodes.shape)).copy()
        axes, points = np.empty((2, *batch, len(self.axes), 3))
        # The link that carries the next hinge has moved each of its points x to turn x + shift.
        turn, shift = np.broadcast_to(np.eye(3), (*batch, 3, 3)), np.zeros((*batch, 3))
        for number, (axis, point) in enumerate(zip(self.axes, self.points)):
            axes[..., number, :], points[..., number, :] = turn @ axis, turn @ point + shift
            moved = self.ratios[number] * angles[..., self.axis_joints[number], None]
            node = joint_nodes[number]
            if self.is_slide[number]:
                shift, node = shift + moved * axes[..., number, :], node + 1
            else:
                hinge = _turn(axis, moved[..., None])
                shift = shift + np.einsum("...ij,...j->...i", turn, point - hinge @ point)
                turn = turn @ hinge
            nodes[..., node:, :] = home_nodes[node:] @ np.swapaxes(turn, -1, -2)
            nodes[..., node:, :] += shift[..., None, :]
        hand = np.broadcast_to(self.home, (*batch, 4, 4)).copy()
        hand[..., :3, :3] = turn @ self.home[:3, :3]
        hand[..., :3, 3] = nodes[..., -1, :]
        return ArmFrames(nodes, axes, points, hand)

    @cached_property
    def _rule(self) -> tuple[tuple[int, ...], Floats]:
        """Return the node of each axis, and the nodes in the zero posture, (N + 1, 3)."""
        hand, of_hand = self.home[:3, 3], len(self.axes)  # hinges from `of_hand` on belong to it
        while (
            of_hand > 1
            and not self.is_slide[of_hand - 1]
            and self._miss(range(of_hand - 1, of_hand), hand) < _MEET
        ):
            of_hand -= 1
        nodes: list[Floats] = []
        joint_nodes: list[int] = []
        before: Floats = np.zeros(3)
        first = 0
        while first < of_hand:
            hinges = end = first if self.is_slide[first] else first + 1
            while hinges == end < of_hand and not self.is_slide[end]:
                if self._meet(range(first, end + 1), before)[1] >= _MEET:
                    break
                hinges = end = end + 1
            while end < of_hand and self.is_slide[end]:
                end += 1
            before = self._meet(range(first, max(hinges, first + 1)), before)[0]
            joint_nodes += [len(nodes)] * (end - first)
            nodes.append(before)
            first = end
        joint_nodes += [len(nodes)] * (len(self.axes) - of_hand)
        return tuple(joint_nodes), np.array([*nodes, hand])

    def _meet(self, joints: range, near: Floats) -> tuple[Floats, float]:
        """Return the point nearest to the axes of `joints`, and its largest distance from them.

        If many points are equally near, it is the one nearest to `near`.
        """
        across = np.eye(3) - self.axes[joints, :, None] * self.axes[joints, None, :]
        pull = np.einsum("nij,nj->i", across, self.points[joints] - near)
        point = near + np.linalg.pinv(across.sum(axis=0), rcond=1e-6, hermitian=True) @ pull
        return point, self._miss(joints, point)

    def _miss(self, joints: range, point: Floats) -> float:
        """Return the largest distance of a point from the axes of `joints`."""
        away = np.cross(self.axes[joints], point - self.points[joints])
        return float(np.linalg.norm(away, axis=1).max())


def _turn(axis: Floats, angle: Any) -> Floats:
    """Return the rotation about an axis of length 1; angles (..., 1, 1) give (..., 3, 3)."""
    cross = np.cross(axis, np.eye(3)).T  # cross @ x = axis × x
    rotation: Floats = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    return rotation


_PLAIN: dict[str, Callable[[int], tuple[float, ...]]] = {  # of axes, each a hinge of its own joint
    "axis_joints": lambda axes: tuple(range(axes)),
    "ratios": lambda axes: (1.0,) * axes,
    "is_slide": lambda axes: (False,) * axes,
}


class _Passed(NamedTuple):
    """A joint on the way from base to tip."""

    joint: Any  #: as yourdfpy reads it
    is_upward: bool  #: whether the way leads from its child to its parent
    leader: Any  #: the joint that it follows (`<mimic>`), or itself
    where: str  #: file, name and line of that joint in words
    ratio: float  #: its displacement for that of its leader
    offset: float  #: its displacement where that of its leader is 0


def _joints_between(path: Path, base: str, tip: str) -> list[_Passed]:
    """Return the joints from `base` up to a link above both, and from there down to `tip`.

    The file is parsed strictly, by lxml: nothing is repaired, and no entity or other file is read.
    yourdfpy reads what a joint contains, one joint at a time, so that an error can name it.
    """
    root = _parse(path)
    above: dict[str, Any] = {}
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for joint in root.findall("joint"):
        parent, child = (_link_of(joint, end) for end in ("parent", "child"))
        if child in above:
            both = f"{_where(above[child][1])} and {_where(joint)}"
            raise UserError(f"{path}: link {child!r} must be the child of one joint, not of {both}")
        above[child] = parent, joint
    links = [str(link.get("name")) for link in root.findall("link")]
    require_choice("base", base, links)
    require_choice("tip", tip, links)

    def climb(link: str, ends: Container[str]) -> tuple[dict[str, Any], str]:
        """Return the joint above each link on the way up to the first of `ends`, and that end."""
        passed: dict[str, Any] = {}
        while link not in ends and link in above:
            parent, joint = above[link]
            if link in passed:
                message = f"links must form a tree, but {_where(joint)} closes a circle"
                raise UserError(f"{path}: {message}")
            passed[link], link = joint, parent
        return passed, link

    down, top = climb(tip, {base})
    up, meeting = climb(base, {*down, top})
    if meeting not in {*down, top}:
        accepted = f"from base {base!r}, or from a link above it"
        raise UserError(f"tip {tip!r} must hang {accepted}, but it hangs from {top!r}")
    below = list(takewhile(lambda link: link != meeting, down))
    ways = [(joint, True) for joint in up.values()]
    ways += [(down[link], False) for link in reversed(below)]
    chain = []
    for joint, is_upward in ways:
        leader, ratio, offset = _leader_of(path, joint, joints)
        where = f"{path}: {_where(leader)}"
        read = _read(path, joint)
        mover = read if leader is joint else _read(path, leader)
        chain.append(_Passed(read, is_upward, mover, where, ratio, offset))
    return chain


def _leader_of(path: Path, joint: Any, joints: Mapping[str, Any]) -> tuple[Any, float, float]:
    """Return the joint that a joint follows in the end, or itself, with ratio and offset."""
    ratio, offset, followers = 1.0, 0.0, []
    while joint.get("type") != "fixed" and (mimic := joint.find("mimic")) is not None:
        followers.append(joint)
        where, name = f"{path}: {_where(joint)}", mimic.get("joint")
        numbers = [mimic.get("multiplier", "1"), mimic.get("offset", "0")]
        try:
            factor, more = map(float, numbers)
        except ValueError as error:
            raise UserError(f"{where} must follow (<mimic>) by numbers, got {numbers}") from error
        joint = joints.get(name)
        if joint is None or joint in followers or joint.get("type") == "fixed":
            raise UserError(f"{where} must follow (<mimic>) a joint that moves, got {name!r}")
        if not np.isfinite([factor, more]).all():
            raise UserError(f"{where} must follow (<mimic>) by finite numbers, got {numbers}")
        ratio, offset = ratio * factor, offset + ratio * more
    return joint, ratio, offset


def _parse(path: Path) -> Any:
    """Return the root of an XML file."""
    try:
        import yourdfpy  # noqa: F401
        from lxml import etree
    except ModuleNotFoundError as error:
        raise missing("HingeArm.from_urdf", "yourdfpy", "urdf") from error
    if not path.is_file():
        raise FileNotFoundError(path)
    if path.stat().st_size > _LARGEST_FILE:
        raise UserError(f"{path} must have at most {_LARGEST_FILE / 2**20:.0f} MiB")
    strict = etree.XMLParser(resolve_entities=False, load_dtd=False, no_network=True)
    try:
        tree = etree.fromstring(path.read_bytes(), strict).getroottree()
    except etree.XMLSyntaxError as error:
        remedy = ""
        if error.code == _UNDECLARED_PREFIX:
            remedy = ': declare it, as in <robot name="arm" xmlns:drake="drake">'
        raise UserError(f"{path} is not well-formed XML: {error.msg}{remedy}") from error
    if tree.docinfo.doctype or tree.getroot().tag != "robot":
        raise UserError(f"{path} must be a URDF file: a <robot>, without a DOCTYPE")
    if macros := tree.xpath("//*[contains(namespace-uri(), 'xacro') or @*[contains(., '${')]]"):
        raise UserError(
            f"{path} must be a URDF file, but it is xacro, as line {macros[0].sourceline} shows: "
            f"expand it, xacro {path} > robot.urdf (pip install xacro, or ROS), and read that file"
        )
    return tree.getroot()


def _where(joint: Any) -> str:
    return f"joint {joint.get('name')!r} of line {joint.sourceline}"


def _link_of(joint: Any, end: str) -> str:
    element = joint.find(end)
    link = None if element is None else element.get("link")
    if not (link and joint.get("name")):
        raise UserError(f"{_where(joint)} must have a name, and a <{end} link=…>")
    return str(link)


def _read(path: Path, element: Any) -> Any:
    """Return a joint as yourdfpy reads it; raise a `UserError` if it cannot be in a chain."""
    import yourdfpy
    from lxml import etree

    where = f"{path}: {_where(element)}"
    kind, accepted = element.get("type"), "revolute, continuous, prismatic or fixed"
    if kind not in ("revolute", "continuous", "prismatic", "fixed"):
        raise UserError(f"{where} must be {accepted}, got {kind!r}")
    alone = io.BytesIO(b'<robot name="one">' + etree.tostring(element) + b"</robot>")
    try:
        robot = yourdfpy.URDF.load(alone, build_scene_graph=False, load_meshes=False).robot
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        raise UserError(f"{where} cannot be read: {error}") from error
    joint = robot.joints[0]
    if joint.origin is not None and not np.isfinite(joint.origin).all():
        raise UserError(f"{where} must have an <origin> of finite numbers")
    is_axis = np.shape(joint.axis) == (3,) and np.isfinite(joint.axis).all() and np.any(joint.axis)
    if kind != "fixed" and not is_axis:
        raise UserError(f"{where} must have an <axis> of three numbers, not all 0")
    return joint


def _limits(where: str, joint: Any) -> tuple[float, float]:
    if joint.type == "continuous":
        return -np.inf, np.inf
    if joint.limit is None or None in (joint.limit.lower, joint.limit.upper):
        raise UserError(f"{where} must have a <limit> with lower and upper, as it is {joint.type}")
    lower, upper = float(joint.limit.lower), float(joint.limit.upper)
    if joint.type == "prismatic" and max(abs(lower), abs(upper)) > _ENDLESS:
        raise UserError(
            f"{where} must slide by {_ENDLESS:g} m at most, got {lower:g} and {upper:g}"
        )
    if not lower <= upper:
        raise UserError(f"{where} must have limits lower <= upper, got {lower:g} and {upper:g}")
    return lower, upper
