"""The report of a store: one file, HTML or Markdown, that compares agents.

A store holds a benchmark, experiments over trials (`mmc-gym adapt`), or both.  The file is
self-contained, and every number in it is computed from the store.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import ArrayLike

from mmc_gym._errors import UserError, require_choice, require_names
from mmc_gym._files import require_path, write_atomically
from mmc_gym._tables import plain, to_html, to_markdown
from mmc_gym.benchmark.statistics import RESAMPLES
from mmc_gym.benchmark.store import MANIFEST, TRIALS, reasons
from mmc_gym.envs import render
from mmc_gym.measures import MEASURES, words
from mmc_gym.measures.episode import Floats
from mmc_gym.report import tables
from mmc_gym.report.results import REPLAYED_INSTANCES, Results, read_results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mmc_gym.experiments.results import ExperimentResult

__all__ = ["write_report"]

Format = Literal["html", "md"]


def write_report(
    store: Path | str,
    out: Path | str,
    resamples: int = RESAMPLES,
    *,
    focus: Sequence[str] = (),
    format: Format = "html",
    yardstick: str = "",
) -> Path:
    """Write the report of a store, and return its path.

    Args:
        store: folder of a benchmark, of experiments, or of both.
        out: path of the report.
        resamples: bootstrap resamples for the ranking; other tables use at most 500.
        focus: names of the agents that the report is about; by default your own (files, models,
            modules and objects), or else the first that took part.
        format: "html", or "md" for its tables in Markdown.
        yardstick: name of the agent relative to which regret is computed, if any agent was trained
            on ranges; by default the best.

    Raises:
        UserError: if an argument is wrong, or the store is damaged or has no episodes.
    """
    store, out = require_path("store", store), require_path("out", out)
    require_choice("format", format, get_args(Format))
    if out.is_dir():
        raise UserError(f"out must be a file, got the folder {str(out)!r}")
    experiments: list[ExperimentResult] = []
    if (store / TRIALS).exists():
        from mmc_gym.experiments.trials import read_experiments  # takes long, as does matplotlib

        experiments = read_experiments(store)
    if experiments and not (store / MANIFEST).exists():
        agents = chain(*(result.trials["agent"] for result in experiments))
        known = list(dict.fromkeys(agents))
        focus = require_names("focus", focus, known)
        names = words.listed([result.experiment.name for result in experiments])
        shown: dict[str, Any] = {
            "title": words.listed(list(focus) or known),
            "headline": f"Learning over trials in {names}.",
        }
    else:
        results = read_results(store, resamples, focus, yardstick)
        focus, shown = results.focus, _of_benchmark(results, format)
    shown["experiments"] = [
        {
            "experiment": result.experiment,
            "table": tables.experiment_table(result, focus),
            "source": _picture(result.plot()),
        }
        for result in experiments
    ]
    pages = Environment(
        loader=PackageLoader("mmc_gym.report"),
        autoescape=True,  # users choose the names of agents
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    pages.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    pages.filters["html"] = lambda table: Markup(to_html(table))
    pages.filters |= {"plain": plain, "markdown": to_markdown}
    pages.globals |= {"version": version("mmc-gym"), "results": None}
    return write_atomically(out, pages.get_template(f"report.{format}.j2").render(shown))


def _of_benchmark(results: Results, format: Format) -> dict[str, Any]:
    shown: dict[str, Any] = {
        "results": results,
        "title": words.listed(results.focus),
        "headline": _headline(results),
        "ranking": tables.ranking_table(results),
        "scenarios": [tables.scenario_table(results, agent) for agent in results.focus],
        "generalisation": tables.generalisation_table(results),
        "kinds": tables.kinds_table(results),
        "given": tables.given_table(results),
        "failures": tables.failure_table(results),
        "tables": {name: tables.score_table(results, name) for name in results.environments},
        "not_played": reasons(results.manifest.not_played),
    }
    if format == "html":
        from mmc_gym.report.curves import draw_generalisation  # takes long

        shown |= {"replay": replay(results), "learning": _learning_curves(results)}
        figure = draw_generalisation(results) if shown["generalisation"] else None
        shown["strengths"] = figure and _picture(figure)
    return shown


def _headline(results: Results) -> str:
    """Return a sentence for each agent in focus, with its success and rank."""
    success, sentences, ranking = MEASURES["success"], [], results.ranking
    for row in ranking.to_dict("records"):
        if row["agent"] in results.focus:
            interval = success.interval(row["success_low"], row["success_high"])
            share = f"{success.quantity(row['success'])} of its episodes {interval}".rstrip()
            rank = f"rank {row['rank']} of {len(ranking)}"
            sentences.append(f"{row['agent']} ends at the target in {share}, {rank}.")
    return " ".join(sentences)


def _learning_curves(results: Results) -> str | None:
    """Return a picture of all learning curves, see `_picture`; None if no agent in focus has one.

    None, too, if the training seeds of no agent overlap, see `mean_curves`.
    """
    from mmc_gym.report.curves import curve_rows, draw_learning_curves, mean_curves

    cards = {agent: results.identities[agent].cards for agent in results.agents}
    if not any(cards[agent] for agent in results.focus):
        return None
    curves = curve_rows(cards)
    by_steps, by_time = mean_curves(curves, "steps"), mean_curves(curves, "cpu_seconds")
    if by_steps.empty or by_time.empty:
        return None
    return _picture(draw_learning_curves(by_steps, by_time))


def _picture(figure: Figure) -> str:
    """Return a figure as a data URL of its SVG."""
    from mmc_gym._plotting import PLAIN_STYLE, draw_file  # takes long

    content = base64.b64encode(draw_file(figure, "svg", style=PLAIN_STYLE))
    return f"data:image/svg+xml;base64,{content.decode()}"


# The data of the replay: a few movements, as compact JSON, failures of agents in focus first.
#
# Positions and angles are in thousandths, distances from the target in ten-thousandths.  Every
# value but the first of a series is the difference from the one before, so that most have one to
# three digits.  Under a visuomotor rotation the data hold hand and cursor; the distance is the
# cursor's.

_SIDE_BY_SIDE = 4  # agents shown at first
_COLOURS = ("BACKGROUND", "REACHABLE", "BORDER", "OUTLINE", "ROD", "TRACE", "TARGET")
_FITS = 0.02  # largest distance between an arm's end and its hand, segment lengths
_SEEN_APART = 0.001  # segment lengths between a hand and a cursor
_COARSE, _FINE = 1_000, 10_000  # parts of one


def replay(results: Results) -> dict[str, Any]:
    """Return the replay's data: movements by scenario, instance and agent, and settings.

    Of a trained agent, the training with the lowest seed is shown.
    """
    paths = results.paths
    if "hand_z" in paths:  # the replay shows movements in the plane only
        paths = paths[paths["hand_z"].isna()]
    recorded = set() if paths.empty else set(paths["environment"])
    scenes = {
        name: _scenes(results, name) for name in results.replayed_scenarios if name in recorded
    }
    moving = {agent for scene in chain(*scenes.values()) for agent in scene["agents"]}
    return {
        "worlds": {
            name: {
                "step": scenario.control_step,
                "lengths": scenario.segment_lengths,
                "near": scenario.tolerance,
            }
            for name, scenario in results.environments.items()
            if name in scenes
        },
        "agents": [agent for agent in results.replayed if agent in moving],
        "scenes": scenes,
        "chosen": results.replayed[:_SIDE_BY_SIDE],
        "colours": {
            name.lower(): "#{:02x}{:02x}{:02x}".format(*getattr(render, name)) for name in _COLOURS
        },
    }


def _scenes(results: Results, environment: str) -> list[dict[str, Any]]:
    """Return targets and movements of a scenario's shown instances, failures of the focus first."""
    paths = results.paths[results.paths["environment"] == environment]
    failed: dict[int, list[str]] = {}
    for agent in results.focus:
        for instance in results.replayed_failures.get((agent, environment), []):
            failed.setdefault(instance, []).append(agent)
    instances = sorted(
        paths["instance"].unique(), key=lambda number: (number not in failed, number)
    )
    instances = instances[: max(REPLAYED_INSTANCES, len(failed))]
    lengths = results.environments[environment].segment_lengths
    scenes = []
    for instance in instances:
        steps = _steps_of_first_trainings(paths[paths["instance"] == instance])
        target = max((_points(columns, "target") for columns in steps.values()), key=len)
        shown = target if np.ptp(target, axis=0).max() > 0 else target[:1]
        agents = [agent for agent in results.replayed if agent in steps]
        scenes.append(
            {
                "instance": int(instance) + 1,
                "failed": failed.get(instance, []),
                "target": [_compact(column) for column in shown.T],
                "agents": {agent: _movement(steps[agent], lengths) for agent in agents},
            }
        )
    return scenes


