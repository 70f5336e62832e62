"""Which of people's movements and learning do agents show?  Agents as points, people as bands.

`people.yml` has the published figures, of which task they are, and how ours differs.  There is no
score: a quantity is near the one of people or not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pandas as pd
import tyro
import yaml
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape
from rich.progress import track

from mmc_gym.agents.body_model.agent import Parts, ik_body
from mmc_gym.benchmark.adaptation import learning_figure, learning_table
from mmc_gym.benchmark.statistics import bootstrap_interval
from mmc_gym.benchmark.suite import SCENARIOS
from mmc_gym.benchmark.trials import run_experiment
from mmc_gym.measures import MEASURES, SET_MEASURES
from mmc_gym.measures.catalogue import Quantity
from studies.body_model.playing import body_model, play
from studies.drawing import COLOURS, STYLE, save_figure
from studies.tables import table_of

MOVEMENTS = {  # measures, and the scenarios that they are taken in
    "centre-out": ("peak_to_mean", "time_to_peak"),
    "pursuit": ("speed_curvature_exponent",),
    "distances": ("fitts_slope",),
}
EXPERIMENTS = {  # measures, and the experiments that they are taken in
    "rotation-30": (*("rate", "final_adaptation", "after_effect", "A_f", "A_s", "B_f", "B_s"),),
    "curl-field-60": ("deviation", "rate", "final_adaptation", "after_effect"),
    "savings-30": ("savings",),
    "retention-30": ("retention",),
    "generalisation-30": ("width",),
    "clamp-15": ("clamp_asymptote",),
    "cursor-jump-10": ("latency", "gain"),
}
MARKERS = "osD^vP"
BODY: dict[str, Any] = {  # at the speed of people
    "mmc-body": body_model(Parts(vigour=0)),
    "ik-body": body_model(Parts(vigour=0), ik_body),
}


@dataclass(frozen=True, kw_only=True)
class Published:
    """A figure of people for a measure of this package, in its unit; None for what is not known."""

    quantity: str  #: name of the measure
    low: float | None = None
    high: float | None = None  #: equal to `low` for a single figure
    task: str = ""
    source: str = ""
    doi: str = ""
    differs: str = ""  #: how the task differs from ours
    missing: str = ""  #: what was looked for and not found

    @property
    def figure(self) -> str:
        """The figure as a number, a range or a bound; "–" without one."""
        low, high = ("" if end is None else f"{end:g}" for end in (self.low, self.high))
        if low and high:
            return low if low == high else f"{low} to {high}"
        return f"above {low}" if low else f"below {high}" if high else "–"

    @property
    def authors(self) -> str:
        """The source's authors in short, and its year: "Day et al. 2016"."""
        names, _, rest = self.source.partition(" (")
        first, *others = names.split(", ")
        return f"{first} et al. {rest[:4]}" if others else f"{names} {rest[:4]}".strip()


@cache
def people() -> dict[str, Published]:
    """Return the published figures by measure."""
    text = Path(__file__).with_suffix(".yml").read_text(encoding="utf-8")
    return {row["quantity"]: Published(**row) for row in yaml.safe_load(text)}


def movement_rows(agents: Sequence[str], episodes: int) -> list[dict[str, Any]]:
    """Return a row for each measure of single movements and agent, which moves as people do."""
    rows = []
    for scenario, names in track(MOVEMENTS.items(), "movements", transient=True):
        for agent in agents:
            made = BODY.get(agent, agent)
            played = play(made, SCENARIOS[scenario], episodes, seed=0)
            for name in names:
                known: Any = {**MEASURES, **SET_MEASURES}[name]
                if name in MEASURES:
                    values = [known.of(one) for one in played[0]]
                    found = vars(bootstrap_interval(values, known.statistic))
                else:
                    found = {"estimate": known.of(played[0]), "low": float("nan")}
                    found["high"] = found["low"]
                rows.append({"agent": agent, "of": scenario, **_facts(known), **found})
    return rows


def _facts(known: Quantity) -> dict[str, Any]:
    facts = {"label": known.label, "unit": known.unit, "decimals": max(known.decimals, 2)}
    return {"measure": known.name, **facts}


