"""Learning in experiments over trials: measures with intervals over subjects, and the figure.

Intervals resample subjects with the bootstrap of `mmc_gym.benchmark.statistics`: a curve is the
mean over the drawn subjects, and a measure is one of that curve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from mmc_gym._console import cell, make_console, print_columns
from mmc_gym._errors import require_choice
from mmc_gym._plotting import COLOURS, LINES, STYLE, ShownFigure
from mmc_gym.benchmark.statistics import TAILS, percentile_interval, resampled_means
from mmc_gym.experiments.learning import (
    TWO_STATES,
    correction_gain,
    correction_latency,
    fit_exponential,
    fit_two_states,
    generalization_width,
    initial_direction,
    lateral_deviation,
)
from mmc_gym.measures.catalogue import PEOPLE, Quantity, people, span
from mmc_gym.measures.episode import Floats

if TYPE_CHECKING:
    from mmc_gym.experiments.trials import ExperimentResult

RESAMPLES = 500
AT_START, AT_END = 4, 10  # trials whose mean is the level at the start or end of a block
CYCLE = 4  # trials to a point of the figure
LEAST = 0.01  # share of the perturbation, and deviation in segment lengths; less is nothing
METRES = 0.25  # in a segment length, for an arm of 0.3 + 0.3 + 0.15 m
MARKERS = "osD^vP"

LengthUnit: TypeAlias = Literal["lengths", "m"]
_UNIT = "of adaptation"
QUANTITIES = (
    Quantity(name="deviation", label="first deviation in the field", unit="lengths", decimals=3),
    Quantity(name="rate", label="rate of learning", unit="1/trial", decimals=3),
    Quantity(name="final_adaptation", label="adaptation at the end", unit=_UNIT),
    Quantity(name="after_effect", label="after-effect", unit=_UNIT),
    Quantity(name="retention", label="retained over the rest", unit="fraction"),
    Quantity(name="savings", label="savings", unit="ratio of rates"),
    Quantity(name="width", label="width of generalisation", unit="°", decimals=1),
    Quantity(name="clamp_asymptote", label="asymptote under the clamp", unit=_UNIT),
    Quantity(name="latency", label="latency of corrections", unit="s", decimals=3),
    Quantity(name="gain", label="gain of corrections"),
    *(Quantity(name=name, label=f"{name} of two states", decimals=3) for name in TWO_STATES),
)
"""The measures of `measure_learning`; `_UNIT` stands for that of the adaptation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Learning:
    """The course of learning over trials, by subject or averaged over subjects."""

    adaptation: Floats  #: y, less the mean of the baseline, (..., trials)
    errors: Floats  #: e, (..., trials)
    perturbations: Floats  #: p, 0 for none, (trials,)
    kinds: NDArray[np.str_]  #: "", "clamp", or the name of a probe, (trials,)
    offsets: Floats  #: the target's direction less the trained one, degrees, (trials,)
    blocks: NDArray[np.int64]  #: number of the block, (trials,)
    rests: Floats  #: before the trial, seconds, (trials,)
    unit: str = "°"  #: of adaptation, errors and perturbations
    deviation: float = math.nan  #: first one in a force field, segment lengths
    responses: Floats | None = None  #: to jumps in flight, see `correction_gain`, (..., time)
    jump: tuple[float, float, float] = (math.nan,) * 3  #: size, time and control step in seconds

    @property
    def exposures(self) -> list[NDArray[np.int64]]:
        """Trials with the perturbation that comes first, in its direction, by runs of blocks."""
        first = self.perturbations[np.flatnonzero(self.perturbations)[:1]].sum()
        trained = (self.perturbations * first > 0) & (self.kinds == "")
        numbers = np.unique(self.blocks[trained])
        groups = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1) if len(numbers) else []
        return [np.flatnonzero(trained & np.isin(self.blocks, group)) for group in groups]


