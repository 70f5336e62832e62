"""Measure agents in scenarios on which nothing was tuned.

None of them is in the benchmark: other strengths and signs, two perturbations at once, other arms.
`ppo-memory` was trained with perturbations of the same kinds, but with one at a time, and without
obstacles.  The other policies were trained with none.  Two kinds of rows are no longer unseen,
because they showed defects of `mmc-body` that were then mended: seven and more segments (96 and
54 % before), and a delay with joint noise (60 %).

All agents play the same postures, targets and noise.  The table shows success in per cent, with the
95 % interval over trainings and episodes unless all end alike; – where an agent cannot act.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import tyro
from rich.console import Console
from rich.progress import track

from mmc_gym.envs.names import as_changes, parse_task
from mmc_gym.envs.perturbations import SegmentLength, VisuomotorRotation
from mmc_gym.envs.scenarios import Scenario, parse_scenario
from studies.body_model.known_body import KnownBody
from studies.body_model.playing import Make, percent, play
from studies.tables import table_of

AGENTS: dict[str, str | Make] = {
    "mmc-body": "mmc-body",
    "ik-body": "ik-body",
    "given the truth": KnownBody,
    **{name: name for name in ("optimal-control", "ppo-memory", "ppo", "mmc")},
}
NAMES = """
    rotation--45 force-field--60 delay-60
    rotation-30+longer-20 rotation-30+locked-2 rotation-30+delay-100 rotation-30+vision-noise-0.03
    rotation-30+joint-noise-0.05 longer-20+delay-100 longer-20+joint-noise-0.02
    longer-20+vision-noise-0.1 locked-1+hand-mass-3 locked-2+delay-100 locks-2+rotation-30
    locks-2+delay-100 joint-noise-0.05+delay-200 gravity-60+hand-mass-3 obstacles-2+rotation-30
    force-field-60+vision-noise-0.03 pursuit+rotation-30 pursuit+delay-100
"""
LIMITS = {"joint_limits": ((-2.0, 2.0), (-2.5, 2.5), (-2.5, 2.5))}


def changed(*perturbations: Any) -> Scenario:
    """Return random targets with perturbations that have no name, or that are named."""
    return Scenario(parse_task("random"), tuple(as_changes(perturbations)))


def of_segments(count: int, name: str = "random") -> Scenario:
    """Return a scenario for an arm with `count` segments of length 1."""
    return parse_scenario(name).with_arguments(segment_lengths=(1.0,) * count)


SCENARIOS = {
    "rotation by 30° about (1, 1)": changed(VisuomotorRotation(30.0, centre=(1.0, 1.0))),
    "first segment 30 % longer": changed(SegmentLength(1.3, 0)),
    "first longer, last shorter, 20 %": changed(SegmentLength(1.2, 0), SegmentLength(0.8, -1)),
    **{name: parse_scenario(name) for name in NAMES.split()},
    "unequal segments 1.4, 1, 0.6": changed().with_arguments(segment_lengths=(1.4, 1.0, 0.6)),
    "joint limits": changed().with_arguments(**LIMITS),
    "joint limits, rotation-30": changed("rotation-30").with_arguments(**LIMITS),
    **{f"{count} segments": of_segments(count) for count in (2, 4, 5, 7, 10)},
    **{
        f"4 segments, {name}": of_segments(4, name)
        for name in ("rotation-30", "locked-2", "longer-20+delay-100", "pursuit")
    },
    "7 segments, rotation-30": of_segments(7, "rotation-30"),
}


@dataclass(frozen=True)
class Arguments:
    """Measure agents in the hidden scenarios."""

    episodes: int = 200  # episodes of each training of an agent in each scenario
    seed: int = 70_000  # seed of the episodes
    only: str = ""  # play only the scenarios whose name contains this text


def main(arguments: Arguments) -> None:
    rows = []
    for name in track([name for name in SCENARIOS if arguments.only in name], transient=True):
        row = {"scenario": name}
        for heading, agent in AGENTS.items():
            episodes = play(agent, SCENARIOS[name], arguments.episodes, arguments.seed)
            row[heading] = percent(episodes, interval=True)
        rows.append(row)
    Console(width=170).print(table_of(rows, f"success %, {arguments.episodes} episodes"))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
