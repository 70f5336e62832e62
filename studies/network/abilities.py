"""Measure what the network does besides inverse kinematics, for arms of 2 to 10 segments.

A solver of inverse kinematics answers one question: which posture brings the hand to a place?  The
network completes whatever is not clamped, so it answers others without a change:

- forward: all segments are clamped, and the hand is read off;
- inverse: the hand is clamped (the table also has damped least squares);
- elbow: the middle joint is held at one place, and the hand is brought to another;
- tray: the direction of the last segment is held, and the hand is brought to its place.

It also fuses senses.  Suppose that the directions of unit segments are sensed with a noise of σ_θ
(radians), and the hand x is seen with a noise of σ_x (segment lengths).  The seen hand is clamped,
and the sensed segments L^s enter the mean with the weight w = (σ_x / σ_θ)².  For any number of
segments the network settles at the minimum of

    |x − ΣL|² + w Σ |L_i − L_i^s|²

which is the most probable posture if the directions have von Mises distributions.  The table
compares it with the best linear estimate (Kalman's, at the sensed posture).  A single step of
damped least squares from that posture with λ = σ_x / σ_θ gives the same estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from mmc_gym.agents.body_model.agent import network_of_body
from mmc_gym.agents.inverse_kinematics import damped_step
from mmc_gym.geometry import Floats, segments_from_joint_angles
from mmc_gym.interface import ReachInterface
from mmc_gym.network import EuclideanNormalizer, LearnedNormalizer, MMCNetwork
from mmc_gym.network.chain import Pair
from mmc_gym.network.embodied import Embodiment, embodied_run


@dataclass(frozen=True)
class Arguments:
    """Measure tasks and fused senses."""

    segments: tuple[int, ...] = (2, 3, 4, 6, 8, 10)  # numbers of segments, N
    arms: int = 500  # arms with each number of segments
    iterations: int = 500  # iterations of the network
    learned: bool = True  # use the learned normalizer instead of the Euclidean one
    seed: int = 0  # seed of postures, targets and noise


NOISE = ((0.02, 0.05), (0.05, 0.05), (0.1, 0.05), (0.1, 0.2))
"""σ_θ, radians, and σ_x, segment lengths."""


def tasks(count: int) -> dict[str, tuple[Pair, ...]]:
    """Return the clamped vectors of each task, as pairs of nodes."""
    hand = (0, count)
    return {
        "forward": tuple((node, node + 1) for node in range(count)),
        "inverse": (hand,),
        "elbow": ((0, count // 2), hand),
        "tray": ((count - 1, count), hand),
    }


def network_of(count: int, arguments: Arguments) -> MMCNetwork:
    """Return the network of `mmc-body` for `count` unit segments."""
    arm = ReachInterface((1.0,) * count, "joint_position", 6.0, 12.0, 0.02)
    normalizer = LearnedNormalizer.shipped() if arguments.learned else EuclideanNormalizer()
    return network_of_body(arm, normalizer=normalizer)


def errors(count: int, arguments: Arguments) -> dict[str, Floats]:
    """Return the error of each task, segment lengths, (arms,).

    It is the distance between R and the sum of all segments, plus that between each other clamped
    vector and the sum of its segments.
    """
    random, network = np.random.default_rng(arguments.seed), network_of(count, arguments)
    starts, goal_angles = random.uniform(-np.pi / 2, np.pi / 2, (2, arguments.arms, count))
    goal = segments_from_joint_angles(goal_angles, network.segment_lengths)
    state, missed = network.state_from_joint_angles(starts), {}
    for task, pairs in tasks(count).items():
        held = {(i, j): goal[:, i:j].sum(axis=1) for i, j in pairs}
        after = network.run(state, network.clamp(held), arguments.iterations)
        off = np.linalg.norm(after.vectors[:, -1] - after.end_effector, axis=-1)
        for (i, j), value in held.items():
            if (i, j) != (0, count):
                off = off + np.linalg.norm(after.segments[:, i:j].sum(axis=1) - value, axis=-1)
        missed[task] = off
    target, posture = goal.sum(axis=1), starts
    for _ in range(arguments.iterations):
        posture = damped_step(posture, target, network.segment_lengths)
    hand = segments_from_joint_angles(posture, network.segment_lengths).sum(axis=1)
    missed["inverse, damped least squares"] = np.linalg.norm(hand - target, axis=-1)
    return missed


def fused(count: int, direction_noise: float, hand_noise: float, arguments: Arguments) -> Floats:
    """Return the root mean square error of the hand by each estimate, segment lengths.

    The estimates are those of the table: posture alone, sight alone, best linear, network.
    """
    random, network = np.random.default_rng(arguments.seed), network_of(count, arguments)
    angles = np.cumsum(random.uniform(-np.pi / 2, np.pi / 2, (arguments.arms, count)), axis=-1)
    hand = np.exp(1j * angles).sum(axis=-1)
    segments = np.exp(1j * (angles + direction_noise * random.standard_normal(angles.shape)))
    felt, noise = segments.sum(axis=-1), random.standard_normal((2, arguments.arms))
    seen = hand + hand_noise * (noise[0] + 1j * noise[1])

    across = np.stack([-segments.imag, segments.real], axis=1)  # the Jacobian
    spread = direction_noise**2 * across @ across.swapaxes(-1, -2)
    gain = spread @ np.linalg.inv(spread + hand_noise**2 * np.eye(2))
    pull = (gain @ _pairs(seen - felt)[..., None])[..., 0]

    body = Embodiment(sensed=_pairs(segments), weight=(hand_noise / direction_noise) ** 2)
    start, held = network.state_from_segments(_pairs(segments)), network.inverse(_pairs(seen))
    after = embodied_run(network, start, held, body, arguments.iterations)
    estimates = (_pairs(felt), _pairs(seen), _pairs(felt) + pull, after.end_effector)
    squares = [((estimate - _pairs(hand)) ** 2).sum(axis=-1).mean() for estimate in estimates]
    return np.sqrt(np.array(squares))


def _pairs(points: np.ndarray) -> Floats:
    return np.stack([points.real, points.imag], axis=-1)


def main(arguments: Arguments) -> None:
    title = f"median error after {arguments.iterations} iterations, and share within 0.05"
    of_tasks = Table("task", *(f"N = {count}" for count in arguments.segments), title=title)
    by_count = [errors(count, arguments) for count in arguments.segments]
    for task in by_count[0]:
        of_arms = [missed[task] for missed in by_count]
        cells = [f"{np.median(error):.4f} {np.mean(error <= 0.05):4.0%}" for error in of_arms]
        of_tasks.add_row(task, *cells)
    headings = ("N", "σ_θ", "σ_x", "posture alone", "sight alone", "best linear", "network")
    of_senses = Table(*headings, title="root mean square error of the hand")
    for count in arguments.segments:
        for noise in NOISE:
            cells = [f"{error:.4f}" for error in fused(count, *noise, arguments)]
            of_senses.add_row(str(count), *map(str, noise), *cells)
    console = Console(width=140)
    console.print(of_tasks, of_senses)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
