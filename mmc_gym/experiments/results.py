"""The result of an experiment: its table of measures, with intervals over subjects, and its figure.

Intervals bootstrap subjects, see `mmc_gym.benchmark.statistics`: each resample averages the drawn
subjects into one curve, and the measures are computed from that curve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, count
from operator import add
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pandas.api.types import is_numeric_dtype
from rich.console import Console

from mmc_gym._console import make_console
from mmc_gym._errors import UserError, require
from mmc_gym._files import write_atomically
from mmc_gym._plotting import COLOURS, LINES, STYLE, ShownFigure, save_figure
from mmc_gym._tables import NONE, Cell, Heading, Row, Table, estimate_cell, print_table
from mmc_gym.agents.body_model.parts import LEARNED
from mmc_gym.benchmark.statistics import expanded_tails, percentile_interval, resampled_means
from mmc_gym.experiments.adaptation import (
    OF_ADAPTATION,
    QUANTITIES,
    Learning,
    Movements,
    learning_of,
    measure_learning,
)
from mmc_gym.experiments.experiment import MARKS, Experiment
from mmc_gym.measures.catalogue import PEOPLE, people, span

RESAMPLES = 500
CYCLE = 4  # trials averaged into one point of the figure
MARKERS = "osD^vP"
_RUN = ["agent", "run", "subject"]
_LEGEND_WIDTH = 44  # characters in a line of the legend
_OFF = ("inf", "0")  # defaults of width, largest error and noise, which are not shown


@dataclass(frozen=True, eq=False, repr=False)
class ExperimentResult:
    """The movements of agents in an experiment."""

    experiment: Experiment
    #: a row per agent, subject and trial, with columns agent, subject (0, 1, …), trial (in the
    #: experiment, from 0), block, phase, perturbation (names joined by "+"), strength (see
    #: `PlannedTrial`), probe (empty for usual trials), aim (instructed, degrees from the target;
    #: hand angle less aim is implicit), target_angle (degrees), start_x, start_y (of the hand),
    #: go_step (control step of the go cue), channel_force (in a `Channel`: the force as a share of
    #: the ideal force, by regression through the origin over the trial); the settings: rate,
    #: retention and the other `LEARNED` of the subject (states separated by commas; empty if it has
    #: none), keeps_all, noise, seed, version (of mmc-gym) and run (a digest of all settings); and
    #: the movement, see `describe_movements`
    trials: pd.DataFrame
    hands: NDArray[np.float32]  #: positions in segment lengths, (rows, steps + 1, 2)
    cursors: NDArray[np.float32]  #: the same of the cursor; of the hand where there is no cursor
    targets: NDArray[np.float32]  #: the same of the target
    control_step: float  #: s
    people: pd.DataFrame | None = None  #: your own human data for the figure, see `check_people`

    @cached_property
    def measures(self) -> pd.DataFrame:
        """The measures of learning with their intervals, see `learning_table`."""
        return learning_table(self)

    @property
    def settings(self) -> dict[str, str]:
        """The settings of each agent's learning and noise, in words; empty if it has none."""
        settings = {}
        names = [name for name in LEARNED if "spread" not in name]
        for agent, rows in self.trials.groupby("agent", sort=False):
            values_by_name = {name: rows[name].unique().tolist() for name in names}
            texts = [
                f"{name} {_span(values)}"
                for name, values in values_by_name.items()
                if values[0] and (name in ("rate", "retention") or values[0] not in _OFF)
            ]
            texts += ["keeps all"] * bool(rows["keeps_all"].iloc[0])
            settings[str(agent)] = ", ".join(texts)
        return settings

    def movements_of(self, agent: str) -> Movements:
        """Return the movements of an agent's subjects."""
        rows = self.trials[self.trials["agent"] == agent].sort_values(["subject", "trial"])
        shape = rows["subject"].nunique(), len(self.experiment.schedule)
        return Movements(
            schedule=self.experiment.schedule,
            angles=rows["target_angle"].to_numpy(np.float64).reshape(shape),
            hands=self.hands[rows.index].reshape(*shape, -1, 2),
            cursors=self.cursors[rows.index].reshape(*shape, -1, 2),
            targets=self.targets[rows.index].reshape(*shape, -1, 2),
            control_step=self.control_step,
            channel_shares=rows["channel_force"].to_numpy(np.float64).reshape(shape),
        )

    def plot(self, figure: Figure | None = None) -> Figure:
        """Draw the `learning_figure` into `figure`, a new one if None, and return it."""
        return learning_figure(self, figure=figure)

    def print(self, console: Console | None = None) -> None:
        """Print the measures; to standard output by default."""
        print_learning(self.measures, console)

    def write(self, out: Path | str) -> list[Path]:
        """Write NAME.trials.csv, NAME.measures.csv and the figure into `out`; return their paths.

        If NAME.trials.csv holds trials of another run, write NAME.2.trials.csv and so on instead.
        """
        runs = {*self.trials[_RUN].astype(str).itertuples(index=False, name=None)}
        first = str(Path(out) / self.experiment.name)
        stems = chain([first], (f"{first}.{number}" for number in count(2)))
        stem = next(stem for stem in stems if _runs_in(Path(f"{stem}.trials.csv")) <= runs)
        written = []
        for kind, table in (("trials", self.trials), ("measures", self.measures)):
            text = table.to_csv(index=False, lineterminator="\n")
            written.append(write_atomically(f"{stem}.{kind}.csv", text))
        return written + save_figure(self.plot(), Path(f"{stem}.curves"))

    def __repr__(self) -> str:
        agents, subjects = self.trials["agent"].unique(), self.trials["subject"].nunique()
        return f"<{self.experiment.name}: {', '.join(agents)}, {subjects} subjects each>"