def measure_learning(of: Learning) -> dict[str, Floats]:
    """Return the `QUANTITIES` by name, a number for each curve; NaN where there is nothing to see.

    - rate: of the exponential fit to the first exposure; savings: that of the second over it, see
      Zarahn et al. (2008), J. Neurophysiol. 100, 2537.
    - final_adaptation: mean of the last 10 trials of the first exposure.
    - after_effect: of the first 4 without perturbation in the block that follows, see Shadmehr &
      Mussa-Ivaldi (1994), J. Neurosci. 14, 3208.
    - retention: of the 4 trials after the first rest that follows (of all, if its block has fewer),
      over the 10 before it.
    - clamp_asymptote: of the last 10 trials whose error is clamped and not 0, see Morehead et al.
      (2017), J. Cogn. Neurosci. 29, 1061.
    - others: see `mmc_gym.experiments.learning`.
    """
    found = {one.name: np.full(of.adaptation.shape[:-1], math.nan) for one in QUANTITIES}
    found["deviation"][...] = of.deviation
    exposures, least = of.exposures, LEAST * np.abs(of.perturbations).max()

    def level(trials: NDArray[Any]) -> Any:
        return of.adaptation[..., trials].mean(axis=-1) if len(trials) else math.nan

    if exposures:
        begin, end = exposures[0][[0, -1]]
        fits = (fit_exponential(of.adaptation[..., one]) for one in exposures[:2])
        # A hand that turns with the perturbation, not against it, has learned nothing.
        first, *second = (np.where(one[..., 0] > least, one[..., 1], math.nan) for one in fits)
        found["rate"], found["savings"] = first, second[0] / first if second else found["savings"]
        found["final_adaptation"] = level(exposures[0][-AT_END:])
        is_free = (of.perturbations == 0) & (of.kinds != "transfer")
        is_free &= of.blocks == of.blocks[end] + 1
        found["after_effect"][...] = level(np.flatnonzero(is_free)[:AT_START])
        for rest in np.flatnonzero(of.rests[begin + 1 :])[:1] + begin + 1:
            learned = level(np.arange(max(begin, rest - AT_END), rest))
            left = level(np.flatnonzero(of.blocks[rest:] == of.blocks[rest])[:AT_START] + rest)
            found["retention"] = left / np.where(learned > least, learned, math.nan)
        probes = np.flatnonzero(of.kinds[begin:] == "transfer") + begin
        if len(probes):
            learned = of.adaptation[..., probes]
            widths = generalization_width(learned, of.offsets[probes])
            found["width"] = np.where(np.fmax.reduce(learned, axis=-1) > least, widths, math.nan)
    clamped = np.flatnonzero(of.kinds == "clamp")
    if exposures or len(clamped):
        found |= zip(TWO_STATES, np.moveaxis(fit_two_states(of.adaptation, of.errors), -1, 0))
    curves = tuple(range(of.errors.ndim - 1))
    is_shown = np.abs(of.errors[..., clamped]).max(axis=curves, initial=0) > 0.1
    found["clamp_asymptote"][...] = level(clamped[is_shown][-AT_END:])
    if of.responses is not None:
        found["latency"] = np.apply_along_axis(correction_latency, -1, of.responses, *of.jump)
        found["gain"] = correction_gain(of.responses, of.jump[0])
    return found


