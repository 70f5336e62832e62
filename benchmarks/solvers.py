"""Arms, and solvers of inverse kinematics behind one call: ours, and peers from PyPI.

An `Arm` is read from a URDF and written as one, of which every solver is made.  So all solve for
the same arm, and an arm that changed (a joint fixed, a link longer) is one more URDF.
"""

from __future__ import annotations

import importlib.util
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, ClassVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mmc_gym.robots import HingeArm, HingeNetwork

Array = NDArray[np.float64]
BUDGET = 0.005  # seconds
LOOSE, TIGHT = (1e-3, 1e-2), (1e-5, 1e-5)  # metres and radians
ELBOW = 1  # node of the network, after the shoulder
DATA = "cmeel.prefix/share/example-robot-data/robots"

ROBOTS = {  # package, file, base, tip
    "panda": (DATA, "panda_description/urdf/panda.urdf", "panda_link0", "panda_link8"),
    "ur5": (DATA, "ur_description/urdf/ur5_robot.urdf", "base_link", "wrist_3_link"),
    "iiwa": ("pybullet_data", "kuka_iiwa/model.urdf", "lbr_iiwa_link_0", "lbr_iiwa_link_7"),
    "ur10": (DATA, "ur_description/urdf/ur10_robot.urdf", "base_link", "wrist_3_link"),
    "xarm7": (DATA, "xarm_description/urdf/xarm7.urdf", "link_base", "link7"),
    "talos": (
        DATA,
        "talos_data/robots/talos_left_arm.urdf",
        "arm_left_1_link",
        "gripper_left_base_link",
    ),
    "tiagopro": (
        DATA,
        "tiago_pro_description/robots/tiago_pro.urdf",
        "torso_lift_link",
        "arm_left_tool_link",
    ),
    "z1": (DATA, "z1_description/urdf/z1.urdf", "link00", "link06"),
    "baxter": (DATA, "baxter_description/urdf/baxter.urdf", "base", "left_gripper"),
}