def _runs_in(path: Path) -> set[tuple[str, ...]]:
    """Return each (agent, run, subject) in a CSV file of trials; empty if the file is missing."""
    if not path.exists():
        return set()
    try:
        runs = pd.read_csv(path, usecols=_RUN, dtype=str, keep_default_na=False)[_RUN]
    except ValueError:  # not a file of trials: equal to no run
        return {(str(path),)}
    return {*runs.itertuples(index=False, name=None)}


def _span(values: Sequence[str]) -> str:
    """Return the setting that all subjects share, or the least and greatest: "0.1 to 0.3"."""
    first = sorted(values, key=lambda text: float(text.split(",")[0]))
    if len(first) == 1:
        return first[0]
    ends = [[float(number) for number in text.split(",")] for text in (first[0], first[-1])]
    return " to ".join(", ".join(f"{number:.2g}" for number in numbers) for numbers in ends)


def learning_table(result: ExperimentResult, resamples: int = RESAMPLES) -> pd.DataFrame:
    """Return a table with a row for each agent and each measure that any agent has a value of.

    Columns: agent, measure, label, unit, decimals, estimate, low, high, count (of subjects),
    missing, source and settings (see `ExperimentResult.settings`).  Rows of the agent "people" hold
    published figures, see `with_people`.
    """
    rows = []
    for agent in result.trials["agent"].unique():
        learning = learning_of(result.movements_of(agent))
        measures = measure_learning(_resampled(learning, resamples))
        tails = expanded_tails(len(learning.errors))
        for quantity in QUANTITIES:
            values, low, high = measures[quantity.name], math.nan, math.nan
            if not math.isnan(values[0]):
                low, high = percentile_interval(values[1:], tails)
            unit = learning.unit if quantity.unit == OF_ADAPTATION else quantity.unit
            facts = {"label": quantity.label, "unit": unit, "decimals": quantity.decimals}
            interval = {"estimate": float(values[0]), "low": low, "high": high}
            counts = {"count": len(learning.errors), "missing": 0, "source": ""}
            rows.append({"agent": agent, "measure": quantity.name, **facts, **interval, **counts})
    table = pd.DataFrame(rows)
    agents_with_value = table.groupby("measure")["estimate"].transform("count")
    whole = with_people(table[agents_with_value > 0], result.experiment.family)
    return whole.assign(settings=whole["agent"].map(result.settings).fillna(""))


def _resampled(of: Learning, resamples: int) -> Learning:
    """Replace subjects by the mean over them, then the mean of each resample: R + 1 rows."""
    jumps = of.corrections
    if jumps:
        jumps = jumps._replace(responses=resampled_means(jumps.responses, resamples))
    return replace(
        of,
        adaptation=resampled_means(of.adaptation, resamples),
        errors=resampled_means(of.errors, resamples),
        corrections=jumps,
    )


