"""Measure what each part of `mmc-body`, each switch of its network, and its vigour are worth.

Three tables.  Episodes are paired: all agents play the same postures, targets and noise.

- Parts: success with all parts, without one, and with none; that of an agent that is given what the
  parts identify (`known_body.py`); and that of all parts by other actions than the default, joint
  deltas.  By joint positions an action says where to go, so the servo, which knows the true joint
  angles, makes up for noisy and late senses.
- Switches of the network: the paper's learned normalizer or the Euclidean one, with velocities or
  without.
- Vigour: from the fastest movement that the servos allow (1) to a human-like one (0).  A movement
  to two targets has two velocity peaks, and one that follows a moving target has many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from mmc_gym.agents.body_model.agent import ik_body, mmc_body, network_of_body
from mmc_gym.agents.body_model.imagination import SETTLE
from mmc_gym.agents.body_model.parts import Parts
from mmc_gym.benchmark.suite import find_scenarios
from mmc_gym.envs.scenarios import Playable
from mmc_gym.geometry import segments_from_joint_angles
from mmc_gym.interface import ReachInterface
from mmc_gym.measures import Episode, run_episodes
from mmc_gym.measures.reaching import success, time_to_target
from mmc_gym.measures.speed import minimum_jerk_correlation, velocity_peaks
from mmc_gym.network import EuclideanNormalizer
from studies.body_model.known_body import KnownBody
from studies.body_model.playing import EpisodesByTraining, Make, body_model, percent, play
from studies.tables import table_of

SCENARIOS = """
    random pursuit double-step-200 rotation-30 longer-20 locked-2 locks-2 force-field-60
    hand-mass-10 gravity-60 joint-noise-0.05 vision-noise-0.1 delay-200 vision-delay-200 obstacles-2
    mirror rotation-40+rotation--80-at-1 rotation-60-over-2 gain-1.4-over-2
    motor-gain-0.4 motor-offset-0.2-of-2 servo-gain-0.5 stuck-sensor-2 dropped-numbers-0.1
"""
HUMAN = "random rotation-60 locked-2 locks-2 delay-200 double-step-200 pursuit"
PARTS = {
    "filters": "no filters",
    "bridges_delay": "no delay",
    "identifies_body": "no body",
    "follows_changes": "no changes",
    "finds_motors": "no motors",
    "finds_locks": "no locks",
    "imagines": "no imagination",
    "drives": "no drive",
    "avoids": "no contacts",
}
CONTROLS = ("joint_position", "joint_velocity")
"""Control modes other than the default, in which an agent with all parts is played, too."""
KINEMATIC: dict[str, Any] = {"dynamics": "kinematic", "damping": 2.5}
EUCLIDEAN: dict[str, Any] = {"normalizer": EuclideanNormalizer()}
SWITCHES: dict[str, dict[str, Any]] = {
    "learned\ndynamic": {},
    "learned\nkinematic": KINEMATIC,
    "Euclidean\ndynamic": EUCLIDEAN,
    "Euclidean\nkinematic": {**EUCLIDEAN, **KINEMATIC},
}
VIGOURS = (1.0, 0.5, 0.0)
SETTLED = 0.01
"""A posture has settled if its hand is nearer to the target than this, segment lengths."""
BELL = 0.95
"""A movement is bell-shaped if its correlation with minimum jerk is at least this."""


@dataclass(frozen=True)
class Arguments:
    """Measure parts, switches and vigour."""

    # which tables to print: parts, switches, vigour
    tables: tuple[str, ...] = ("parts", "switches", "vigour")
    # names, see `mmc-gym list scenarios`; by default the most informative ones
    scenarios: tuple[str, ...] = ()
    episodes: int = 200  # episodes of each agent in each scenario
    seed: int = 30_000  # seed of the episodes
    model: str = "mmc"  # internal model of the agents in the table of parts, mmc or ik

    def episodes_of(
        self, agent: Make, scenario: Playable, control: str | None = None
    ) -> EpisodesByTraining:
        """Return the episodes of an agent, by the default control mode if None is given."""
        return play(agent, scenario, self.episodes, self.seed, control)

    def each(self, default: str) -> list[Playable]:
        """Return the scenarios of `--scenarios`, or the default ones if none are given."""
        return list(find_scenarios(self.scenarios or default.split()).values())


def of_parts(arguments: Arguments) -> Table:
    """Return the table of the parts."""
    build = {"mmc": mmc_body, "ik": ik_body}[arguments.model]
    without = {heading: Parts(**{part: False}) for part, heading in PARTS.items()}
    parts_by_heading = {"all": Parts(), **without, "none": Parts(**dict.fromkeys(PARTS, False))}
    agents = {heading: body_model(parts, build) for heading, parts in parts_by_heading.items()}
    if arguments.model == "mmc":
        agents = {"given the truth": KnownBody, **agents}
    rows = []
    for scenario in track(arguments.each(SCENARIOS), transient=True):
        cells = {
            name: percent(arguments.episodes_of(make, scenario)) for name, make in agents.items()
        }
        for control in CONTROLS:  # what the action mode is worth
            cells[f"all,\n{control}"] = percent(
                arguments.episodes_of(agents["all"], scenario, control)
            )
        rows.append({"scenario": scenario.name, **cells})
    title = f"{arguments.model}-body: success %, {arguments.episodes} episodes; acts by joint_delta"
    return table_of(rows, title)


def of_switches(arguments: Arguments) -> Table:
    """Return the table of the network's switches: success, median time to target; its cost."""
    agents = {heading: body_model(**settings) for heading, settings in SWITCHES.items()}
    rows = []
    for scenario in track(arguments.each(SCENARIOS), transient=True):
        row = {"": scenario.name}
        for heading, make in agents.items():
            episodes = arguments.episodes_of(make, scenario)
            row[heading] = f"{percent(episodes)}  {_time(episodes[0]):.2f}"
        rows.append(row)
    courses = [misses(**settings) for settings in SWITCHES.values()]
    times = action_times(list(agents.values()))
    cost = {
        f"iterations to a median miss of {SETTLED}": [
            _first(course, SETTLED) for course in courses
        ],
        f"median miss after {SETTLE}, in lengths": [
            f"{course[SETTLE - 1]:.4f}" for course in courses
        ],
        "time per action of one arm, µs": [f"{1e6 * time:.0f}" for time in times],
    }
    rows += [{"": heading, **dict(zip(agents, cells))} for heading, cells in cost.items()]
    title = f"switches of the network: success %, time to target s, {arguments.episodes} episodes"
    return table_of(rows, title)