def _steps_of_first_trainings(paths: pd.DataFrame) -> dict[str, dict[str, Floats]]:
    """Return the path of each agent's lowest training seed in an instance: columns by agent."""
    steps = {}
    for agent, path in paths.groupby("agent", observed=True):
        seeds = path["training_seed"].fillna(0.0)
        path = path[seeds == seeds.min()].sort_values("step", kind="stable")
        numbers = path.drop(columns=["agent", "environment"])
        steps[str(agent)] = {str(name): numbers[name].to_numpy(np.float64) for name in numbers}
    return steps


def _points(steps: Mapping[str, Floats], name: str) -> Floats:
    return np.stack([steps[f"{name}_x"], steps[f"{name}_y"]], axis=-1)


def _movement(steps: Mapping[str, Floats], lengths: Sequence[float]) -> dict[str, Any]:
    """Return a movement for the replay, with the arm's angles if it has segments of `lengths`."""
    hand, cursor, target = (_points(steps, name) for name in ("hand", "cursor", "target"))
    joints = [values for name, values in steps.items() if name.startswith("joint_angle_")]
    angles = np.array(joints).reshape(-1, len(hand)).T
    angles = angles[:, ~np.isnan(angles).all(axis=0)]  # arms of other agents may have more segments
    distance = np.linalg.norm(cursor - target, axis=-1)
    movement: dict[str, Any] = {
        "hand": [_compact(column) for column in hand.T],
        "distance": _compact(distance, _FINE),
    }
    if np.abs(cursor - hand).max() > _SEEN_APART:
        movement["cursor"] = [_compact(column) for column in cursor.T]
    if angles.size and angles.shape[1] == len(lengths) and not np.isnan(angles).any():
        movement["angles"] = [_compact(column) for column in angles.T]
        movement["lengths"] = [round(length, 3) for length in _lengths(angles, hand, lengths)]
    return movement


def _lengths(angles: Floats, hand: Floats, known: Sequence[float]) -> list[float]:
    """Return segment lengths that put the arm's end at the hand: `known`, or the nearest ones."""
    turned = np.cumsum(angles, axis=1)
    design = np.concatenate([np.cos(turned), np.sin(turned)])
    missed = hand.T.ravel() - design @ np.asarray(known)
    if np.abs(missed).max() <= _FITS:
        return list(known)
    change, *_ = np.linalg.lstsq(design, missed, rcond=None)
    return np.maximum(np.asarray(known) + change, 0.0).tolist()


def _compact(values: ArrayLike, parts: int = _COARSE) -> list[int]:
    """Round values to multiples of 1 / `parts`; return the first multiple, then the differences.

    >>> _compact([1.0, 1.002, 0.9995])
    [1000, 2, -2]
    """
    whole = np.rint(parts * np.asarray(values, dtype=np.float64)).astype(int)
    compact: list[int] = np.diff(whole, prepend=0).tolist()
    return compact