def with_people(table: pd.DataFrame, experiment: str = "") -> pd.DataFrame:
    """Return `table` and, below, a row of people for each measure with a published figure.

    `low` and `high` are the published range, equal for a single figure; a bound has NaN at its
    open end.  `experiment` is the family of experiments; empty for single movements.
    """
    cited, rows = people(experiment), []
    for facts in table.drop_duplicates("measure").to_dict("records"):
        if published := cited.get(facts["measure"]):
            low, high = published.low, published.high
            estimate = low if low == high else math.nan
            row = {"agent": PEOPLE, "count": 0, "source": published.authors}
            rows.append(facts | row | {"estimate": estimate, "low": low, "high": high})
    return pd.concat([table, pd.DataFrame(rows)], ignore_index=True)


def settings_note(settings: Mapping[str, str]) -> str:
    """Return the settings as text, one sentence for each agent that has some."""
    return "".join(f" {agent}: {text}." for agent, text in settings.items() if text)


def print_learning(table: pd.DataFrame, console: Console | None = None) -> None:
    """Print a `learning_table`: a row for each measure, a column for each agent and people."""
    console = console or make_console()
    if table.empty:
        console.print("No agent has a value of any measure of learning here.")
        return
    agents = list(table["agent"].unique())
    rows = []
    for _, of_measure in table.groupby("measure", sort=False):
        cell_of = {row["agent"]: _printed(row) for row in of_measure.to_dict("records")}
        cells = tuple(cell_of.get(agent, NONE) for agent in agents)
        label, unit = of_measure[["label", "unit"]].iloc[0]
        rows.append(Row(label, cells, f"[{unit}]" if unit else ""))
    note = "Of the mean over subjects, with 95 % bootstrap intervals over subjects. –: no value."
    note += settings_note(dict(zip(table["agent"], table["settings"], strict=True)))
    print_table(console, Table((Heading(""), *map(Heading, agents)), tuple(rows), note))


def _printed(row: Any) -> Cell:
    if row["agent"] == PEOPLE:
        return Cell(span(row["low"], row["high"]), (row["source"],))
    return estimate_cell(row, row["decimals"])


def check_people(table: pd.DataFrame, experiment: Experiment) -> pd.DataFrame:
    """Check a table of your own human data for the figure, and return it unchanged.

    It needs columns trial (in the experiment, from 0) and adaptation (in the unit of the figure),
    and a row for each trial, or for each subject and trial.  A `UserError` says what does not fit.
    """
    for name in ("trial", "adaptation"):
        if name not in table:
            raise UserError(f"people must have a column {name!r}, got {[*table.columns]}")
        require(is_numeric_dtype(table[name]), f"people's {name}", table[name].iloc[0], "numbers")
    last = len(experiment.schedule) - 1
    for wrong in table.loc[~table["trial"].between(0, last), "trial"]:
        require(False, "people's trial", wrong, f"from 0 to {last}, as in {experiment.name}")
    return table


def learning_figure(
    result: ExperimentResult,
    table: pd.DataFrame | None = None,
    figure: Figure | None = None,
    resamples: int = RESAMPLES,
) -> Figure:
    """Draw the timeline of an experiment and, below, the learning curve of each agent.

    A point is the mean over subjects and `CYCLE` trials, its band the 95 % interval over subjects.
    The curve includes error clamps and blocks without feedback; catch, channel and hidden probes
    are markers elsewhere; other probes are left out.  The bottom row compares agents with people,
    in the measures of `table` (by default `result.measures`) that have a published figure.
    """
    table = result.measures if table is None else table
    compared = list(table.loc[table["agent"] == PEOPLE, "measure"])
    rows = 3 if compared else 2
    with rc_context({**STYLE, "text.parse_math": False}):  # users choose the names of agents
        figure = figure or ShownFigure(7.5, 2.2 * rows)
        ratios = (1, 3, 1.2)[:rows]
        grid = figure.add_gridspec(rows, max(1, len(compared)), height_ratios=ratios)
        above = figure.add_subplot(grid[0, :])
        below = figure.add_subplot(grid[1, :], sharex=above)
        for column, measure in enumerate(compared):
            panel = figure.add_subplot(grid[2, column])
            draw_with_people(panel, table, measure)
            panel.tick_params(labelleft=column == 0)
        result.experiment.plot_timeline(above)
        above.set_xlabel("")
        _draw_curves(below, result, resamples)
        handles, labels = map(add, *(axes.get_legend_handles_labels() for axes in (below, above)))
        figure.legend(
            handles, labels, loc="outside lower center", ncols=3, frameon=False, handlelength=3.5
        )
    return figure


