"""Write what the playground takes from the package: `python docs/playground/write_data.py`.

data.js has the weights of the shipped policy and normalizers, and the constants of network and
body.  golden.json has what the package makes of some cases, which a test compares the page's
JavaScript with.  Run it again whenever the shipped weights change; a test says so.
"""

from __future__ import annotations

import base64
import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from mmc_gym._files import write_atomically
from mmc_gym.agents.inverse_kinematics import leave_line
from mmc_gym.agents.policy import load_policy, shipped_file
from mmc_gym.body import ArmParameters, make_arm
from mmc_gym.interface import OFFSET_SCALE, ObservationLayout
from mmc_gym.network import EuclideanNormalizer, LearnedNormalizer, MMCNetwork
from mmc_gym.network.embodied import Embodiment, embodied_run

FOLDER = Path(__file__).parent
NORMALIZERS = {
    "exact": EuclideanNormalizer(),
    "accurate": LearnedNormalizer.shipped("accurate"),
    "paper": LearnedNormalizer.shipped("paper"),
}


def page_data() -> dict[str, Any]:
    """Return what the page needs."""
    network, card = load_policy(shipped_file("ppo", 0))
    if (card.control, card.base_agent) != ("joint_delta", ""):
        raise ValueError(f"the page cannot show {card.control}, {card.base_agent!r}")
    names = [*(f"hidden.{k}" for k in range(len(network.tensors) // 2 - 1)), "mean"]
    default = {field.name: field.default for field in fields(MMCNetwork)}
    arm = ArmParameters()
    return {
        "network": {
            "velocityDamping": default["velocity_damping"],
            "velocityDecay": default["velocity_decay"],
        },
        "normalizers": {
            name: [
                {"weight": weight.tolist(), "bias": bias.tolist()}
                for weight, bias in zip(one.weights, one.biases, strict=True)
            ]
            for name, one in NORMALIZERS.items()
            if isinstance(one, LearnedNormalizer)
        },
        "policy": {
            "activation": network.activation,
            "layers": [
                {part: _base64(network.tensors[f"{name}.{part}"]) for part in ("weight", "bias")}
                for name in names
            ],
        },
        "physics": {
            "substep": arm.substep,
            "substeps": arm.substeps,
            "servoGain": arm.servo_gain,
            "speedLimit": arm.speed_limit,
            "torque": arm.torque_limit,
            "stretched": _stretched_inertia(arm.segment_lengths),
            "driveInertia": arm.drive_inertia,
        },
        "near": OFFSET_SCALE,
        "tolerance": 0.05,
    }


def _base64(array: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(array, "<f4").tobytes()).decode()


def golden() -> dict[str, Any]:
    """Return what the package makes of the cases."""
    random = np.random.default_rng(16)
    return {
        "network": [
            _network_case(random, count, dynamic, name)
            for count in range(2, 9)
            for dynamic in (False, True)
            for name in NORMALIZERS
        ],
        "straight": [_straight_case(random, turn) for turn in (0.0, 0.001, 0.3)],
        "policy": [_policy_case(random) for _ in range(20)],
        "body": [_body_case(random, lengths) for lengths in ((1, 1, 1), (1, 1.5, 0.6), (1,) * 6)],
    }


def _network_case(
    random: np.random.Generator, count: int, dynamic: bool, normalizer: str
) -> dict[str, Any]:
    lengths = random.uniform(0.4, 1.6, count)
    damping = float(random.uniform((count + 1) / 2 + 0.5, 12))
    angles = random.uniform(-1, 1, count)
    target = random.uniform(-1, 1, 2) * count / 2
    locked = np.zeros(count, bool)
    locked[random.choice(count, size=max(1, count // 3), replace=False)] = True
    network = MMCNetwork(
        tuple(lengths),
        damping,
        normalizer=NORMALIZERS[normalizer],
        dynamics="paper" if dynamic else "kinematic",
    )
    start, held = network.state_from_joint_angles(angles), network.inverse(target)
    free = network.run(start, held, 40)
    rigid = embodied_run(network, start, held, Embodiment(locked=locked, joint_angles=angles), 40)
    return {
        "lengths": lengths.tolist(),
        "damping": damping,
        "dynamic": dynamic,
        "normalizer": normalizer,
        "angles": angles.tolist(),
        "target": target.tolist(),
        "locks": [float(angle) if held else None for angle, held in zip(angles, locked)],
        "iterations": 40,
        "free": free.vectors.tolist(),
        "rigid": rigid.vectors.tolist(),
        "jointAngles": free.joint_angles.tolist(),
    }


def _straight_case(random: np.random.Generator, turn: float) -> dict[str, Any]:
    first, lengths = random.uniform(-3, 3), (1.0, 1.5, 0.7)
    angles, direction = np.array([first, turn, 0.0]), first + turn / 3
    target = 2.0 * np.array([np.cos(direction), np.sin(direction)])
    bent = leave_line(angles, target, lengths)
    return {
        "angles": angles.tolist(),
        "lengths": lengths,
        "target": target.tolist(),
        "bent": bent.tolist(),
    }


def _policy_case(random: np.random.Generator) -> dict[str, Any]:
    network, _ = load_policy(shipped_file("ppo", 0))
    angles, speeds = random.uniform(-3, 3, 3), random.uniform(-1, 1, 3)
    target, direction = random.uniform(-2, 2, 2), np.cumsum(angles)
    hand = np.array([np.cos(direction).sum(), np.sin(direction).sum()])
    observation = ObservationLayout(3, 3.0).encode(angles, speeds, hand=hand, target=target)
    return {
        "angles": angles.tolist(),
        "speeds": speeds.tolist(),
        "hand": hand.tolist(),
        "target": target.tolist(),
        "observation": observation.tolist(),
        "action": network.act(observation).tolist(),
    }


def _body_case(random: np.random.Generator, lengths: tuple[float, ...]) -> dict[str, Any]:
    """Let pymunk's arm follow random postures, a quarter of a second each."""
    count, arm = len(lengths), ArmParameters()
    stretched = _stretched_inertia(lengths)
    torque = arm.torque_limit * stretched / _stretched_inertia(arm.segment_lengths)
    simulated = make_arm(
        "pymunk", ArmParameters(segment_lengths=lengths, torque_limit=torque), "position"
    )
    start = random.uniform(-1, 1, count)
    simulated.reset(start)
    goals = start + np.cumsum(random.uniform(-0.5, 0.5, (8, count)), axis=0)
    postures = []
    for goal in goals:
        for _ in range(12):
            simulated.command(goal)
            simulated.step()
        postures.append(np.asarray(simulated.joint_angles).tolist())
    return {
        "lengths": lengths,
        "start": start.tolist(),
        "goals": goals.tolist(),
        "steps": 12,
        "postures": postures,
    }


def _stretched_inertia(lengths: tuple[float, ...]) -> float:
    """Return the inertia of stretched rods of mass 1 about the base."""
    ends = np.cumsum(lengths)
    centres = ends - np.array(lengths) / 2
    return float(np.sum(centres**2 + np.array(lengths) ** 2 / 12))


def data_text() -> str:
    """Return the content of data.js."""
    return f"playground.data = {json.dumps(page_data(), separators=(',', ':'))};\n"


if __name__ == "__main__":
    print(write_atomically(FOLDER / "data.js", data_text()))
    text = json.dumps(golden(), separators=(",", ":")) + "\n"
    print(write_atomically(FOLDER / "golden.json", text))