def learning_of(result: ExperimentResult, agent: str) -> Learning:
    """Return what the subjects of an agent show of learning, (subjects, trials).

    The mean of each subject's baseline at each target is subtracted.  Probes in other directions
    are sorted by direction within their block, since each subject meets them in an own order.  In a
    force field the unit is the mean deviation in its first trial, and what differs between targets
    is taken out, because the field pushes less in some directions.
    """
    schedule = result.experiment.schedule
    blocks = np.array([one.block for one in schedule])
    strengths = np.array([one.strength for one in schedule])
    clamped = np.array(["clamp" in "".join(one.perturbations) for one in schedule])
    kinds = np.array([one.probe for one in schedule])
    kinds = np.where(clamped & (kinds == ""), "clamp", kinds)
    rows = result.trials[result.trials["agent"] == agent].sort_values(["subject", "trial"])
    shape = (rows["subject"].nunique(), len(schedule))
    angles = rows["target_angle"].to_numpy(np.float64).reshape(shape)
    paths = (table[rows.index] for table in (result.hands, result.cursors, result.targets))
    hands, cursors, targets = (one.reshape(*shape, *one.shape[1:]) for one in paths)
    towards = np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))], axis=-1)
    is_field = bool(rows["perturbation"].str.contains("force-field").any())
    measured = lateral_deviation if is_field else initial_direction
    own, seen = (measured(one, hands[:, :, 0] + towards) for one in (hands, cursors))
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
        is_known = abs(deviation) > LEAST and perturbations[first].sum() > 0.5
        errors = own / (deviation if is_known else math.nan)
        adaptation = perturbations - errors
    order = np.tile(np.arange(len(schedule)), (len(own), 1))
    for block in np.unique(blocks):
        here = np.flatnonzero((blocks == block) & (kinds == "transfer"))
        order[:, here] = here[np.argsort(angles[:, here], axis=1, kind="stable")]
    adaptation, errors, ordered = (
        np.take_along_axis(values, order, axis=1) for values in (adaptation, errors, angles)
    )
    found = Learning(
        adaptation=adaptation,
        errors=errors,
        perturbations=perturbations,
        kinds=kinds,
        offsets=(ordered[0] - angles[0, first].sum() + 180) % 360 - 180,
        blocks=blocks,
        rests=np.array([one.rest for one in schedule]),
        unit="fraction" if is_field else "°",
        deviation=abs(deviation),
    )
    jumps = np.flatnonzero(np.char.startswith(kinds, "jump"))
    if not len(jumps):
        return found
    # A jump changes where the hand must go: the target's, or that of the cursor against the hand.
    # A trial that ends before its jump shows nothing of it.
    goals = (targets - (cursors - hands))[:, jumps].astype(np.float64)
    moved = goals - goals[:, :, [int(result.trials["go_step"].max()) + 1]]
    sizes = np.linalg.norm(moved[:, :, -1], axis=-1)
    same = (angles[:, jumps, None] == angles[:, None]) & (kinds == "")
    plain = np.einsum("sjk,sktd->sjtd", same / same.sum(axis=-1, keepdims=True), hands)
    responses = hands[:, jumps] - plain
    jumped = np.argwhere(sizes > 0)
    if not len(jumped):
        return found
    sizes[sizes == 0] = math.nan
    along = np.einsum("sjtd,sjd->sjt", responses, moved[:, :, -1] / sizes[..., None])
    one = tuple(jumped[0])
    step = np.argmax(np.linalg.norm(moved[one], axis=-1) > sizes[one] / 2)
    jump = float(np.nanmean(sizes)), float(step) * result.control_step, result.control_step
    counts = (~np.isnan(along)).sum(axis=1)
    mean = np.nansum(along, axis=1) / np.where(counts, counts, math.nan)
    return replace(found, responses=mean, jump=jump)


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


def learning_table(
    result: ExperimentResult, resamples: int = RESAMPLES, lengths_in: LengthUnit = "lengths"
) -> pd.DataFrame:
    """Return a row for each agent and each measure that some agent has a value of.

    Columns: agent, measure, label, unit, decimals, estimate, low, high, count (of subjects),
    missing, source and settings (see `settings_of`).  A measure that people have a published figure
    of in such an experiment has a row of the agent "people", too, with a source; see
    `beside_people`.

    With `lengths_in` "m" lengths are metres, for an arm as long as a person's.
    """
    require_choice("lengths_in", lengths_in, get_args(LengthUnit))
    rows = []
    for agent in result.trials["agent"].unique():
        learning = learning_of(result, agent)
        names = ["adaptation", "errors"] + ["responses"] * (learning.responses is not None)
        means: dict[str, Any]
        means = {name: resampled_means(getattr(learning, name), resamples) for name in names}
        found = measure_learning(replace(learning, **means))
        for one in QUANTITIES:
            unit = learning.unit if one.unit == _UNIT else one.unit
            factor, unit = (METRES, "m") if (unit, lengths_in) == ("lengths", "m") else (1, unit)
            values = factor * found[one.name]
            is_known = not math.isnan(values[0])
            low, high = percentile_interval(values[1:]) if is_known else (math.nan, math.nan)
            facts = {"label": one.label, "unit": unit, "decimals": one.decimals}
            interval = {"estimate": float(values[0]), "low": low, "high": high}
            count = {"count": len(learning.errors), "missing": 0, "source": ""}
            rows.append({"agent": agent, "measure": one.name, **facts, **interval, **count})
    table = pd.DataFrame(rows)
    has_values = table.groupby("measure")["estimate"].transform(lambda one: one.notna().any())
    whole = beside_people(table[has_values], result.experiment.family)
    return whole.assign(settings=whole["agent"].map(settings_of(result)).fillna(""))