def _draw_curves(axes: Axes, result: ExperimentResult, resamples: int) -> None:
    """Draw the curves of agents, the data of people, block boundaries and full compensation."""
    for number, (agent, settings) in enumerate(result.settings.items()):
        learning = learning_of(result.movements_of(agent))
        lap, colour = divmod(number, len(COLOURS))  # in each lap, other lines go with colours
        line = LINES[(number + lap) % len(LINES)]
        look: Any = {"color": COLOURS[colour], "linestyle": line}
        text = f"{agent} ({settings})" if settings else agent
        axes.plot([], [], **look, label=fill(text, _LEGEND_WIDTH))
        _draw_curve(axes, learning, look, resamples)
    if result.people is not None:
        mean = result.people.groupby("trial")["adaptation"].mean()
        axes.plot(mean.index, mean, "k.", ms=2.5, label=PEOPLE)
    # The trials are the same for all agents: those of the last one serve.
    for begin in np.flatnonzero(np.diff(learning.blocks)) + 0.5:
        axes.axvline(begin, color="0.8", linewidth=0.8, zorder=0)
    full = np.where(learning.kinds == "plain", learning.perturbations, np.nan)
    trials, label = np.arange(len(full)), "full compensation"
    axes.step(trials, full, "0.6", where="mid", linewidth=0.8, label=label)
    is_aimed = any(trial.aim for trial in result.experiment.schedule)
    angle = "hand angle less the aim [°]" if is_aimed else "hand angle [°]"
    label = angle if learning.unit == "°" else "adaptation [share of the deviation]"
    axes.set(xlabel="trial", ylabel=label)


def _draw_curve(axes: Axes, learning: Learning, look: Any, resamples: int) -> None:
    """Draw the mean adaptation of each cycle of trials at its middle, and probes as markers."""
    in_curve = np.isin(learning.kinds, ("plain", "clamp"))
    alone = ~np.isin(learning.blocks, learning.blocks[in_curve])  # blocks without feedback
    in_curve |= alone & np.isin(learning.kinds, ("hidden", "channel"))
    for block in np.unique(learning.blocks):
        trials = np.flatnonzero(in_curve & (learning.blocks == block))
        cycles = np.array_split(trials, max(1, len(trials) // CYCLE))
        of_subjects = [learning.adaptation[:, cycle].mean(axis=1) for cycle in cycles]
        means = resampled_means(np.stack(of_subjects, axis=-1), resamples)
        places = [cycle.mean() for cycle in cycles]
        axes.plot(places, means[0], **look, linewidth=1.2)
        if len(means) > 1:  # a single subject has no band
            ends = np.quantile(means[1:], expanded_tails(len(learning.errors)), axis=0)
            axes.fill_between(places, *ends, color=look["color"], alpha=0.2, linewidth=0)
    for kind, marker in MARKS.items():
        probes = np.flatnonzero((learning.kinds == kind) & ~in_curve)
        means = learning.adaptation[:, probes].mean(axis=0)
        axes.plot(probes, means, marker, color=look["color"], ms=4)


def draw_with_people(axes: Axes, table: pd.DataFrame, measure: str) -> None:
    """Draw a measure of a `learning_table`: agents as points with intervals, people as a band."""
    agents = [agent for agent in table["agent"].unique() if agent != PEOPLE]
    rows = table[table["measure"] == measure].set_index("agent")
    row: Any = rows.loc[PEOPLE]
    low, high = row["low"], row["high"]
    intervals = rows[["estimate", "low", "high"]].reindex(agents)  # NaN without a row
    for place, agent in enumerate(agents):
        estimate, *ends = intervals.loc[agent]
        colour, marker = COLOURS[place % len(COLOURS)], MARKERS[place % len(MARKERS)]
        axes.plot(estimate, -place, marker, color=colour, markersize=5)
        axes.plot(ends, [-place, -place], color=colour)
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
