"""Learning in experiments over trials: measures with intervals over subjects, and the figure.

Intervals resample subjects with the bootstrap of `mmc_gym.benchmark.statistics`: a curve is the
mean over the drawn subjects, and a fit is a fit to that curve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from mmc_gym._console import cell, make_console, print_columns
from mmc_gym._plotting import COLOURS, LINES, STYLE, ShownFigure
from mmc_gym.benchmark.statistics import (
    TAILS,
    Interval,
    bootstrap_interval,
    percentile_interval,
    resampled_means,
)
from mmc_gym.measures.catalogue import Quantity
from mmc_gym.measures.episode import Floats
from mmc_gym.measures.experiment import ADAPTATION, LEARNING_MEASURES, Learning
from mmc_gym.measures.learning import (
    correction_gain,
    correction_latency,
    initial_direction,
    lateral_deviation,
)
from mmc_gym.measures.people import people

if TYPE_CHECKING:
    from mmc_gym.benchmark.trials import ExperimentResult

RESAMPLES = 500
CYCLE = 4  # trials to a point of the figure
LEAST_JUMP = 1e-3  # segment lengths; less is rounding
LEAST_DEVIATION = 0.01  # segment lengths; a field that moves the hand less teaches nothing


def learning_of(result: ExperimentResult, agent: str) -> Learning:
    """Return what the subjects of an agent show of learning, (subjects, trials).

    The mean of each subject's baseline at each target is subtracted.  Probes in other directions
    are sorted by direction within their block, since each subject meets them in an own order.  In a
    force field the unit is the mean deviation in its first trial; the field pushes less in some
    directions, and that is taken out.
    """
    schedule = result.experiment.schedule
    blocks = np.array([one.block for one in schedule])
    strengths = np.array([one.strength for one in schedule])
    clamped = np.array(["clamp" in "".join(one.perturbations) for one in schedule])
    kinds = np.array([one.probe for one in schedule])
    kinds = np.where(clamped & (kinds == ""), "clamp", kinds)
    angles, own, seen, is_field = _errors(result, agent)
    first = np.flatnonzero(strengths)[:1]  # empty without a perturbation
    baseline = _baseline(own, angles, np.arange(len(schedule)) < first.sum())
    own, seen = own - baseline, seen - np.where(clamped, 0.0, baseline)
    sign = np.sign(strengths[first].sum())
    perturbations = np.where(clamped, 0.0, strengths) * sign
    adaptation, errors, deviation = -own * sign, seen * sign, math.nan
    if is_field:
        perturbations /= np.abs(strengths).max()
        own = _without_directions(own, angles, blocks + len(schedule) * (kinds != ""))
        deviation = float(np.nanmean(own[:, first]) / perturbations[first].sum())
        is_known = abs(deviation) > LEAST_DEVIATION and perturbations[first].sum() > 0.5
        errors = own / (deviation if is_known else math.nan)
        adaptation = perturbations - errors
    order = np.tile(np.arange(len(schedule)), (len(own), 1))
    for block in np.unique(blocks):
        here = np.flatnonzero((blocks == block) & (kinds == "transfer"))
        order[:, here] = here[np.argsort(angles[:, here], axis=1, kind="stable")]
    adaptation, errors, angles = (
        np.take_along_axis(values, order, axis=1) for values in (adaptation, errors, angles)
    )
    return Learning(
        adaptation=adaptation,
        errors=errors,
        perturbations=perturbations,
        kinds=kinds,
        offsets=(angles[0] - angles[0, first].sum() + 180) % 360 - 180,
        blocks=blocks,
        rests=np.array([one.rest for one in schedule]),
        unit="fraction" if is_field else "°",
        deviation=abs(deviation),
    )


def _errors(result: ExperimentResult, agent: str) -> tuple[Floats, Floats, Floats, bool]:
    """Return the targets' directions, and how far hand and cursor miss them, (subjects, trials).

    In degrees; if there is a force field, as the last value says, in segment lengths.
    """
    rows = result.trials[result.trials["agent"] == agent].sort_values(["subject", "trial"])
    shape = (rows["subject"].nunique(), -1)
    degrees = rows["target_angle"].to_numpy(np.float64)
    hands, cursors = result.hands[rows.index], result.cursors[rows.index]
    towards = np.stack([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], axis=-1)
    is_field = bool(rows["perturbation"].str.contains("force-field").any())
    measured = lateral_deviation if is_field else initial_direction
    own, seen = (measured(paths, hands[:, 0] + towards) for paths in (hands, cursors))
    return degrees.reshape(shape), own.reshape(shape), seen.reshape(shape), is_field


def _baseline(values: Floats, angles: Floats, before: NDArray[np.bool_]) -> Floats:
    """Return each subject's mean before the perturbation at the same target, 0 without one."""
    same = (angles[:, :, None] == angles[:, None, before]) & ~np.isnan(values[:, None, before])
    known = np.where(same, values[:, None, before], 0.0).sum(axis=-1)
    return known / np.maximum(same.sum(axis=-1), 1)


