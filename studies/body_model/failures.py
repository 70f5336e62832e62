"""List the episodes of the benchmark in which an agent fails, with the likely cause.

The cause is the first of these that holds:

- out of reach: with the joints that locked, no posture brings the hand to the target;
- left: the hand was at a resting target, and left it before the end;
- stuck: the hand never was at the target, and is at rest;
- late: the hand never was at the target, and is still moving.

The table also counts in how many of these episodes an agent fails that is given the truth about its
body (`known_body.py`; not about obstacles, masses or noise).  Episodes have the numbers that they
have in the battery and in its report.
"""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.patches import Circle
from rich.console import Console
from rich.progress import track
from rich.table import Table

from mmc_gym.benchmark.suite import find_scenarios
from mmc_gym.envs.spec import ReachSetup
from mmc_gym.envs.workspace import Workspace
from mmc_gym.measures import Episode
from mmc_gym.network.chain import node_positions, segments_from_joint_angles
from studies.body_model.known_body import KnownBody
from studies.body_model.playing import play, successes

CAUSES = ("out of reach", "left", "stuck", "late")
REST, AT_REST = 15, 0.02
"""Steps, and segment lengths: a hand that moves less in so many steps is at rest."""


@dataclass(frozen=True)
class Arguments:
    """What to look at.

    Attributes:
        agent: the agent whose failures are listed.
        scenarios: names, see `mmc-gym list scenarios`; all of the battery by default.
        episodes: in each scenario.
        seed: of the episodes; 0 is that of the battery.
        draw: folder for a picture of each failure; none by default.
    """

    agent: str = "mmc-body"
    scenarios: tuple[str, ...] = ()
    episodes: int = 100
    seed: int = 0
    draw: Path | None = None


def cause(episode: Episode, setup: ReachSetup) -> str:
    """Return why an episode failed."""
    hands, targets = episode.seen_hands, episode.targets
    if setup.lock_step:
        workspace = Workspace(setup.body, setup.given_body, setup.body.lockable_joints)
        workspace.rotation = setup.rotation
        if not workspace.contains(targets[-1], episode.joint_angles[-1]):
            return "out of reach"
    stands = (targets == targets[-1]).all(axis=-1)
    if (episode.distances[stands] <= episode.tolerance).any():
        return "left"
    steps = np.linalg.norm(np.diff(hands[-REST - 1 :], axis=0), axis=-1)
    return "stuck" if steps.sum() < AT_REST else "late"


def draw(episode: Episode, setup: ReachSetup, file: Path) -> None:
    """Write a picture: the arm every 0.1 s, the later the darker, target, obstacles, distance."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
    lengths = setup.body.segment_lengths
    nodes = node_positions(segments_from_joint_angles(episode.joint_angles, lengths))
    for step in range(0, len(nodes), 5):
        shade = 0.15 + 0.85 * step / len(nodes)
        left.plot(*nodes[step].T, color="#0072b2", alpha=shade**2, lw=1.5)
    left.plot(*nodes[-1].T, "k.-", lw=2)
    left.plot(*episode.seen_hands.T, color="#d55e00", lw=1)
    left.add_patch(Circle(episode.targets[-1], episode.tolerance, fill=False, ec="#d55e00", lw=2))
    for x, y, radius in setup.body.obstacles:
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
    """Print the table."""
    table = Table("scenario", title=f"failures of {arguments.agent}")
    for heading in ("failures", *CAUSES, "given the truth,\nfails too"):
        table.add_column(heading, justify="right")
    table.add_column("episodes")
    total: Counter[str] = Counter()
    if arguments.draw is not None:
        arguments.draw.mkdir(parents=True, exist_ok=True)
    for scenario in track(list(find_scenarios(arguments.scenarios).values()), transient=True):
        with closing(scenario.make()) as env:
            setup = env.unwrapped.setup
        seen = play(arguments.agent, scenario, arguments.episodes, arguments.seed)
        given = play(KnownBody, scenario, arguments.episodes, arguments.seed)
        failed = np.flatnonzero(successes(seen)[0] == 0)
        total["episodes"] += len(seen[0])
        if not len(failed):
            continue
        causes = {number: cause(seen[0][number], setup) for number in failed}
        counts = Counter(causes.values())
        too = int((successes(given)[0][failed] == 0).sum())
        total.update({"failures": len(failed), "too": too, **counts})
        table.add_row(
            scenario.name,
            f"{len(failed)} of {len(seen[0])}",
            *(str(counts[one] or "") for one in CAUSES),
            str(too or ""),
            " ".join(map(str, failed[:12])) + (" …" if len(failed) > 12 else ""),
        )
        for number in failed if arguments.draw is not None else ():
            name = f"{scenario.name}-{number}-{causes[number].replace(' ', '-')}.png"
            draw(seen[0][number], setup, arguments.draw / name)
    table.add_section()
    sums = (str(total[one] or "") for one in (*CAUSES, "too"))
    table.add_row("all", f"{total['failures']} of {total['episodes']}", *sums, "")
    Console(width=150).print(table)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
