"""Which of people's movements and learning do agents show?  Agents as points, people as bands.

`mmc_gym/measures/people.yml` has the published figures, of which task they are, and how ours
differs.  There is no score: a quantity is near the one of people or not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import tyro
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape
from rich.progress import track

from mmc_gym.agents.body_model.agent import ik_body
from mmc_gym.agents.body_model.parts import Parts
from mmc_gym.benchmark.statistics import sample_interval
from mmc_gym.benchmark.suite import SCENARIOS
from mmc_gym.experiments.results import (
    ExperimentResult,
    draw_with_people,
    learning_figure,
    learning_table,
    with_people,
)
from mmc_gym.experiments.trials import run_experiment
from mmc_gym.measures import MEASURES
from mmc_gym.measures.catalogue import PEOPLE, people, span
from studies.body_model.playing import body_model, play
from studies.drawing import STYLE, save_figure
from studies.laws import LAWS
from studies.tables import markdown_table, table_of

MOVEMENTS = {  # measures, and the scenarios that they are taken in
    "centre-out": ("peak_to_mean", "time_to_peak"),
    "pursuit": ("speed_curvature_exponent", "speed_curvature_r_squared"),
    "distances": ("fitts_slope", "fitts_r_squared"),
    "paper": ("posture_variability",),
}
EXPERIMENTS = {  # measures, and the experiments that they are taken in
    "rotation-30": (
        *("A_f", "A_s", "B_f", "B_s"),
        *("A", "B", "rate", "final_adaptation"),
        "after_effect",
    ),
    "curl-field-60": ("deviation", "rate", "final_adaptation", "after_effect"),
    "savings-30": ("savings",),
    "retention-30": ("retention",),
    "generalisation-30": ("width",),
    "clamp-15": ("clamp_asymptote",),
    "cursor-jump-10": ("latency", "gain"),
}
METRES = 0.25  # in a segment length, for an arm of 0.3 + 0.3 + 0.15 m
COLUMNS = 3  # of panels
QUANTITIES = 4  # in a table, so that it fits a screen
BODY: dict[str, Any] = {  # at the speed of people
    "mmc-body": body_model(Parts(vigour=0)),
    "ik-body": body_model(Parts(vigour=0), ik_body),
}
TUNED = Parts(  # errors are those of Kim et al. (2018), Commun. Biol. 1, 19
    vigour=0,
    rate=(0.2,),
    retention=(0.98,),
    width=people("generalisation")["width"].low,
    largest_error=6,
)
VARIANTS: dict[str, tuple[Any, dict[str, Any]]] = {  # agents, and how they go through experiments
    "mmc-body (two states)": ("mmc-body", {"rate": (0.2, 0.02), "retention": (0.6, 0.99)}),
    "mmc-body (tuned)": (body_model(TUNED), {}),
    "ppo-memory (kept)": ("ppo-memory", {"keep": ("ppo-memory (kept)",)}),
}


def movement_rows(agents: Sequence[str], episodes: int) -> list[dict[str, Any]]:
    """Return a row for each measure of single movements and agent, which moves as people do."""
    rows = []
    plain_agents = [agent for agent in agents if agent not in VARIANTS]
    for scenario, names in track(MOVEMENTS.items(), "movements", transient=True):
        for agent in plain_agents:
            player = BODY.get(agent, agent)
            movements = play(player, SCENARIOS[scenario], episodes, seed=0)[0]
            for name in names:
                if name in MEASURES:
                    quantity = MEASURES[name]
                    values = [quantity.of(movement) for movement in movements]
                    interval = vars(sample_interval(values, quantity.statistic))
                else:
                    quantity = LAWS[name]
                    estimate = quantity.of(movements)
                    interval = {"estimate": estimate, "low": math.nan, "high": math.nan}
                facts = {"measure": name, "label": quantity.label, "unit": quantity.unit}
                facts["decimals"] = max(quantity.decimals, 2)
                rows.append({"agent": agent, "of": scenario, **facts, **interval})
    return with_people(pd.DataFrame(rows)).to_dict("records")


def learning_rows(
    experiments: Sequence[str], agents: Sequence[str], subjects: int, store: Path, pictures: Path
) -> list[dict[str, Any]]:
    """Return a row for each measure of learning and agent, and draw each experiment."""
    rows = []
    for experiment in track(experiments, "experiments", transient=True):
        names = EXPERIMENTS[experiment]
        result = _run_agents(experiment, agents, subjects, store)
        table = learning_table(result)
        in_lengths = table["unit"] == "lengths"
        table.loc[in_lengths, ["estimate", "low", "high"]] *= METRES
        table.loc[in_lengths, "unit"] = "m"
        shown_rows = table[table["measure"].isin(names)].assign(of=experiment)
        # In the order of names; agents keep theirs.
        order = shown_rows["measure"].map(names.index).sort_values(kind="stable")
        rows += shown_rows.loc[order.index].to_dict("records")
        save_figure(learning_figure(result, table), pictures / experiment)
    return rows


def _run_agents(
    experiment: str, agents: Sequence[str], subjects: int, store: Path
) -> ExperimentResult:
    """Return the movements of agents, some of which are `VARIANTS`."""
    runs: list[tuple[Any, dict[str, Any]]]
    runs = [([agent for agent in agents if agent not in VARIANTS], {})]
    for label in agents:
        if label in VARIANTS:
            agent, settings = VARIANTS[label]
            runs.append(({label: agent}, settings))
    results = [
        run_experiment(experiment, players, subjects, out=store, **settings)
        for players, settings in runs
        if players
    ]
    paths = ("hands", "cursors", "targets")
    return replace(
        results[0],
        trials=pd.concat([result.trials for result in results], ignore_index=True),
        **{name: np.concatenate([getattr(result, name) for result in results]) for name in paths},
    )


def shown(row: Mapping[str, Any]) -> str:
    """Return an estimate with its interval, or a figure of people with its source."""
    if row["agent"] == PEOPLE:
        return f"{span(row['low'], row['high'])} ({row['source']})"
    if pd.isna(row["estimate"]):
        return "–"
    digits = int(row["decimals"])
    estimate, low, high = (f"{row[key]:z.{digits}f}" for key in ("estimate", "low", "high"))
    text = estimate if pd.isna(row["low"]) else f"{estimate} [{low}, {high}]"
    return text.replace("-", "−")


def tables(rows: pd.DataFrame) -> list[list[dict[str, str]]]:
    """Return tables for each scenario and experiment: a row for people and each agent."""
    lines_of_tables = []
    for of, group in rows.groupby("of", sort=False):
        measures = [*dict.fromkeys(group["measure"])]
        for first in range(0, len(measures), QUANTITIES):
            is_in_table = group["measure"].isin(measures[first : first + QUANTITIES])
            lines_of_tables.append(_table(str(of), group[is_in_table]))
    return lines_of_tables


def _table(of: str, rows: pd.DataFrame) -> list[dict[str, str]]:
    labels = rows["label"] + rows["unit"].map(lambda unit: unit and f" [{unit}]")
    known = rows["estimate"].notna() | (rows["agent"] == PEOPLE)
    agents = sorted(dict.fromkeys(rows.loc[known, "agent"]), key=lambda name: name != PEOPLE)
    lines = [{of: agent, **dict.fromkeys(labels, "–")} for agent in agents]
    for row, label in zip(rows[known].to_dict("records"), labels[known], strict=True):
        lines[agents.index(row["agent"])][label] = shown(row)
    return lines


def draw(rows: pd.DataFrame) -> Figure:
    """Draw a panel for each quantity that people have a figure of."""
    known = rows.loc[rows["agent"] == PEOPLE, "measure"]
    height = -(-len(known) // COLUMNS)
    with plt.rc_context(STYLE):
        size = (9.0, 1.9 * height)
        figure, axes = plt.subplots(height, COLUMNS, figsize=size, layout="constrained")
        for place, (panel, measure) in enumerate(zip(np.ravel(axes), known, strict=False)):
            draw_with_people(panel, rows, measure)
            panel.tick_params(labelleft=place % COLUMNS == 0)
        for panel in np.ravel(axes)[len(known) :]:
            panel.axis("off")
    return figure


def main(
    agents: tuple[str, ...] = ("mmc-body", "ppo-0"),
    experiments: tuple[str, ...] = tuple(EXPERIMENTS),
    subjects: int = 20,
    episodes: int = 100,
    out: Path = Path("runs/people"),
) -> None:
    """Play movements and experiments, print agents and people, and draw them.

    Args:
        agents: names of agents.
        experiments: some of those that the measures are taken in.
        subjects: of each agent in each experiment.
        episodes: of each scenario.
        out: folder for tables and pictures, and for what was played, so that it resumes.
    """
    out.mkdir(parents=True, exist_ok=True)
    rows = movement_rows(agents, episodes)
    rows += learning_rows(experiments, agents, subjects, out / "store", out)
    frame = pd.DataFrame(rows)
    frame.to_csv(out / "people.csv", index=False)
    save_figure(draw(frame), out / "people")
    console, written = Console(width=200), []
    for lines in tables(frame):
        written.append(markdown_table(lines[0], (line.values() for line in lines)))
        plain = [{escape(k): escape(v) for k, v in line.items()} for line in lines]
        console.print(table_of(plain, next(iter(lines[0]))))
    (out / "people.md").write_text("\n\n".join(written) + "\n", encoding="utf-8")


if __name__ == "__main__":
    tyro.cli(main)