def _without_directions(values: Floats, angles: Floats, groups: NDArray[np.int64]) -> Floats:
    """Subtract how the mean at each target differs from the mean of its group of trials."""
    found = values.copy()
    for group in np.unique(groups):
        level = np.nanmean(values[:, groups == group])
        for angle in np.unique(angles[:, groups == group]):
            here = (angles == angle) & (groups == group)
            found[here] -= np.nanmean(values[here]) - level
    return found


DEVIATION = Quantity(name="deviation", label="first deviation", unit="lengths", decimals=3)
LATENCY = Quantity(name="correction_latency", label="latency of corrections", unit="s", decimals=3)
GAIN = Quantity(name="correction_gain", label="gain of corrections")


def _corrections(result: ExperimentResult, agent: str) -> dict[Quantity, list[float]]:
    """Return latency and gain of corrections after jumps in flight, of each subject.

    A jump is a change of where the hand must go: of the target, or of the cursor against the hand.
    The paths without one are those of the same subject to the same target.
    """
    of_agent = result.trials[result.trials["agent"] == agent]
    found: dict[Quantity, list[float]] = {LATENCY: [], GAIN: []}
    for _, trials in of_agent.groupby("subject"):
        responses, starts, sizes = list[Any](), list[float](), list[float]()
        for trial in trials[trials["probe"].str.startswith("jump")].itertuples():
            same = (trials["target_angle"] == trial.target_angle) & (trials["probe"] == "")
            row, go_step = int(str(trial.Index)), int(str(trial.go_step))
            goal = result.targets[row] - (result.cursors[row] - result.hands[row])
            goal = goal[go_step + 1 :]
            wanted = (goal[-1] - goal[0]).astype(np.float64)
            is_new = np.linalg.norm(goal - goal[0], axis=-1) > LEAST_JUMP
            if same.any() and is_new[-1]:
                plain = result.hands[trials.index[same]].mean(axis=0)
                sizes.append(float(np.linalg.norm(wanted)))
                responses.append((result.hands[row] - plain) @ wanted / sizes[-1])
                starts.append(int(np.argmax(is_new)) + go_step + 1)
        if responses:
            along = np.stack([responses, np.zeros_like(responses)], axis=-1)
            none, wanted = np.zeros_like(along), np.array([np.mean(sizes), 0.0])
            jump = float(np.mean(starts)) * result.control_step
            latency = correction_latency(along, none, wanted, jump, result.control_step)
            found[LATENCY].append(latency)
            found[GAIN].append(correction_gain(along, none, wanted))
    return found


def learning_table(result: ExperimentResult, resamples: int = RESAMPLES) -> pd.DataFrame:
    """Return a row for each agent and each measure that has a value.

    Columns: agent, measure, label, unit, decimals, estimate, low, high, count (of subjects) and
    missing.  Measures are of the mean curve; latency and gain are means over subjects.
    """
    rows = []
    for agent in result.trials["agent"].unique():
        learning = learning_of(result, agent)
        curves = replace(
            learning,
            adaptation=resampled_means(learning.adaptation, resamples),
            errors=resampled_means(learning.errors, resamples),
        )
        single = Interval(learning.deviation, math.nan, math.nan, len(learning.errors), 0)
        rows.append({"agent": agent, **_facts(DEVIATION), **vars(single)})
        for measure in LEARNING_MEASURES.values():
            found = measure.of(curves)
            ends = percentile_interval(found[1:])
            values = Interval(float(found[0]), *ends, count=len(learning.errors), missing=0)
            rows.append({"agent": agent, **_facts(measure, learning.unit), **vars(values)})
        for quantity, of_subjects in _corrections(result, agent).items():
            values = bootstrap_interval(of_subjects, "mean")
            rows.append({"agent": agent, **_facts(quantity), **vars(values)})
    table = pd.DataFrame(rows)
    has_values = table.groupby("measure")["estimate"].transform(lambda one: one.notna().any())
    return table[has_values].reset_index(drop=True)


