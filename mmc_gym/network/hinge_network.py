"""The network in space: an arm of hinges, its nodes joined by vectors as in the plane.

First plain version; the equations follow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import require, require_array, require_positive, require_whole, spelt, unknown
from mmc_gym.network.chain import Floats
from mmc_gym.network.hinge_arm import HingeArm


@dataclass(frozen=True, eq=False)
class HingeState:
    """Postures of a batch of arms, and how fast they change.

    Attributes:
        joint_angles: radians, (..., n).
        joint_velocities: radians per iteration, (..., n).
    """

    joint_angles: Floats
    joint_velocities: Floats


@dataclass(frozen=True, eq=False)
class HingeClamps:
    """What is held, made by `HingeNetwork.clamp`.

    Attributes:
        position: of the hand, (..., 3), or None.
        rotation: of the hand, (..., 3, 3), or None.
        held: angles of held joints by joint, (...).
        points: positions of other nodes by node, (..., 3).
    """

    position: Floats | None = None
    rotation: Floats | None = None
    held: Mapping[int, Floats] = field(default_factory=dict)
    points: Mapping[int, Floats] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class HingeSolution:
    """Where a network has settled; `...` are the batch axes of the task.

    Attributes:
        joint_angles: (..., n).
        position_error: largest distance of a held node, the hand or a point, from its place, m.
        rotation_error: angle between the hand's rotation and the wanted one, radians.
        iterations: iterations until it settled, of all starts that iterated together.
        is_solved: whether both errors are within the tolerance.
    """

    joint_angles: Floats
    position_error: Floats
    rotation_error: Floats
    iterations: NDArray[np.int64]
    is_solved: NDArray[np.bool_]


@spelt
@dataclass(frozen=True, eq=False)
class HingeNetwork:
    """Description of an MMC network for an arm of hinges; it holds no state.

    Attributes:
        arm: the arm.
        damping: d, the weight of the present posture in the mean; by default 5/7 of the joints.
        velocity_decay: factor on the velocity in each iteration.
        hand_size: length of the vectors that stand for the hand's rotation, m.

    >>> network = HingeNetwork(HingeArm.named("panda"))
    >>> solution = network.solve(position=[0.4, 0.2, 0.5])
    >>> solution.is_solved.item()
    True
    """

    arm: HingeArm
    damping: float | None = None
    velocity_decay: float = 0.9
    hand_size: float = 0.3

    def state(self, joint_angles: ArrayLike) -> HingeState:
        """Return arms at rest in postures (..., n)."""
        angles = self._array("joint_angles", joint_angles, (self.arm.joint_count,))
        return HingeState(angles, np.zeros_like(angles))

    def clamp(
        self,
        position: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        held: Mapping[int, ArrayLike] | None = None,
        points: Mapping[int, ArrayLike] | None = None,
    ) -> HingeClamps:
        """Hold the hand's position (..., 3) and rotation (..., 3, 3), joints and nodes."""
        for joint in held or {}:
            if joint not in range(self.arm.joint_count):
                raise unknown("joint", joint, range(self.arm.joint_count))
        for node in points or {}:
            if node not in range(1, self.arm.node_count):
                raise unknown("node", node, range(1, self.arm.node_count))
        return HingeClamps(
            None if position is None else self._array("position", position, (3,)),
            None if rotation is None else self._array("rotation", rotation, (3, 3)),
            {joint: self._array("held", angle, ()) for joint, angle in (held or {}).items()},
            {node: self._array("points", point, (3,)) for node, point in (points or {}).items()},
        )

    def run(self, state: HingeState, clamps: HingeClamps, iterations: int = 1) -> HingeState:
        """Return the state after `iterations` iterations; `state` itself stays as it is."""
        require_whole("iterations", iterations, least=0)
        count, arm = self.arm.joint_count, self.arm
        angles, velocities = state.joint_angles, state.joint_velocities
        share = 1 / (self.damping or count * 5 / 7)
        weight = 2 * self.hand_size**2
        lower, upper = arm.limits.T
        places = dict(clamps.points)
        if clamps.position is not None:
            places[arm.node_count - 1] = clamps.position
        angles = self._hold(angles, clamps)
        for _ in range(iterations):
            nodes, axes, hand = arm.frames(angles)
            asked, stiffness = np.zeros_like(axes[..., 0]), np.full(axes.shape[:-1], 1e-9)
            for node, place in places.items():
                away = nodes[..., node, None, :] - nodes[..., arm.joint_nodes, :]
                carried = np.array(arm.joint_nodes)[:, None] < node
                lever = np.cross(axes, away) * carried
                miss = (place - nodes[..., node, :])[..., None, :]
                asked = asked + (lever * miss).sum(axis=-1)
                stiffness = stiffness + (lever**2).sum(axis=-1)
            if clamps.rotation is not None:
                turn = _rotation_vector(clamps.rotation @ np.swapaxes(hand[..., :3, :3], -1, -2))
                asked = asked + weight * (axes * turn[..., None, :]).sum(axis=-1)
                stiffness = stiffness + weight
            velocities = self.velocity_decay * velocities + share * asked / stiffness
            moved = angles + velocities
            angles = np.clip(moved, lower, upper)
            velocities = np.where(moved == angles, velocities, 0.0)
            angles = self._hold(angles, clamps)
        return HingeState(angles, velocities)

    def solve(
        self,
        position: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        start: ArrayLike | None = None,
        held: Mapping[int, ArrayLike] | None = None,
        points: Mapping[int, ArrayLike] | None = None,
        starts: int = 50,
        tolerance: tuple[float, float] = (1e-3, 1e-2),
        polish: bool = False,
        seed: int = 0,
    ) -> HingeSolution:
        """Return where the network settles, from `start` (..., n) and from random postures."""
        clamps = self.clamp(position, rotation, held, points)
        require_whole("starts", starts)
        require_positive("tolerance", min(tolerance))
        random = np.random.default_rng(seed)
        lower, upper = np.clip(self.arm.limits, -2 * np.pi, 2 * np.pi).T
        parts = [np.zeros(()) if start is None else self.state(start).joint_angles[..., 0]]
        parts += [] if clamps.position is None else [clamps.position[..., 0]]
        parts += [] if clamps.rotation is None else [clamps.rotation[..., 0, 0]]
        parts += [*clamps.held.values(), *(point[..., 0] for point in clamps.points.values())]
        batch = np.broadcast_shapes(*(part.shape for part in parts))
        first = (lower + upper) / 2 if start is None else np.asarray(start, np.float64)
        best = np.broadcast_to(first, (*batch, self.arm.joint_count)).copy()
        errors = np.full((2, *batch), np.inf)
        solved, count = np.zeros(batch, bool), np.zeros(batch, np.int64)
        for index in range(starts):
            posture = best if index == 0 else random.uniform(lower, upper, best.shape)
            state = self.state(posture)
            for _ in range(10):
                state = self.run(state, clamps, 30)
                found = np.stack(self.errors(state, clamps))
                better = ~solved & (found.sum(axis=0) < errors.sum(axis=0))
                best = np.where(better[..., None], state.joint_angles, best)
                errors = np.where(better, found, errors)
                count += 30 * ~solved
                solved = (errors[0] < tolerance[0]) & (errors[1] < tolerance[1])
                if solved.all():
                    break
            if solved.all():
                break
        return HingeSolution(best, errors[0], errors[1], count, solved)

    def errors(self, state: HingeState, clamps: HingeClamps) -> tuple[Floats, Floats]:
        """Return the largest distance of a held node from its place, and the hand's angle to go."""
        nodes, _, hand = self.arm.frames(state.joint_angles)
        places = dict(clamps.points)
        if clamps.position is not None:
            places[self.arm.node_count - 1] = clamps.position
        far, turn = np.zeros(nodes.shape[:-2]), np.zeros(nodes.shape[:-2])
        for node, place in places.items():
            far = np.maximum(far, np.linalg.norm(place - nodes[..., node, :], axis=-1))
        if clamps.rotation is not None:
            rest = clamps.rotation @ np.swapaxes(hand[..., :3, :3], -1, -2)
            turn = np.linalg.norm(_rotation_vector(rest), axis=-1)
        return far, turn

    def _hold(self, angles: Floats, clamps: HingeClamps) -> Floats:
        if clamps.held:
            angles = angles.copy()
            for joint, angle in clamps.held.items():
                angles[..., joint] = angle
        return angles

    def _array(self, name: str, value: ArrayLike, trailing: tuple[int, ...]) -> Floats:
        array = np.array(require_array(name, value), np.float64)
        fine = array.shape[array.ndim - len(trailing) :] == trailing
        require(fine, name, array.shape, f"of shape (..., {', '.join(map(str, trailing))})")
        require(bool(np.isfinite(array).all()), name, value, "finite")
        return array


def _rotation_vector(rotation: Floats) -> Floats:
    """Return axis times angle, (..., 3), of rotations (..., 3, 3)."""
    skew = (rotation - np.swapaxes(rotation, -1, -2)) / 2
    vector = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)
    sine = np.linalg.norm(vector, axis=-1)
    angle = np.arctan2(sine, (np.trace(rotation, axis1=-2, axis2=-1) - 1) / 2)
    return vector * (angle / np.where(sine > 1e-12, sine, 1.0))[..., None]