def settings_of(result: ExperimentResult) -> dict[str, str]:
    """Return the rate and retention of each agent that has them, and which keep all, in words."""
    found = {}
    for row in result.trials.drop_duplicates("agent").to_dict("records"):
        texts = [f"{name} {row[name]}" for name in ("rate", "retention") if row.get(name)]
        found[row["agent"]] = ", ".join(texts + ["keeps all"] * bool(row.get("keeps_all")))
    return found


def settings_note(settings: Mapping[str, str]) -> str:
    """Return a sentence for each agent with settings."""
    return "".join(f" {agent}: {text}." for agent, text in settings.items() if text)


def beside_people(table: pd.DataFrame, experiment: str = "") -> pd.DataFrame:
    """Return a table of agents with rows of people below, for measures that they have a figure of.

    `low` and `high` are the published range, equal for a single figure; one of them is NaN for a
    bound.  `experiment` is the family of experiments; empty for single movements.
    """
    cited = people(experiment)
    rows = [
        facts
        | {"agent": PEOPLE, "count": 0, "low": one.low, "high": one.high, "source": one.authors}
        | {"estimate": one.low if one.low == one.high else math.nan}
        for facts in table.drop_duplicates("measure").to_dict("records")
        if (one := cited.get(facts["measure"]))
    ]
    return pd.concat([table, pd.DataFrame(rows)], ignore_index=True)


def print_learning(table: pd.DataFrame, console: Console | None = None) -> None:
    """Print a `learning_table`: a row for each measure, a column for each agent and people."""
    console = console or make_console()
    if table.empty:
        console.print("No agent has a value of any measure of learning here.")
        return
    facts = table.drop_duplicates("measure").set_index("measure")
    units = (f"\n[{unit}]" if unit else "" for unit in facts["unit"])
    columns = {}
    for agent, rows in table.groupby("agent", sort=False):
        cells = {row["measure"]: _printed(row) for row in rows.to_dict("records")}
        columns[str(agent)] = [cells.get(name, "–") for name in facts.index]
    headings = {"": [label + unit for label, unit in zip(facts["label"], units)]}
    note = "Of the mean over subjects, with 95 % bootstrap intervals over subjects. –: no value."
    note += settings_note(dict(zip(table["agent"], table["settings"], strict=True)))
    print_columns(console, headings, columns, note)


def _printed(row: Any) -> str:
    if row["agent"] == PEOPLE:
        return f"{span(row['low'], row['high'])}\n{row['source']}"
    return cell(row, row["decimals"])