def of_vigour(arguments: Arguments) -> Table:
    """Return the table of vigour; all but success is measured in successful episodes."""
    rows = []
    for scenario in track(arguments.each(HUMAN), transient=True):
        for vigour in VIGOURS:
            parts = Parts(vigour=vigour)
            episodes = arguments.episodes_of(body_model(parts), scenario)
            informed = arguments.episodes_of(partial(KnownBody, parts=parts), scenario)
            arrived = [episode for episode in episodes[0] if success(episode)]
            likeness = np.array([minimum_jerk_correlation(episode) for episode in arrived])
            likeness = likeness[~np.isnan(likeness)]  # NaN where the hand began at the target
            peaks = np.array([velocity_peaks(episode) for episode in arrived])
            row = {
                "scenario": scenario.name if vigour == VIGOURS[0] else "",
                "vigour": f"{vigour:g}",
                "success %": percent(episodes),
                "given the truth": percent(informed),
                "time to target, s": f"{_time(arrived):.2f}",
                "correlation with\nminimum jerk, median": f"{np.median(likeness):.3f}",
                f"above {BELL}, %": f"{100 * np.mean(likeness >= BELL):.1f}",
                "one velocity\npeak, %": f"{100 * np.mean(peaks[~np.isnan(peaks)] == 1):.1f}",
            }
            rows.append(row)
    return table_of(rows, f"vigour: {arguments.episodes} episodes")


def misses(arms: int = 500, **settings: Any) -> np.ndarray:
    """Return the median distance of imagined hands from their targets after 1, 2, … iterations."""
    arm = ReachInterface((1.0,) * 3, "joint_position", 6.0, 12.0, 0.02)
    network = network_of_body(arm, **settings)
    starts, goals = np.random.default_rng(0).uniform(-np.pi, np.pi, (2, arms, 3))
    target = segments_from_joint_angles(goals, network.segment_lengths).sum(axis=1)
    state, clamps = network.state_from_joint_angles(starts), network.inverse(target)
    medians = []
    for _ in range(10 * SETTLE):
        state = network.run(state, clamps, 1)
        hands = segments_from_joint_angles(state.joint_angles, network.segment_lengths).sum(axis=1)
        medians.append(np.median(np.linalg.norm(hands - target, axis=-1)))
    return np.array(medians)


def action_times(agents: Sequence[Make], rounds: int = 7) -> np.ndarray:
    """Return the median time per action of one arm, seconds; agents take turns."""
    env = gym.make("MMCReach-v0")
    players = [make(env) for make in agents]
    times = []
    for seed in range(rounds):
        episodes = [run_episodes(player, env, [seed])[0] for player in players]
        times.append([np.median(episode.action_times) for episode in episodes])
    return np.median(times, axis=0)


def _time(episodes: Sequence[Episode]) -> float:
    return float(np.nanmedian([time_to_target(episode) for episode in episodes]))


def _first(misses: np.ndarray, least: float) -> str:
    below = np.flatnonzero(misses < least)
    return str(below[0] + 1) if below.size else f"> {len(misses)}"


TABLES = {"parts": of_parts, "switches": of_switches, "vigour": of_vigour}


def main(arguments: Arguments) -> None:
    for name in arguments.tables:
        Console(width=160).print(TABLES[name](arguments))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
