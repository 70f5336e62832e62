"""The data of the replay: a few movements, as compact JSON, first those in which the focus fails.

Positions and angles are in thousandths, distances from the target in ten-thousandths.  Every value
but the first of a series is the difference from the one before, so that most have one to three
digits.  Under a visuomotor rotation, where agents see a cursor in place of the hand, the data hold
both, and the distance is the cursor's, as it is in success and in all measures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmc_gym.envs import render
from mmc_gym.measures.episode import Floats
from mmc_gym.report.results import REPLAYED_INSTANCES, Results

_SIDE_BY_SIDE = 4  # agents shown at first
_COLOURS = ("BACKGROUND", "REACHABLE", "BORDER", "OUTLINE", "ROD", "TRACE", "TARGET")
_FITS = 0.02  # largest distance between an arm's end and its hand, segment lengths
_SEEN_APART = 0.001  # segment lengths between a hand and a cursor
_COARSE, _FINE = 1_000, 10_000  # parts of one


def replay(results: Results) -> dict[str, Any]:
    """Return movements by scenario, instance and agent, and the settings of the scenarios.

    Trained agents are shown by their first training.
    """
    agents = results.replayed
    paths = results.paths
    if "hand_z" in paths:  # it shows the plane
        paths = paths[paths["hand_z"].isna()]
    recorded = set() if paths.empty else set(paths["environment"])
    scenes = {key: _scenes(results, key) for key in results.replayed_scenarios if key in recorded}
    there = {agent for scene in chain(*scenes.values()) for agent in scene["agents"]}
    return {
        "worlds": {
            key: {"step": one.control_step, "lengths": one.segment_lengths, "near": one.tolerance}
            for key, one in results.environments.items()
            if key in scenes
        },
        "agents": [agent for agent in agents if agent in there],
        "scenes": scenes,
        "chosen": agents[:_SIDE_BY_SIDE],
        "colours": {
            name.lower(): "#{:02x}{:02x}{:02x}".format(*getattr(render, name)) for name in _COLOURS
        },
    }


def _scenes(results: Results, environment: str) -> list[dict[str, Any]]:
    """Return target and movements of each episode that is shown, failures of the focus first."""
    paths = results.paths[results.paths["environment"] == environment]
    failed: dict[int, list[str]] = {}
    for agent in results.focus:
        for instance in results.replayed_failures.get((agent, environment), []):
            failed.setdefault(instance, []).append(agent)
    instances = sorted(paths["instance"].unique(), key=lambda one: (one not in failed, one))
    instances = instances[: max(REPLAYED_INSTANCES, len(failed))]
    steps = _steps_of_first_trainings(paths[paths["instance"].isin(instances)])
    lengths = results.environments[environment].segment_lengths
    scenes = []
    for instance in instances:
        played = {agent: steps[instance, agent] for number, agent in steps if number == instance}
        target = max((_points(one, "target") for one in played.values()), key=len)
        shown = target if np.ptp(target, axis=0).max() > 0 else target[:1]
        agents = [agent for agent in results.replayed if agent in played]
        scenes.append(
            {
                "instance": int(instance) + 1,
                "failed": failed.get(instance, []),
                "target": [_compact(column) for column in shown.T],
                "agents": {agent: _movement(played[agent], lengths) for agent in agents},
            }
        )
    return scenes


def _steps_of_first_trainings(paths: pd.DataFrame) -> dict[tuple[int, str], dict[str, Floats]]:
    """Return the columns of each agent's lowest training seed, by instance and agent."""
    paths = paths.sort_values("step", kind="stable")
    numbers = paths.drop(columns=["agent", "environment"])
    columns = {str(name): numbers[name].to_numpy(np.float64) for name in numbers}
    found = {}
    groups: Any = paths.groupby(["instance", "agent"], observed=True).indices
    for key, rows in groups.items():
        seeds = np.nan_to_num(columns["training_seed"][rows])
        first = rows[seeds == seeds.min()]
        found[key] = {name: values[first] for name, values in columns.items()}
    return found


def _points(steps: Mapping[str, Floats], name: str) -> Floats:
    return np.stack([steps[f"{name}_x"], steps[f"{name}_y"]], axis=-1)


def _movement(steps: Mapping[str, Floats], given: Sequence[float]) -> dict[str, Any]:
    hand, cursor, target = (_points(steps, name) for name in ("hand", "cursor", "target"))
    joints = [values for name, values in steps.items() if name.startswith("joint_angle_")]
    angles = np.array(joints).reshape(-1, len(hand)).T
    angles = angles[:, ~np.isnan(angles).all(axis=0)]  # others may have arms of more segments
    distance = np.linalg.norm(cursor - target, axis=-1)
    movement: dict[str, Any] = {
        "hand": [_compact(column) for column in hand.T],
        "distance": _compact(distance, _FINE),
    }
    if np.abs(cursor - hand).max() > _SEEN_APART:
        movement["cursor"] = [_compact(column) for column in cursor.T]
    if angles.size and angles.shape[1] == len(given) and not np.isnan(angles).any():
        movement["angles"] = [_compact(column) for column in angles.T]
        movement["lengths"] = [round(length, 3) for length in _lengths(angles, hand, given)]
    return movement


def _lengths(angles: Floats, hand: Floats, given: Sequence[float]) -> list[float]:
    """Return the segment lengths, nearest to the given, that put the end of the arm at the hand.

    The body may have other segment lengths than agents are given.
    """
    turned = np.cumsum(angles, axis=1)
    design = np.concatenate([np.cos(turned), np.sin(turned)])
    missed = np.concatenate([hand[:, 0], hand[:, 1]]) - design @ np.asarray(given)
    if np.abs(missed).max() <= _FITS:
        return list(given)
    change, *_ = np.linalg.lstsq(design, missed, rcond=None)
    return [max(float(length), 0.0) for length in np.asarray(given) + change]


def _compact(values: ArrayLike, parts: int = _COARSE) -> list[int]:
    """Return values in parts of one, such as thousandths: the first, then the differences.

    >>> _compact([1.0, 1.002, 0.9995])
    [1000, 2, -2]
    """
    whole = np.rint(parts * np.asarray(values, dtype=np.float64)).astype(int)
    compact: list[int] = np.diff(whole, prepend=0).tolist()
    return compact
