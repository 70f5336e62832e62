"""The chain of hinges between two links of a URDF file.

The file is parsed strictly, by lxml: nothing is repaired, and no entity or other file is read.
yourdfpy reads what a joint contains, one joint at a time, so that an error can name it.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mmc_gym._errors import UserError, missing, require_choice
from mmc_gym.geometry import Floats

_LARGEST_FILE = 16 * 2**20  # bytes of a file


class Chain(NamedTuple):
    """What describes a `HingeArm`; lengths in metres, angles in radians."""

    axes: Floats
    points: Floats
    home: Floats
    limits: Floats
    joint_names: tuple[str, ...]


def read_chain(path: Path | str, base: str, tip: str) -> Chain:
    """Return the chain from link `base` to link `tip`, see `HingeArm.from_urdf`."""
    pose, axes, points, limits, names = np.eye(4), [], [], [], []
    for where, joint in _joints_between(Path(path), base, tip):
        if joint.origin is not None:
            pose = pose @ joint.origin
        if joint.type == "fixed":
            continue
        axes.append(pose[:3, :3] @ joint.axis)
        points.append(pose[:3, 3])
        limits.append(_limits(where, joint))
        names.append(joint.name)
    if not axes:
        raise UserError(
            f"between base {base!r} and tip {tip!r} must be a hinge; {path} has none there"
        )
    return Chain(np.array(axes), np.array(points), pose, np.array(limits), tuple(names))


def _joints_between(path: Path, base: str, tip: str) -> list[tuple[str, Any]]:
    """Return the joints from `base` to `tip`, each with its name and line."""
    root = _parse(path)
    above: dict[str, Any] = {}
    for joint in root.findall("joint"):
        parent, child = (_link_of(joint, end) for end in ("parent", "child"))
        if child in above:
            both = f"{_where(above[child][1])} and {_where(joint)}"
            raise UserError(f"{path}: link {child!r} must be the child of one joint, not of {both}")
        above[child] = parent, joint
    links = [str(link.get("name")) for link in root.findall("link")]
    require_choice("base", base, links)
    require_choice("tip", tip, links)
    chain: list[Any] = []
    link = tip
    while link != base:
        if link not in above:
            raise UserError(f"tip {tip!r} must hang from base {base!r}, but it hangs from {link!r}")
        link, joint = above[link]
        if joint in chain:
            raise UserError(f"{path}: links must form a tree, but {_where(joint)} closes a circle")
        chain.append(joint)
    return [(f"{path}: {_where(joint)}", _read(path, joint)) for joint in reversed(chain)]


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
        raise UserError(f"{path} is not well-formed XML: {error.msg}") from error
    if tree.docinfo.doctype or tree.getroot().tag != "robot":
        raise UserError(f"{path} must be a URDF file: a <robot>, without a DOCTYPE")
    return tree.getroot()


def _where(joint: Any) -> str:
    return f"joint {joint.get('name')!r} of line {joint.sourceline}"


def _link_of(joint: Any, end: str) -> str:
    """Return the parent or the child of a joint."""
    element = joint.find(end)
    link = None if element is None else element.get("link")
    if not (link and joint.get("name")):
        raise UserError(f"{_where(joint)} must have a name, and a <{end} link=…>")
    return str(link)


def _read(path: Path, element: Any) -> Any:
    """Return what yourdfpy reads of one joint; refuse one that is no hinge of its own."""
    import yourdfpy
    from lxml import etree

    where = f"{path}: {_where(element)}"
    kind, accepted = element.get("type"), "revolute, continuous or fixed"
    if kind not in ("revolute", "continuous", "fixed"):
        raise UserError(f"{where} must be {accepted}, got {kind!r}")
    if kind != "fixed" and (mimic := element.find("mimic")) is not None:
        leader = mimic.get("joint")
        raise UserError(f"{where} must turn freely, but it follows joint {leader!r} (<mimic>)")
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
    """Return the lower and the upper limit of a hinge."""
    if joint.type == "continuous":
        return -np.inf, np.inf
    if joint.limit is None or None in (joint.limit.lower, joint.limit.upper):
        raise UserError(f"{where} must have a <limit> with lower and upper, as it is revolute")
    lower, upper = float(joint.limit.lower), float(joint.limit.upper)
    if not lower < upper:
        raise UserError(f"{where} must have limits with lower < upper, got {lower:g} and {upper:g}")
    return lower, upper
