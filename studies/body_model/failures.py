"""List the episodes of the benchmark in which an agent fails, with the likely cause.

The cause is the first of these that holds:

- out of reach: with the joints that locked, no posture brings the hand to the target;
- left: the hand was at a resting target, and left it before the end;
- stuck: the hand was never at the target, and is at rest;
- late: the hand was never at the target, and is still moving.

Another column counts those of these episodes in which an agent that is given its true body fails
too (`known_body.py`; it is not given obstacles, masses or noise).  Episodes are numbered as in the
benchmark and its report.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.patches import Circle
from rich.console import Console
from rich.progress import track

from mmc_gym.benchmark.suite import find_scenarios
from mmc_gym.envs.setup import ReachSetup
from mmc_gym.envs.workspace import Workspace
from mmc_gym.geometry import node_positions, segments_from_joint_angles
from mmc_gym.measures import Episode
from studies.body_model.known_body import KnownBody
from studies.body_model.playing import play, successes
from studies.tables import table_of

CAUSES = ("out of reach", "left", "stuck", "late")
REST_STEPS, REST_PATH = 15, 0.02
"""A hand is at rest if its path in so many steps is shorter than this, segment lengths."""


@dataclass(frozen=True)
class Arguments:
    """List the failures of an agent."""

    agent: str = "mmc-body"  # name of the agent
    # names, see `mmc-gym list scenarios`; all of the benchmark by default
    scenarios: tuple[str, ...] = ()
    episodes: int = 100  # episodes in each scenario
    seed: int = 0  # seed of the episodes; the benchmark's is 0
    draw: Path | None = None  # folder for a picture of each failure; none by default


def cause(episode: Episode, setup: ReachSetup) -> str:
    """Return the cause of a failed episode, one of `CAUSES`."""
    hands, targets = episode.seen_hands, episode.targets
    if (drawn := setup.first).lock_step > 0:
        locked, cursor = drawn.body.lockable_joints, drawn.cursor
        workspace = Workspace(drawn.body, setup.given_body, locked, cursor)
        if not workspace.contains(targets[-1], episode.joint_angles[-1]):
            return "out of reach"
    rests = (targets == targets[-1]).all(axis=-1)
    if (episode.distances[rests] <= episode.tolerance).any():
        return "left"
    steps = np.linalg.norm(np.diff(hands[-REST_STEPS - 1 :], axis=0), axis=-1)
    return "stuck" if steps.sum() < REST_PATH else "late"


def draw(episode: Episode, setup: ReachSetup, file: Path) -> None:
    """Draw the arm every 0.1 s (later ones darker), target and obstacles; and distance by time."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
    lengths = setup.first.body.segment_lengths
    nodes = node_positions(segments_from_joint_angles(episode.joint_angles, lengths))
    for step in range(0, len(nodes), 5):
        shade = 0.15 + 0.85 * step / len(nodes)
        left.plot(*nodes[step].T, color="#0072b2", alpha=shade**2, lw=1.5)
    left.plot(*nodes[-1].T, "k.-", lw=2)
    left.plot(*episode.seen_hands.T, color="#d55e00", lw=1)
    left.add_patch(Circle(episode.targets[-1], episode.tolerance, fill=False, ec="#d55e00", lw=2))
    for x, y, radius in setup.first.body.obstacles:
        left.add_patch(Circle((x, y), radius, color="0.7"))
    reach = sum(lengths) * 1.05
    left.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", title=file.stem)
    times = np.arange(len(episode.distances)) * episode.control_step
    right.semilogy(times, np.maximum(episode.distances, 1e-4))
    right.axhline(episode.tolerance, color="#d55e00", lw=1)
    right.set(xlabel="time [s]", ylabel="distance from the target [lengths]")
    figure.savefig(file, dpi=80)
    plt.close(figure)


def main(arguments: Arguments) -> None:
    rows, total = [], Counter[str]()
    if arguments.draw is not None:
        arguments.draw.mkdir(parents=True, exist_ok=True)
    for scenario in track(list(find_scenarios(arguments.scenarios).values()), transient=True):
        with closing(scenario.make()) as env:
            setup = env.unwrapped.setup
        episodes, *_ = play(arguments.agent, scenario, arguments.episodes, arguments.seed)
        informed = play(KnownBody, scenario, arguments.episodes, arguments.seed)
        failed = np.flatnonzero(successes([episodes])[0] == 0)
        causes = {number: cause(episodes[number], setup) for number in failed}
        both = int((successes(informed)[0][failed] == 0).sum())
        counts = Counter({"episodes": len(episodes), "both": both}) + Counter(causes.values())
        total += counts
        if len(failed):
            rows.append(_row(scenario.name, counts, map(str, failed)))
        for number in failed if arguments.draw is not None else ():
            name = f"{scenario.name}-{number}-{causes[number].replace(' ', '-')}.png"
            draw(episodes[number], setup, arguments.draw / name)
    rows.append(_row("all", total))
    Console(width=150).print(table_of(rows, f"failures of {arguments.agent}"))


def _row(name: str, counts: Counter[str], failed: Iterable[str] = ()) -> dict[str, str]:
    numbers = {reason: str(counts[reason] or "") for reason in CAUSES}
    failures, shown = sum(counts[reason] for reason in CAUSES), list(failed)
    return {
        "scenario": name,
        "failures": f"{failures} of {counts['episodes']}",
        **numbers,
        "given the truth,\nfails too": str(counts["both"] or ""),
        "episodes": " ".join(shown[:12]) + (" …" if len(shown) > 12 else ""),
    }


if __name__ == "__main__":
    main(tyro.cli(Arguments))