def learning_rows(
    experiments: Sequence[str], agents: Sequence[str], subjects: int, store: Path, pictures: Path
) -> list[dict[str, Any]]:
    """Return a row for each measure of learning and agent, and draw each experiment."""
    rows = []
    for experiment in track(experiments, "experiments", transient=True):
        names = EXPERIMENTS[experiment]
        result = run_experiment(experiment, list(agents), subjects, out=store)
        table = learning_table(result, lengths_in="m")
        chosen = table[table["measure"].isin(names)].assign(of=experiment)
        rows += chosen.to_dict("records")
        save_figure(learning_figure(result), pictures / experiment)
    return rows


def shown(row: Mapping[str, Any]) -> str:
    """Return an estimate with its interval."""
    if pd.isna(row["estimate"]):
        return "–"
    digits, text = int(row["decimals"]), f"{row['estimate']:.{int(row['decimals'])}f}"
    if not pd.isna(row["low"]):
        text += f" [{row['low']:.{digits}f}, {row['high']:.{digits}f}]"
    return text.replace("-", "−")


def table(rows: pd.DataFrame) -> list[dict[str, str]]:
    """Return a row for each quantity: its values of agents and people."""
    found = []
    for (of, measure), group in rows.groupby(["of", "measure"], sort=False):
        unit = group["unit"].iloc[0]
        cited = people().get(str(measure))
        values = {str(row["agent"]): shown(row) for row in group.to_dict("records")}
        found.append(
            {
                "quantity": group["label"].iloc[0] + (f" [{unit}]" if unit else ""),
                "in": str(of),
                **{agent: values.get(agent, "–") for agent in rows["agent"].unique()},
                "people": f"{cited.figure} ({cited.authors})" if cited and cited.source else "–",
            }
        )
    return found


def draw(rows: pd.DataFrame) -> Figure:
    """Draw a panel for each quantity that people have a figure of: a band, and agents as points."""
    known = [
        name for name in rows["measure"].unique() if name in people() and people()[name].source
    ]
    agents = list(rows["agent"].unique())
    columns = 3
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            -(-len(known) // columns),
            columns,
            figsize=(7.5, 1.8 * -(-len(known) // columns)),
            layout="constrained",
            squeeze=False,
        )
        for panel, name in zip(axes.flat, known, strict=False):
            group, cited = rows[rows["measure"] == name], people()[name]
            low, high = cited.low, cited.high
            if low is not None and low == high:
                panel.axvline(low, color="0.6", linewidth=4, zorder=0)
            for row in group.to_dict("records"):
                number = agents.index(row["agent"])
                ends = [[row["estimate"] - row["low"]], [row["high"] - row["estimate"]]]
                panel.errorbar(
                    row["estimate"],
                    -number,
                    xerr=None if pd.isna(row["low"]) else ends,
                    marker=MARKERS[number],
                    color=COLOURS[number % len(COLOURS)],
                    markersize=5,
                )
            left, right = min(0.0, panel.get_xlim()[0]), 1.1 * max(panel.get_xlim()[1], high or 0.0)
            if low != high:
                ends = left if low is None else low, right if high is None else high
                panel.axvspan(*ends, color="0.85", zorder=0)
            panel.set_xlim(left, right)
            unit = group["unit"].iloc[0]
            panel.set_title(group["label"].iloc[0] + (f" [{unit}]" if unit else ""))
            panel.set_xlabel(f"people: {cited.figure}\n{cited.authors}", fontsize=6.5)
            panel.set(
                ylim=(-len(agents) + 0.5, 0.5),
                yticks=[-k for k in range(len(agents))],
                yticklabels=agents,
            )
        for panel in axes.flat[len(known) :]:
            panel.axis("off")
    return figure


def main(
    agents: tuple[str, ...] = ("mmc-body", "ppo-0"),
    experiments: tuple[str, ...] = tuple(EXPERIMENTS),
    subjects: int = 20,
    episodes: int = 100,
    out: Path = Path("runs/people"),
) -> None:
    """Play movements and experiments, print agents beside people, and draw them.

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
    lines = table(frame)
    (out / "people.md").write_text(markdown(lines), encoding="utf-8")
    save_figure(draw(frame), out / "people")
    plain = [{key: escape(value) for key, value in line.items()} for line in lines]
    Console(width=200).print(table_of(plain, "agents beside people"))


def markdown(lines: Sequence[Mapping[str, str]]) -> str:
    """Return the table in Markdown."""
    rows = [list(lines[0]), ["---"] * len(lines[0]), *(list(line.values()) for line in lines)]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


if __name__ == "__main__":
    tyro.cli(main)
