"""Both engines against the equations of motion, derived on their own and solved by SciPy.

With the absolute angles θ of the segments as coordinates, the Lagrangian of a chain of rods is

    L = ½ Σ_ij c_ij cos(θ_i − θ_j) θ̇_i θ̇_j + Σ_i b_i (g_x cos θ_i + g_y sin θ_i)

and from it follows Σ_j c_ij (cos(θ_i − θ_j) θ̈_j + sin(θ_i − θ_j) θ̇_j²) = Q_i.
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mmc_gym.body import ArmParameters, make_arm, make_arms
from tests.conftest import by_night

START, SPEEDS, DURATION = [0.4, 1.0, -0.7], [0.9, -1.4, 0.8], 0.5
FIVE = [*SPEEDS, 0.9, -1.4]
STOPS = ((-3, 3), (-3, 1.0), (-3, 3))  # of the joints; the second is at its own


class Lagrangian:
    """Rods with drives and a point mass at the hand, from the parameters alone."""

    def __init__(self, p, torques, held=None):
        lengths, masses = np.array(p.segment_lengths), np.array(p.masses)
        count = len(lengths)
        # How far each mass, of the rods and of the hand, moves with each segment.
        levers = np.tril(np.tile(lengths, (count, 1)), -1) + np.diag(lengths / 2)
        levers, masses = np.vstack([levers, lengths]), np.append(masses, p.hand_mass)
        rods = p.masses * lengths**2 / 12
        drives = [self.stretched(p, joint) * p.drive_inertia for joint in range(count)]
        self.c = np.einsum("k,ki,kj->ij", masses, levers, levers) + np.diag(rods + drives)
        self.b = masses @ levers
        self.lengths, self.gravity = lengths, p.gravity
        self.field = np.zeros((2, 2)) if p.force_field is None else np.array(p.force_field)
        self.friction, self.damping = p.joint_friction, p.joint_damping
        self.pull = np.array(torques) - np.append(torques[1:], 0.0)
        self.hold = np.zeros((0, count))
        if held is not None:
            row = np.zeros(count)
            row[held] = 1.0
            if held > 0:
                row[held - 1] = -1.0
            self.hold = row[None]

    @staticmethod
    def stretched(p, joint):
        """Inertia of the stretched arm about a joint, by cutting it into small pieces."""
        ends = np.cumsum(p.segment_lengths[joint:])
        places = np.linspace(ends - p.segment_lengths[joint:], ends, 100_001)
        return p.masses[joint:] @ np.mean(places**2, axis=0)

    def __call__(self, time, state):
        angles, speeds = np.split(state, 2)
        difference = angles[:, None] - angles
        across = np.stack([-np.sin(angles), np.cos(angles)], axis=-1) * self.lengths[:, None]
        x, y = self.gravity
        forces = self.pull + self.b * (y * np.cos(angles) - x * np.sin(angles))
        forces = forces + across @ (self.field @ (speeds @ across))
        forces = forces - (self.c * np.sin(difference)) @ speeds**2
        turning = np.diff(speeds, prepend=0.0)
        friction = self.friction * np.sign(turning) + self.damping * turning
        forces = forces - friction + np.append(friction[1:], 0.0)
        rows = len(self.hold)
        matrix = np.block(
            [[self.c * np.cos(difference), self.hold.T], [self.hold, np.zeros((rows, rows))]]
        )
        solution = np.linalg.solve(matrix, np.append(forces, np.zeros(rows)))
        return np.append(speeds, solution[: len(angles)])

    def joint_angles(self, speeds):
        start = np.append(np.cumsum(np.resize(START, len(speeds))), np.cumsum(speeds))
        end = solve_ivp(self, (0, DURATION), start, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
        return np.diff(end[: len(speeds)], prepend=0.0)


CASES = {
    "free": ({}, [0.0, 0.0, 0.0], SPEEDS, None),
    "driven": ({}, [12.0, -7.0, 2.0], SPEEDS, None),
    "bare rods": ({"drive_inertia": 0.0}, [3.0, -2.0, 0.5], SPEEDS, None),
    "limited": ({"joint_limits": STOPS}, [2.0, 30.0, 0.5], [0.3, 0, 0.4], 1),
    "locked": ({"lockable_joints": (1,)}, [12.0, -7.0, 2.0], [0.9, 0.0, 0.8], 1),
    "loaded": ({"hand_mass": 3.0}, [12.0, -7.0, 2.0], SPEEDS, None),
    "hanging": ({"gravity": (0.3, -9.81)}, [12.0, -7.0, 2.0], SPEEDS, None),
    "in the field": ({"force_field": ((0.0, 20.0), (-20.0, 0.0))}, [12.0, -7.0, 2.0], SPEEDS, None),
    "in honey": ({"force_field": ((-6.0, 0.0), (0.0, -6.0))}, [12.0, -7.0, 2.0], SPEEDS, None),
    "oiled": ({"joint_damping": 3.0}, [12.0, -7.0, 2.0], SPEEDS, None),
    "rubbing": ({"joint_friction": 1.5, "joint_damping": 0.5}, [12.0, -7.0, 2.0], SPEEDS, None),
    "of five": ({"segment_lengths": (0.5,) * 5}, [1.0, 0.0, -0.5, 1.0, 0.0], FIVE, None),
}


@pytest.mark.parametrize("case", CASES)
def test_an_arm_obeys_the_equations_of_motion(engine, case):
    settings, torques, speeds, held = CASES[case]
    exact, errors = Lagrangian(ArmParameters(**settings), torques, held).joint_angles(speeds), []
    for substep in (0.002, 0.0005):
        steps = round(DURATION / substep)
        p = ArmParameters(**settings, speed_limit=100.0, substep=substep, substeps=steps)
        arm = make_arm(engine, p, "torque")
        arm.reset(np.resize(START, len(speeds)), speeds)
        arm.lock()
        arm.command(torques)
        arm.step()
        errors.append(np.abs(arm.joint_angles - exact).max())
    assert errors[0] < 0.02
    assert errors[1] < max(0.4 * errors[0], 1e-6)  # of first order: a quarter


CONVERGED = {
    "one segment": ({"segment_lengths": (1.0,), "gravity": (1.0, -9.81)}, "torque"),
    "five segments": ({"segment_lengths": (1.0, 0.8, 1.2, 0.9, 1.1)}, "position"),
    "limits": ({"joint_limits": ((-2.0, 2.0),) * 3}, "position"),
    "locks": ({"lockable_joints": (1,)}, "position"),
    "gravity": ({"gravity": (0.0, -60.0)}, "position"),
    "hand mass 1": ({"hand_mass": 1.0}, "position"),
    "hand mass 10": ({"hand_mass": 10.0}, "position"),
    "velocity": ({}, "velocity"),
    "torque": ({}, "torque"),
    "torque, locks": ({"lockable_joints": (1,)}, "torque"),
    "friction": ({"joint_friction": 100.0, "joint_damping": 20.0}, "position"),
    "friction, torque": ({"joint_friction": 30.0, "gravity": (0.0, -10.0)}, "torque"),
    "field": ({"force_field": ((0.0, 60.0), (-60.0, 0.0))}, "position"),
}
BY_DAY = {*CONVERGED} - {"locks", "gravity", "hand mass 1", "torque", "friction, torque"}


@pytest.mark.parametrize("case", by_night(CONVERGED, BY_DAY))
def test_pymunk_has_converged_to_the_exact_engine(case):
    """Joint angles of 64 arms after 2 s of random commands."""
    settings, servo = CONVERGED[case]
    p, ends = ArmParameters(**settings), []
    shape = 64, len(p.segment_lengths)
    largest = {"position": 0.5, "velocity": p.speed_limit, "torque": 50.0}[servo]
    for engine in ("pymunk", "analytic"):
        random = np.random.default_rng(0)
        arms = make_arms(engine, p, 64, servo)
        arms.reset(random.uniform(-1.9, 1.9, shape))
        for step in range(100):
            if step == 25:
                arms.lock(np.arange(64))
            if step % 4 == 0:
                values = random.normal(0.0, largest, shape)
                if servo == "position":
                    values += arms.joint_angles
            arms.command(values)
            arms.step()
        ends.append(arms.joint_angles.copy())
    turns = np.remainder(ends[1] - ends[0] + math.pi, 2 * math.pi) - math.pi
    errors = np.abs(turns).max(axis=-1)
    assert np.median(errors) < 0.005
    assert errors.max() < 0.05
