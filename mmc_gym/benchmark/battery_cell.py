"""A cell of the benchmark: one agent, of one training, plays all instances of one environment."""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from typing import Any, Literal

import gymnasium as gym
import numpy as np

from mmc_gym.agents.random import RandomAgent
from mmc_gym.benchmark.entrants import make_for
from mmc_gym.benchmark.entries import Contestant
from mmc_gym.benchmark.reference import has_reference, minimum_jerk_episodes
from mmc_gym.benchmark.store import CellKey, episodes_file, paths_file, sets_file
from mmc_gym.benchmark.suite import BatteryEnvironment
from mmc_gym.measures.rollout import Episode, Predictor, episode_seeds, run_episodes
from mmc_gym.measures.together import run_episodes_together

TIMED = 3
"""Episodes that are played one by one as well: what an action takes is known of them."""

DRAWN = 12
"""Instances whose paths are kept, of the lowest training seed that takes part."""

RECORDING = 2
"""Raised whenever the same episodes would be recorded or measured otherwise: all is played anew."""

_PACKAGES = ("mmc-gym", "gymnasium", "numpy", "scipy", "pandas", "pyarrow", "pymunk")
_SAME = 1e-3  # segment lengths between two rollouts of one episode


@dataclass(frozen=True)
class BatteryCell:
    """What is played.

    Attributes:
        contestant: by whom.
        name: of the environment.
        environment: itself.
        episodes: how many, where the environment does not number its trials.
        seed: that the seeds of the episodes are derived from, the same for all cells.
        fingerprint: of the contestant, which it takes long to find.
        keeps_paths: whether its first paths are kept.
    """

    contestant: Contestant
    name: str
    environment: BatteryEnvironment
    episodes: int
    seed: int
    fingerprint: str = ""
    keeps_paths: bool = True

    @property
    def key(self) -> CellKey:
        """What it is called."""
        return CellKey(self.contestant.agent, self.contestant.training_seed, self.name)

    @property
    def settings(self) -> dict[str, Any]:
        """What its results depend on, as far as it can be told, ready for JSON."""
        return {
            "recording": RECORDING,
            "source": self.contestant.source,
            "fingerprint": self.fingerprint,
            "environment": self.environment.settings,
            "episodes": self.episodes,
            "seed": self.seed,
        }


@dataclass(frozen=True)
class CellOutcome:
    """What came of a cell.

    Attributes:
        status: "skipped" if the agent cannot act in the environment, "failed" if it raised.
        reason: why it was skipped or failed.
        episodes: content of its file of episodes; empty unless played.
        paths: content of its file of paths; None if it keeps none.
        sets: content of its file of set measures; None if none is taken in its environment.
        facts: kept with it: wall_seconds, cpu_seconds, control (the meaning of actions), together
            (whether its episodes were played at once), has_paths, has_sets, `software`.
    """

    status: Literal["played", "skipped", "failed"]
    reason: str = ""
    episodes: bytes = b""
    paths: bytes | None = None
    sets: bytes | None = None
    facts: Mapping[str, Any] | None = None


class _CannotActError(Exception):
    """The agent cannot act in the environment."""


def run_cell(cell: BatteryCell) -> CellOutcome:
    """Play a cell.  What an agent raises is a result, and ends nothing."""
    begin, processor_begin = time.perf_counter(), time.process_time()
    try:
        recorded = _play(cell)
    except _CannotActError as error:
        return CellOutcome("skipped", str(error))
    except Exception as error:
        return CellOutcome("failed", f"{type(error).__name__}: {error}")
    paths = None
    if cell.keeps_paths:
        paths = paths_file(cell.key, recorded.episodes[:DRAWN], recorded.joint_count)
    sets = sets_file(cell.key, recorded.episodes)
    facts = {
        "wall_seconds": round(time.perf_counter() - begin, 3),
        "cpu_seconds": round(time.process_time() - processor_begin, 3),
        "control": recorded.control,
        "together": recorded.together,
        "has_paths": paths is not None,
        "has_sets": sets is not None,
        "software": software(),
    }
    content = episodes_file(cell.key, recorded.episodes, cell.settings, facts)
    return CellOutcome("played", "", content, paths, sets, facts)


@cache
def software() -> dict[str, str]:
    """What results may depend on: versions, by name, and the machine."""
    return {
        **{package: version(package) for package in _PACKAGES},
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }


@dataclass(frozen=True)
class _Recorded:
    episodes: Sequence[Episode]
    control: str
    together: bool
    joint_count: int


def _play(cell: BatteryCell) -> _Recorded:
    instances = cell.environment.instances(cell.episodes)
    seeds = episode_seeds(cell.seed, len(instances))
    if cell.contestant.is_reference:
        return _play_reference(cell, seeds, instances)
    env, agent = _made(cell)
    control, joints = env.unwrapped.control, env.unwrapped.setup.joint_count  # type: ignore[attr-defined]
    timed = run_episodes(agent, env, seeds[:TIMED], options=instances[:TIMED])
    together = _play_together(cell, env, control, seeds, instances)
    if together is None or not (cell.contestant.is_own or _are_same(timed, together)):
        agent = cell.contestant.factory(env)  # a new one: it may remember what it should not
        alone = run_episodes(agent, env, seeds, options=instances)
        return _Recorded(alone, control, False, joints)
    times = [
        replace(episode, action_times=one.action_times) for episode, one in zip(together, timed)
    ]
    return _Recorded([*times, *together[TIMED:]], control, True, joints)


def _made(cell: BatteryCell) -> tuple[gym.Env[Any, Any], Predictor]:
    """The agent, and the environment that it was made for.

    All act by the same actions, but a policy that was trained for others, which have no meaning
    there, by its own.
    """
    try:
        return make_for(cell.contestant.factory, cell.environment.make)
    except ValueError as refusal:
        raise _CannotActError(str(refusal)) from refusal


def _play_together(
    cell: BatteryCell,
    env: gym.Env[Any, Any],
    control: str,
    seeds: Sequence[int],
    instances: Sequence[Mapping[str, Any]],
) -> tuple[Episode, ...] | None:
    """All episodes at once; None if the agent does not take batches of observations."""
    vector = cell.environment.make_vec(len(seeds), control)
    try:
        return run_episodes_together(cell.contestant.factory(env), vector, seeds, instances)
    except Exception:
        if cell.contestant.is_own:
            raise
        return None
    finally:
        vector.close()


def _are_same(alone: Sequence[Episode], together: Sequence[Episode]) -> bool:
    """Whether an agent plays together as it does alone.

    One that takes batches, and keeps in itself what it should keep in its state, does not.
    """
    return all(
        np.allclose(one.hands, other.hands, rtol=0.0, atol=_SAME)
        for one, other in zip(alone, together)
    )


def _play_reference(
    cell: BatteryCell, seeds: Sequence[int], instances: Sequence[Mapping[str, Any]]
) -> _Recorded:
    """The ideal hand, which no perturbation touches; starts and targets are anybody's."""
    env = cell.environment.make()
    if cell.environment.family or not has_reference(env):
        raise _CannotActError("targets wait for the hand, and an ideal one has no arm to perturb")
    joints = env.unwrapped.setup.joint_count  # type: ignore[attr-defined]
    vector = cell.environment.make_vec(len(seeds))
    anybody = run_episodes_together(RandomAgent(joints), vector, seeds, instances)
    vector.close()
    return _Recorded(minimum_jerk_episodes(anybody), "", True, joints)