def learning_figure(
    result: ExperimentResult,
    table: pd.DataFrame | None = None,
    figure: Figure | None = None,
    resamples: int = RESAMPLES,
) -> Figure:
    """Draw the timeline of an experiment and, below, the learning curve of each agent.

    A point is the mean over subjects and `CYCLE` trials, its band the 95 % interval over subjects.
    Probes in other directions and jumps are left out.  Measures in `table` that people have a
    figure of follow below, see `draw_beside_people`.
    """
    table = pd.DataFrame({"agent": [], "measure": []}) if table is None else table
    compared = list(table.loc[table["agent"] == PEOPLE, "measure"])
    rows = 3 if compared else 2
    with rc_context({**STYLE, "text.parse_math": False}):  # users choose the names of agents
        if figure is None:
            figure = ShownFigure(figsize=(7.5, 2.2 * rows), layout="constrained")
            FigureCanvasAgg(figure)
        ratios = (1, 3, 1.2)[:rows]
        grid = figure.add_gridspec(rows, max(1, len(compared)), height_ratios=ratios)
        above = figure.add_subplot(grid[0, :])
        below = figure.add_subplot(grid[1, :], sharex=above)
        for column, measure in enumerate(compared):
            panel = figure.add_subplot(grid[2, column])
            draw_beside_people(panel, table, measure)
            panel.tick_params(labelleft=column == 0)
        result.experiment.plot_timeline(above)
        above.set_xlabel("")
        for number, (agent, settings) in enumerate(settings_of(result).items()):
            learning = learning_of(result, agent)
            style = LINES[(number + number // len(COLOURS)) % len(LINES)]
            colour = COLOURS[number % len(COLOURS)]
            label = f"{agent} ({settings})" if settings else agent
            below.plot([], [], color=colour, linestyle=style, label=label)
            _draw_curve(below, learning, colour, style, resamples)
        for begin in np.flatnonzero(np.diff(learning.blocks)) + 0.5:
            below.axvline(begin, color="0.8", linewidth=0.8, zorder=0)
        full = np.where(learning.kinds == "", learning.perturbations, np.nan)
        line: Any = {"where": "mid", "linewidth": 0.8, "label": "full compensation"}
        below.step(np.arange(len(full)), full, "0.6", **line)
        if "catch" in learning.kinds:
            below.plot([], [], "x", color="0.4", ms=4, label="catch trials")
        unit = "share of the deviation" if learning.unit == "fraction" else learning.unit
        below.set(xlabel="trial", ylabel=f"adaptation [{unit}]")
        shown = below.get_legend_handles_labels()
        figure.legend(*shown, loc="outside lower center", ncols=4, frameon=False, handlelength=3.5)
    return figure


def draw_beside_people(axes: Axes, table: pd.DataFrame, measure: str) -> None:
    """Draw a measure of a `learning_table`: agents as points with intervals, people as a band."""
    agents = [agent for agent in table["agent"].unique() if agent != PEOPLE]
    found = {row["agent"]: row for row in table[table["measure"] == measure].to_dict("records")}
    row = found[PEOPLE]
    low, high = row["low"], row["high"]
    for place, agent in enumerate(agents):
        one = found.get(agent, {"estimate": math.nan, "low": math.nan, "high": math.nan})
        colour, marker = COLOURS[place % len(COLOURS)], MARKERS[place % len(MARKERS)]
        axes.plot(one["estimate"], -place, marker, color=colour, markersize=5)
        axes.plot([one["low"], one["high"]], [-place, -place], color=colour)
    left, right = min(0.0, axes.get_xlim()[0]), 1.1 * np.nanmax([axes.get_xlim()[1], low, high])
    if low == high:
        axes.axvline(low, color="0.6", linewidth=4, zorder=0)
    else:
        band = max(low, left), right if math.isnan(high) else high
        axes.axvspan(*band, color="0.85", zorder=0)
    axes.set_title(row["label"] + (f" [{row['unit']}]" if row["unit"] else ""))
    axes.set_xlabel(f"people: {span(low, high)}\n{row['source']}", fontsize=6.5)
    axes.set(xlim=(left, right), ylim=(0.5 - len(agents), 0.5))
    axes.set_yticks([-place for place in range(len(agents))], agents)


def _draw_curve(axes: Axes, learning: Learning, colour: str, style: Any, resamples: int) -> None:
    """Draw the mean adaptation of each cycle of trials over the middle of the cycle."""
    in_curve = np.isin(learning.kinds, ("", "clamp"))
    for block in np.unique(learning.blocks):
        trials = np.flatnonzero(in_curve & (learning.blocks == block))
        cycles = np.array_split(trials, max(1, len(trials) // CYCLE))
        of_subjects = [learning.adaptation[:, one].mean(axis=1) for one in cycles]
        means = resampled_means(np.stack(of_subjects, axis=-1), resamples)
        places = [one.mean() for one in cycles]
        axes.plot(places, means[0], color=colour, linestyle=style, linewidth=1.2)
        if len(means) > 1:  # a single subject has no band
            ends = np.quantile(means[1:], TAILS, axis=0)
            axes.fill_between(places, *ends, color=colour, alpha=0.2, linewidth=0)
    catches = np.flatnonzero(learning.kinds == "catch")
    axes.plot(catches, learning.adaptation[:, catches].mean(axis=0), "x", color=colour, ms=4)
