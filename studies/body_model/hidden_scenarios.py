"""Measure agents in scenarios that nobody tuned them on.

None of them is in the benchmark: other strengths and signs, two perturbations at once, other arms.
`ppo-memory` has met similar ones in training: rotations in both directions, delays of any length,
and sometimes two perturbations at once.  The other policies have met none.  Two kinds of rows are
no longer unseen, because they showed defects of `mmc-body` that were then mended: seven and more
segments (96 and 54 % before), and a delay with joint noise (60 %).

All agents meet the same postures, targets and noise.  The table shows success in per cent, with the
95 % interval over trainings and episodes unless all end alike; – where an agent cannot act.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from mmc_gym.envs.names import as_change, parse_task
from mmc_gym.envs.perturbations import ForceField, SegmentLength, VisuomotorRotation
from mmc_gym.envs.scenarios import Scenario
from studies.body_model.known_body import KnownBody
from studies.body_model.playing import Make, percent, play

AGENTS: tuple[str | Make, ...] = (
    "mmc-body",
    "ik-body",
    KnownBody,
    "optimal-control",
    "ppo-memory",
    "ppo",
    "mmc",
)


def scenario(
    name: str, *perturbations: Any, task: str = "random", **arm: Any
) -> tuple[str, Scenario]:
    """Return a scenario that is not in the benchmark, after the name of its row."""
    return name, Scenario(parse_task(task), tuple(map(as_change, perturbations)), arm)


def of_segments(count: int, *perturbations: str, task: str = "random") -> tuple[str, Scenario]:
    """Return a scenario of an arm with `count` segments of length 1."""
    name = " + ".join([f"{count} segments", *perturbations, *([task] if task != "random" else [])])
    return scenario(name, *perturbations, task=task, segment_lengths=(1.0,) * count)


LIMITS = ((-2.0, 2.0), (-2.5, 2.5), (-2.5, 2.5))
SCENARIOS = (
    scenario("rotation by 30° about (1, 1)", VisuomotorRotation(30.0, (1.0, 1.0))),
    scenario("rotation by −45°", VisuomotorRotation(-45.0)),
    scenario("curl field of −60", ForceField(-60.0)),
    scenario("first segment 30 % longer", SegmentLength(1.3, 0)),
    scenario("first longer, last shorter, 20 %", SegmentLength(1.2, 0), SegmentLength(0.8, -1)),
    scenario("delay-60", "delay-60"),
    scenario("rotation-30 + longer-20", "rotation-30", "longer-20"),
    scenario("rotation-30 + locked-2", "rotation-30", "locked-2"),
    scenario("rotation-30 + delay-100", "rotation-30", "delay-100"),
    scenario("rotation-30 + vision-noise-0.03", "rotation-30", "vision-noise-0.03"),
    scenario("longer-20 + delay-100", "longer-20", "delay-100"),
    scenario("longer-20 + joint-noise-0.02", "longer-20", "joint-noise-0.02"),
    scenario("locked-1 + hand-mass-3", "locked-1", "hand-mass-3"),
    scenario("locked-2 + delay-100", "locked-2", "delay-100"),
    scenario("locks-2 + rotation-30", "locks-2", "rotation-30"),
    scenario("locks-2 + delay-100", "locks-2", "delay-100"),
    scenario("longer-20 + vision-noise-0.1", "longer-20", "vision-noise-0.1"),
    scenario("rotation-30 + joint-noise-0.05", "rotation-30", "joint-noise-0.05"),
    scenario("joint-noise-0.05 + delay-200", "joint-noise-0.05", "delay-200"),
    scenario("gravity-60 + hand-mass-3", "gravity-60", "hand-mass-3"),
    scenario("obstacles-2 + rotation-30", "obstacles-2", "rotation-30"),
    scenario("force-field-60 + vision-noise-0.03", "force-field-60", "vision-noise-0.03"),
    scenario("pursuit + rotation-30", "rotation-30", task="pursuit"),
    scenario("pursuit + delay-100", "delay-100", task="pursuit"),
    scenario("unequal segments 1.4, 1, 0.6", segment_lengths=(1.4, 1.0, 0.6)),
    scenario("joint limits", joint_limits=LIMITS),
    scenario("joint limits + rotation-30", "rotation-30", joint_limits=LIMITS),
    of_segments(2),
    of_segments(4),
    of_segments(4, "rotation-30"),
    of_segments(4, "locked-2"),
    of_segments(4, "longer-20", "delay-100"),
    of_segments(4, task="pursuit"),
    of_segments(5),
    of_segments(7),
    of_segments(7, "rotation-30"),
    of_segments(10),
)


@dataclass(frozen=True)
class Arguments:
    """Measure agents in the hidden scenarios.

    Attributes:
        episodes: episodes of each training of an agent in each scenario.
        seed: seed of the episodes.
        only: play only the scenarios whose name contains this text.
    """

    episodes: int = 200
    seed: int = 70_000
    only: str = ""


def main(arguments: Arguments) -> None:
    """Print the table."""
    names = [one if isinstance(one, str) else "given the truth" for one in AGENTS]
    table = Table(title=f"success %, {arguments.episodes} episodes")
    table.add_column("scenario", no_wrap=True)
    for name in names:
        table.add_column(name, justify="right")
    rows = [row for row in SCENARIOS if arguments.only in row[0]]
    for name, one in track(rows, transient=True):
        played = (play(agent, one, arguments.episodes, arguments.seed) for agent in AGENTS)
        table.add_row(name, *(percent(episodes, interval=True) for episodes in played))
    Console(width=170).print(table)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
