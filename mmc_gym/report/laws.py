"""Three laws of human movement, and how the agents keep them: a table beside what people do.

Each is a measure of all the movements of a policy in one environment, see `set_measures`; over
training seeds their mean and range are told.  What people do is from textbooks:

    posture variability        not 0: against Donders' law, the posture at a target depends on where
                               the arm came from; no number, since angles of other arms differ
    Fitts' slope               about 0.1 s/bit, 10 bits/s
    speed-curvature exponent   1/3, the two-thirds power law

Source:
    Soechting, Buneo, Herrmann & Flanders (1995), J. Neurosci. 15, 6271–6280; Fitts (1954), J. Exp.
    Psychol. 47, 381–391; Lacquaniti, Terzuolo & Viviani (1983), Acta Psychol. 54, 115–130.
"""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from mmc_gym.measures.set_measures import SET_MEASURES, SetMeasure
from mmc_gym.report.numbers import instances_of, seeds_of, written
from mmc_gym.report.results import Results


@dataclass(frozen=True)
class Law:
    """A law, and how it is shown.

    Attributes:
        measure: name of the set measure.
        explained: of the one that tells how well it holds; empty if none does.
        people: what people do, as text.
        source: of that.
    """

    measure: str
    explained: str
    people: str
    source: str

    @property
    def description(self) -> SetMeasure:
        """The set measure itself."""
        return next(one for one in SET_MEASURES if one.name == self.measure)


LAWS = (
    Law("posture_variability", "", "above 0", "Soechting et al. 1995"),
    Law("fitts_slope", "fitts_r_squared", "about 0.1", "Fitts 1954"),
    Law(
        *("speed_curvature_exponent", "speed_curvature_r_squared"),
        *("0.333", "Lacquaniti et al. 1983"),
    ),
)


@dataclass(frozen=True)
class LawTable:
    """How the agents keep the laws.

    Attributes:
        headings: label and unit of each column.
        people: what people do, and the source, of each column.
        rows: agent, kind, and (value, note) of each column.
        caption: over how many instances and training seeds.
    """

    headings: tuple[tuple[str, str], ...]
    people: tuple[tuple[str, str], ...]
    rows: tuple[tuple[str, str, tuple[tuple[str, str], ...]], ...]
    caption: str


def law_table(results: Results) -> LawTable | None:
    """The table; None if no agent was in an environment that suits any of the laws."""
    known = results.sets[results.sets["value"].notna()] if len(results.sets) else results.sets
    laws = [law for law in LAWS if (known["measure"] == law.measure).any()]
    if not laws:
        return None
    taken = known[known["measure"].isin([law.measure for law in laws])]
    present = set(taken["agent"])
    agents = [agent for agent in results.agents if agent in present]
    environments = [law.description.environment for law in laws]
    return LawTable(
        tuple((law.description.label, law.description.unit) for law in laws),
        tuple((law.people, law.source) for law in laws),
        tuple(
            (agent, results.kind(agent), tuple(_cell(known, agent, law) for law in laws))
            for agent in agents
        ),
        "Posture variability: how much the postures differ that put the hand to the same target "
        "from other starts; 0 is Donders' law. Fitts' slope: how much longer it takes for each bit "
        "of difficulty, over the distances and widths of targets; no agent is told the width. "
        "Speed-curvature exponent: how much slower the hand is where its path is more curved, in "
        "following a target. Means over training seeds, with their range; R²: how much of "
        "the variance the law explains (where that is little, its number says little); –: too "
        f"few movements arrived. Environments: {', '.join(environments)}. "
        f"{instances_of(results, environments)} {seeds_of(results, agents, environments)}",
    )


def _cell(known: pd.DataFrame, agent: str, law: Law) -> tuple[str, str]:
    mine = known[known["agent"] == agent]
    values = mine.loc[mine["measure"] == law.measure, "value"]
    if values.empty:
        return "–", ""
    decimals = law.description.decimals
    notes = []
    if len(values) > 1:
        notes.append(f"{written(values.min(), decimals)} to {written(values.max(), decimals)}")
    explained = mine.loc[mine["measure"] == law.explained, "value"]
    if len(explained):
        notes.append(f"R² {written(explained.mean(), 2)}")
    return written(values.mean(), decimals), "; ".join(notes)