def _facts(quantity: Quantity, unit: str = "") -> dict[str, Any]:
    facts = {"measure": quantity.name, "label": quantity.label, "decimals": quantity.decimals}
    return {**facts, "unit": unit if quantity.unit == ADAPTATION else quantity.unit}


def print_learning(table: pd.DataFrame, console: Console | None = None) -> None:
    """Print a `learning_table`: a row for each measure, a column for each agent, then people."""
    console = console or make_console()
    headings, columns = _as_text(table)
    known = people()
    published = [known.get(name) for name in table["measure"].unique()]
    columns["people"] = [f"{one.figure}\n{one.authors}" if one else "–" for one in published]
    note = (
        "Means over subjects with 95 % bootstrap intervals over subjects; fits to the mean curve. "
        "–: no value. People: published values, of other tasks; see `people.yml`."
    )
    print_columns(console, {"": headings}, columns, note)


def _as_text(table: pd.DataFrame) -> tuple[list[str], dict[str, list[str]]]:
    """Return the headings of the rows, and the cells of each agent."""
    facts = table.drop_duplicates("measure")
    headings = [
        f"{label} [{unit}]" if unit else label for label, unit in zip(facts["label"], facts["unit"])
    ]
    columns = {
        str(agent): [cell(row, row["decimals"]) for row in rows.to_dict("records")]
        for agent, rows in table.groupby("agent", sort=False)
    }
    return headings, columns


def learning_figure(result: ExperimentResult, resamples: int = RESAMPLES) -> Figure:
    """Draw the timeline of an experiment and, below, the learning curve of each agent.

    A point is the mean over subjects and `CYCLE` trials, its band the 95 % interval
    over subjects.  Probes in other directions and jumps are left out; catch trials are crosses.
    """
    with rc_context({**STYLE, "text.parse_math": False}):  # users choose the names of agents
        figure = ShownFigure(figsize=(7.5, 4.8), layout="constrained")
        FigureCanvasAgg(figure)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1, 3))
        result.experiment.plot_timeline(above)
        for number, agent in enumerate(result.trials["agent"].unique()):
            learning = learning_of(result, agent)
            style: Any = {
                "color": COLOURS[number % len(COLOURS)],
                "linestyle": LINES[(number + number // len(COLOURS)) % len(LINES)],
            }
            _draw_curve(below, learning, str(agent), style, resamples)
            _, begins = np.unique(learning.blocks, return_index=True)
            for begin in begins[1:]:
                below.axvline(begin + 0.5, color="0.8", linewidth=0.8, zorder=0)
        full = np.where(learning.kinds == "", learning.perturbations, np.nan)
        below.step(
            np.arange(1, len(full) + 1),
            full,
            "0.6",
            where="mid",
            linewidth=0.8,
            label="full compensation",
        )
        unit = "share of the deviation" if learning.unit == "fraction" else learning.unit
        below.set(xlabel="trial", ylabel=f"adaptation [{unit}]")
        figure.legend(loc="outside lower center", ncols=4, frameon=False, handlelength=3.5)
    return figure


def _draw_curve(
    axes: Axes, learning: Learning, label: str, style: Mapping[str, Any], resamples: int
) -> None:
    """Draw the mean adaptation of each cycle of trials over the middle of the cycle."""
    in_curve = np.isin(learning.kinds, ("", "clamp"))
    for block in np.unique(learning.blocks):
        trials = np.flatnonzero(in_curve & (learning.blocks == block))
        cycles = np.array_split(trials, max(1, len(trials) // CYCLE)) if len(trials) else []
        if not cycles:
            continue
        of_subjects = np.stack([learning.adaptation[:, one].mean(axis=1) for one in cycles], -1)
        means = resampled_means(of_subjects, resamples)
        places = [one.mean() + 1 for one in cycles]
        axes.plot(places, means[0], linewidth=1.2, label=label, **style)
        axes.fill_between(
            places, *np.quantile(means[1:], TAILS, axis=0), color=style["color"], alpha=0.2, lw=0
        )
        label = ""
    catches = np.flatnonzero(learning.kinds == "catch")
    means = learning.adaptation[:, catches].mean(axis=0)
    axes.plot(catches + 1, means, "x", color=style["color"], markersize=4)