@dataclass(frozen=True)
class Arm:
    """A chain of n hinges, each of which turns about the z axis of its frame.

    Attributes:
        name: of the robot.
        offsets: (n + 1, 4, 4), from each hinge's frame to the next one's, then to the hand's.
        limits: (n, 2) in radians.
        elbow: the hinge in whose origin the elbow is.
    """

    name: str
    offsets: Array
    limits: Array
    elbow: int = 3

    @staticmethod
    def named(name: str) -> Arm:
        """Read the URDF of a robot from its package; the elbow is a node of the network."""
        folder, path, base, tip = ROBOTS[name]
        arm = HingeArm.from_urdf(files("cmeel").parent / folder / path, base=base, tip=tip)
        elbow = arm.joint_nodes.index(ELBOW)
        points = arm.points.copy()
        points[elbow] = arm.nodes(np.zeros(len(points)))[ELBOW]
        frames = [np.eye(4), *map(_frame, points, arm.axes), arm.home]
        offsets = [np.linalg.solve(*pair) for pair in pairwise(frames)]
        return Arm(name, np.array(offsets), arm.limits, elbow)

    def fixed(self, joint: int, angle: float) -> Arm:
        """Return the arm of which one joint is fixed at an angle."""
        between = self.offsets[joint] @ _turn(angle) @ self.offsets[joint + 1]
        offsets = [*self.offsets[:joint], between, *self.offsets[joint + 2 :]]
        limits = np.delete(self.limits, joint, axis=0)
        return replace(self, offsets=np.array(offsets), limits=limits)

    def stretched(self, link: int, factor: float) -> Arm:
        """Return the arm with one link so many times as long."""
        offsets = self.offsets.copy()
        offsets[link, :3, 3] *= factor
        return replace(self, offsets=offsets)

    def random(self, random: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
        """Draw postures uniformly within the limits."""
        return random.uniform(*self.limits.T, (*shape, len(self.limits)))

    def frames(self, posture: Array) -> Array:
        """Return the (n + 1, 4, 4) poses of the hinges and of the hand."""
        pose, poses = np.eye(4), []
        for offset, angle in zip(self.offsets, posture):
            pose = pose @ offset @ _turn(angle)
            poses.append(pose)
        return np.array([*poses, pose @ self.offsets[-1]])

    def urdf(self) -> str:
        """Return the arm as URDF text: links base, link0, …, hand and elbow, without meshes."""
        parents = ["base", *(f"link{joint}" for joint in range(len(self.limits)))]
        text = '<link name="base"/>'
        for joint, (low, high) in enumerate(self.limits):
            limit = f'<limit lower="{low:.17g}" upper="{high:.17g}" effort="100" velocity="100"/>'
            child, hinge = f"link{joint}", '<axis xyz="0 0 1"/>' + limit
            text += _link(parents[joint], child, self.offsets[joint], "revolute", hinge)
        text += _link(parents[-1], "hand", self.offsets[-1])
        if self.elbow < len(self.limits):
            text += _link(f"link{self.elbow}", "elbow", np.eye(4))
        return f'<robot name="{self.name}">{text}</robot>'

    def write(self) -> str:
        """Write the URDF into a new folder and return its path."""
        path = Path(mkdtemp(prefix="arm-")) / f"{self.name}.urdf"
        path.write_text(self.urdf())
        return str(path)


def _turn(angle: float) -> Array:
    result = np.eye(4)
    result[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return result


def _frame(point: Array, axis: Array) -> Array:
    across = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    across /= np.linalg.norm(across)
    columns = (across, np.cross(axis, across), axis, point)
    return np.vstack((np.column_stack(columns), [0, 0, 0, 1]))


def _link(parent: str, child: str, offset: Array, kind: str = "fixed", hinge: str = "") -> str:
    r = offset[:3, :3]
    level = np.hypot(r[0, 0], r[1, 0])
    roll, yaw = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    if level < 1e-9:
        roll, yaw = np.arctan2(-r[1, 2], r[1, 1]), 0.0
    turn = [roll, np.arctan2(-r[2, 0], level), yaw]
    place, turn = (" ".join(f"{x:.17g}" for x in numbers) for numbers in (offset[:3, 3], turn))
    inertia = '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    return (
        f'<link name="{child}"><inertial>{inertia}</inertial></link>'
        f'<joint name="to_{child}" type="{kind}"><origin xyz="{place}" rpy="{turn}"/>'
        f'<parent link="{parent}"/><child link="{child}"/>{hinge}</joint>'
    )


@dataclass(frozen=True)
class Problem:
    """What a solver is asked.

    Attributes:
        target: pose of the hand, (4, 4).
        start: posture at which to begin, (n,).
        turned: whether the rotation counts, or the position alone.
        tolerance: in metres and radians.
        held: angle of each joint that is locked.
        elbow: where the elbow has to be, (3,), or None.
    """

    target: Array
    start: Array
    turned: bool = True
    tolerance: tuple[float, float] = LOOSE
    held: dict[int, float] = field(default_factory=dict)
    elbow: Array | None = None


class Solver:
    """Solves for one arm.

    Attributes:
        package: on PyPI, whose version is printed.
        label: its name, if that is not the package's.
        at_most: largest number of problems that it solves for a table; fewer if it is slow.
        is_bounded: whether it stops when its time is over.
        positions: whether it can leave the rotation open.
        elbows: whether it takes a second point.
        holds: whether it can hold a joint without being made anew.
    """

    package: ClassVar[str]
    label: ClassVar[str] = ""
    at_most: int = 10**9
    is_bounded: ClassVar[bool] = True
    positions: ClassVar[bool] = True
    elbows: bool = False
    holds: ClassVar[bool] = False

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.random = np.random.default_rng(0)

    def solve(self, problem: Problem) -> Array | None:
        """Return the joint angles, or None."""
        raise NotImplementedError

    def nearest(self, postures: Sequence[Array], problem: Problem) -> Array | None:
        """Return the posture within the limits that is nearest to start or elbow, or None."""
        low, high = self.arm.limits.T
        candidates = np.reshape(postures, (-1, len(low)))
        candidates = candidates - 2 * np.pi * np.round((candidates - problem.start) / (2 * np.pi))
        candidates = candidates + 2 * np.pi * ((candidates < low) * 1.0 - (candidates > high))
        candidates = candidates[np.all((low <= candidates) & (candidates <= high), axis=-1)]
        if not len(candidates):
            return None
        if problem.elbow is None:
            away = np.abs(candidates - problem.start).max(axis=-1)
        else:
            elbows = np.array(
                [self.arm.frames(candidate)[self.arm.elbow, :3, 3] for candidate in candidates]
            )
            away = np.linalg.norm(elbows - problem.elbow, axis=-1)
        return candidates[np.argmin(away)]


class Mmc(Solver):
    """The network of this package."""

    package = "mmc-gym"
    elbows = holds = True

    def __init__(self, arm: Arm) -> None:
        super().__init__(arm)
        self.network = HingeNetwork(HingeArm.from_urdf(arm.write(), base="base", tip="hand"))

    def solve(self, problem: Problem) -> Array | None:
        rotation = problem.target[:3, :3] if problem.turned else None
        points = {} if problem.elbow is None else {ELBOW: problem.elbow}
        return self.network.solve(
            problem.target[:3, 3],
            rotation,
            start=problem.start,
            held=problem.held,
            points=points,
            tolerance=problem.tolerance,
        ).joint_angles

    def solve_all(self, targets: Array, starts: Array) -> Array:
        """Return joint angles (..., n) for poses of the hand (..., 4, 4), all in one call."""
        solution = self.network.solve(targets[..., :3, 3], targets[..., :3, :3], start=starts)
        return solution.joint_angles


class DampedLeastSquares(Solver):
    """Plain damped least squares with clipping and random restarts, compiled by numba."""

    package = "numba"
    label = "damped least squares"
    elbows = holds = True

    def solve(self, problem: Problem, tries: int = 40) -> Array | None:
        held = np.full(len(self.arm.limits), np.nan)
        for joint, angle in problem.held.items():
            held[joint] = angle
        elbow = np.full(3, np.nan) if problem.elbow is None else problem.elbow
        arm = (self.arm.offsets, self.arm.limits, self.arm.elbow)
        asked = (problem.target, problem.start, held, elbow, problem.turned, problem.tolerance)
        return damped_least_squares(*arm, *asked, tries, int(self.random.integers(2**31)))


@njit(cache=True)
def damped_least_squares(
    offsets, limits, elbow_joint, target, start, held, elbow, turned, tolerance, tries, seed
):
    """Minimize the distance of hand and elbow; Levenberg-Marquardt with Chan's damping."""
    np.random.seed(seed)  # noqa: NPY002
    joints = len(limits)
    best, least = start.copy(), np.inf
    frames = np.empty((joints + 1, 4, 4))
    error, jacobian = np.zeros(9), np.zeros((9, joints))
    has_elbow = not np.isnan(elbow[0])
    for attempt in range(tries):
        q = start.copy()
        for joint in range(joints):
            if attempt:
                low, high = limits[joint]
                q[joint] = np.random.uniform(low, high)  # noqa: NPY002
            if not np.isnan(held[joint]):
                q[joint] = held[joint]
        for _ in range(40):
            pose = offsets[0]
            for joint in range(joints):
                frame = frames[joint]
                frame[:] = pose
                sine, cosine = np.sin(q[joint]), np.cos(q[joint])
                for row in range(3):
                    frame[row, 0] = pose[row, 0] * cosine + pose[row, 1] * sine
                    frame[row, 1] = pose[row, 1] * cosine - pose[row, 0] * sine
                pose = np.zeros((4, 4))
                for row in range(4):
                    for column in range(4):
                        for k in range(4):
                            pose[row, column] += frame[row, k] * offsets[joint + 1, k, column]
            hand = pose[:3, 3]
            error[:3] = target[:3, 3] - hand
            distance, angle = np.sqrt((error[:3] ** 2).sum()), 0.0
            if turned:
                error[3:6] = 0.0
                for column in range(3):
                    error[3:6] += np.cross(pose[:3, column], target[:3, column]) / 2
                sine = np.sqrt((error[3:6] ** 2).sum())
                angle = np.arctan2(sine, ((pose * target)[:3, :3].sum() - 1) / 2)
                error[3:6] *= angle / sine if sine > 1e-12 else 1.0
            if has_elbow:
                error[6:] = elbow - frames[elbow_joint, :3, 3]
                distance = max(distance, np.sqrt((error[6:] ** 2).sum()))
            total = (error**2).sum()
            if total < least:
                least = total
                best[:] = q
            if distance < tolerance[0] and angle < tolerance[1]:
                return best
            for joint in range(joints):
                if np.isnan(held[joint]):
                    axis, point = frames[joint, :3, 2], frames[joint, :3, 3]
                    jacobian[:3, joint] = np.cross(axis, hand - point)
                    if turned:
                        jacobian[3:6, joint] = axis
                    if has_elbow and joint < elbow_joint:
                        arm = frames[elbow_joint, :3, 3] - point
                        jacobian[6:, joint] = np.cross(axis, arm)
            normal = jacobian.T @ jacobian
            for joint in range(joints):
                normal[joint, joint] += 0.01 * total + 1e-9
            q += np.linalg.solve(normal, jacobian.T @ error)
            q[:] = np.minimum(np.maximum(q, limits[:, 0]), limits[:, 1])
    return best


class Stepper(Solver):
    """A library of single steps, repeated until the time is up: from the start, then at random.

    The best posture is returned.
    """

    at_most = 2000
    elbows = True
    steps = 12  # before it begins anew; it and the damping are the best of a few on another seed
    damping = 3e-3
    library: Any
    settings: dict[str, Any]  # of each step

    def target(self, pose: Array) -> Any:
        """Return the pose as the library's own."""
        raise NotImplementedError

    def solve(self, problem: Problem) -> Array | None:
        until = time.process_time() + BUDGET
        self.hand.set_target(self.target(problem.target))
        self.hand.set_orientation_cost(float(problem.turned))
        tasks = [self.hand]
        if problem.elbow is not None:
            point = np.eye(4)
            point[:3, 3] = problem.elbow
            self.elbow.set_target(self.target(point))
            tasks.append(self.elbow)
        least, best, posture = np.inf, problem.start, problem.start.copy()
        while True:
            for joint, angle in problem.held.items():
                posture[joint] = angle
            self.configuration.update(posture)
            for _ in range(self.steps):
                errors = [task.compute_error(self.configuration) for task in tasks]
                far = max(float(np.linalg.norm(error[:3])) for error in errors)
                angle = float(np.linalg.norm(errors[0][3:])) * problem.turned
                if far + angle < least:
                    least, best = far + angle, self.configuration.q.copy()
                near = far < problem.tolerance[0] and angle < problem.tolerance[1]
                if near or time.process_time() > until:
                    return best
                settings = self.settings | self.constraints(problem)
                step = self.library.solve_ik(self.configuration, tasks, 1.0, "daqp", **settings)
                self.configuration.integrate_inplace(step, 1.0)
            posture = self.arm.random(self.random)

    def constraints(self, problem: Problem) -> dict[str, Any]:
        """Return what holds joints."""
        return {}


class Mink(Stepper):
    """MuJoCo's kinematics and a quadratic program."""

    package = "mink"
    holds = True

    def __init__(self, arm: Arm) -> None:
        import mink
        import mujoco

        super().__init__(arm)
        compiler = '<mujoco><compiler fusestatic="false"/></mujoco>'
        self.model = mujoco.MjModel.from_xml_string(
            arm.urdf().replace("<link", compiler + "<link", 1)
        )
        self.library, self.configuration = mink, mink.Configuration(self.model)
        self.settings = {"limits": [mink.ConfigurationLimit(self.model)]}
        self.hand = mink.FrameTask("hand", "body", 1.0, 1.0, lm_damping=self.damping)
        self.elbow = mink.FrameTask("elbow", "body", 1.0, 0.0, lm_damping=self.damping)

    def target(self, pose: Array) -> Any:
        return self.library.SE3.from_matrix(pose)

    def constraints(self, problem: Problem) -> dict[str, Any]:
        if not problem.held:
            return {}
        return {"constraints": [self.library.DofFreezingTask(self.model, list(problem.held))]}


class Pink(Stepper):
    """Pinocchio's kinematics and a quadratic program."""

    package = "pin-pink"

    def __init__(self, arm: Arm) -> None:
        import pink
        import pinocchio

        super().__init__(arm)
        model = pinocchio.buildModelFromXML(arm.urdf())
        posture = pinocchio.neutral(model)
        self.target = pinocchio.SE3
        self.library = pink
        self.configuration = pink.Configuration(model, model.createData(), posture)
        limits = [pink.limits.ConfigurationLimit(model)]
        self.settings = {"limits": limits, "safety_break": False}
        self.hand = pink.tasks.FrameTask("hand", 1.0, 1.0, lm_damping=self.damping)
        self.elbow = pink.tasks.FrameTask("elbow", 1.0, 0.0, lm_damping=self.damping)


class TracIk(Solver):
    """TRAC-IK: KDL and NLopt side by side."""

    package = "pytracik"
    positions = False

    def __init__(self, arm: Arm) -> None:
        import pytracik

        super().__init__(arm)
        self.library, self.solvers = pytracik, {}
        for tolerance in (LOOSE, TIGHT):
            # The bound is of each component; it looks at the clock on the wall, hence four times.
            settings = (4 * BUDGET, tolerance[0] / 3**0.5, pytracik.SolveType.Speed)
            solver = pytracik.TRAC_IK("base", "hand", arm.urdf(), *settings)
            pytracik.set_joint_limits(solver, *arm.limits.T.tolist())
            self.solvers[tolerance] = solver

    def solve(self, problem: Problem) -> Array | None:
        import pinocchio

        quaternion = pinocchio.Quaternion(problem.target[:3, :3]).coeffs()
        solver, place = self.solvers[problem.tolerance], problem.target[:3, 3]
        solution = self.library.ik(solver, problem.start, *place, *quaternion)
        return solution[1:] if len(solution) and solution[0] >= 0 else None


class OptIk(Solver):
    """OptIK: sequential quadratic programs in Rust."""

    package = "optik-py"

    def __init__(self, arm: Arm) -> None:
        import optik

        super().__init__(arm)
        self.library, self.robot = optik, optik.Robot.from_urdf_file(arm.write(), "base", "hand")
        self.robot.set_parallelism(1)

    def solve(self, problem: Problem) -> Array | None:
        settings = self.library.SolverConfig(
            max_time=4 * BUDGET,  # by the clock on the wall
            max_restarts=10**6,
            tol_f=problem.tolerance[0] ** 2,
            angular_weight=[float(problem.turned)] * 3,
        )
        solution = self.robot.ik(settings, problem.target, problem.start)
        return None if solution is None else np.array(solution[0])


class Toolbox(Solver):
    """Peter Corke's toolbox: Levenberg-Marquardt in C++."""

    package = "roboticstoolbox-python"

    def __init__(self, arm: Arm) -> None:
        from roboticstoolbox import ET, ETS

        super().__init__(arm)
        elements = []
        for joint, limit in enumerate(arm.limits):
            elements += [ET.SE3(arm.offsets[joint]), ET.Rz(jindex=joint, qlim=limit)]
        self.chain = ETS([*elements, ET.SE3(arm.offsets[-1])])

    def solve(self, problem: Problem) -> Array | None:
        near, angle = problem.tolerance
        mask = np.array([1.0] * 3 + [(near / angle) ** 2 * problem.turned] * 3)
        solution = self.chain.ik_LM(
            problem.target, problem.start, tol=near**2 / 2, mask=mask, k=0.1
        )
        return solution.q if solution.success else None


class IkPy(Solver):
    """ikpy: scipy's least squares, which cannot be stopped."""

    package = "ikpy"
    at_most = 30
    is_bounded = False
    holds = True

    def __init__(self, arm: Arm) -> None:
        from ikpy.chain import Chain

        super().__init__(arm)
        mask = [False, *[True] * len(arm.limits), False]
        self.chain = Chain.from_urdf_file(arm.write(), ["base"], active_links_mask=mask)

    def solve(self, problem: Problem) -> Array | None:
        start = np.clip(problem.start, *(self.arm.limits + np.array([1e-3, -1e-3])).T)
        free = np.ones(len(start), bool)
        for joint, angle in problem.held.items():
            start[joint], free[joint] = angle, False
        self.chain.active_links_mask = np.array([False, *free, False])
        mode = "all" if problem.turned else None
        posture = self.chain.inverse_kinematics_frame(
            problem.target, [0, *start, 0], orientation_mode=mode
        )
        return np.array(posture[1:-1])


class Ssik(Solver):
    """ssik: closed forms, in a module that is built for the arm."""

    package = "ssik"
    positions = False
    elbows = True

    def __init__(self, arm: Arm) -> None:
        super().__init__(arm)
        folder = Path(arm.write()).parent
        build = f"-m ssik.cli build {arm.name}.urdf --base base --ee hand --no-validate".split()
        limit = partial(resource.setrlimit, resource.RLIMIT_CPU, (8, 8))  # seconds
        settings = {"cwd": folder, "check": True, "capture_output": True, "preexec_fn": limit}
        subprocess.run([sys.executable, *build], **settings)
        spec = importlib.util.spec_from_file_location(folder.name, folder / f"{arm.name}_ik.py")
        self.module = importlib.util.module_from_spec(spec)
        sys.modules[folder.name] = self.module  # where its dataclasses look
        spec.loader.exec_module(self.module)

    def solve(self, problem: Problem) -> Array | None:
        settings = {"q_seed": problem.start, "max_solutions": 1} if problem.elbow is None else {}
        solutions = self.module.solve(problem.target, **settings)
        return self.nearest([solution.q for solution in solutions], problem)


class Eaik(Solver):
    """EAIK: closed forms for six joints; of seven, the last is fixed at 64 angles in turn."""

    package = "EAIK"
    positions = False
    holds = True

    def __init__(self, arm: Arm) -> None:
        super().__init__(arm)
        self.last = len(arm.limits) - 1
        self.elbows = self.last < 6  # of seven joints, postures are too many to look at
        frames = arm.frames(np.zeros(self.last + 1))
        self.axes, self.zero = frames[:-1, :3, 2], frames[-1, :3, :3]
        self.offsets = np.diff(frames[:, :3, 3], axis=0, prepend=0.0)
        if not self.robot({} if self.elbows else {self.last: 0.5}).hasKnownDecomposition():
            raise NotImplementedError("no closed form")

    def robot(self, fixed: dict[int, float]) -> Any:
        """Make the library's robot, which takes microseconds."""
        from eaik.IK_HP import HPRobot

        return HPRobot(self.axes, self.offsets, fixed_axes=list(fixed.items()))

    def solve(self, problem: Problem) -> Array | None:
        pose = problem.target.copy()
        pose[:3, :3] = pose[:3, :3] @ self.zero.T
        choices = [problem.held]
        if self.last == 6 and not problem.held:
            start = problem.start[self.last]
            angles = np.linspace(*self.arm.limits[self.last], 64)
            angles = [start, *angles[np.argsort(np.abs(angles - start))]]
            choices = [{self.last: float(angle)} for angle in angles]
        for fixed in choices:
            robot = self.robot(fixed)
            solution = robot.IK(pose) if robot.hasKnownDecomposition() else None
            exact = (
                [q for q, near in zip(solution.Q, solution.is_LS) if not near] if solution else []
            )
            best = self.nearest(exact, problem)
            if best is not None:
                return best
        return None


SOLVERS = (
    *(Mmc, DampedLeastSquares, TracIk, OptIk, Toolbox),
    *(Ssik, Eaik, Mink, Pink, IkPy),
)
