"""Rank agents over the environments of a benchmark.

    rank          by success, the mean over environments of the fraction of episodes (of all
                  training seeds) that end at the target; agents with the same success by time to
                  target, the mean over environments of its median over the episodes that have one
    settled       part of an episode in which the hand stays at the target, its mean:
                  1 − time to target / duration, 0 if it never stays; NaN in an environment that
                  says that a hand arrives, but not when
    improvement   probability that the agent's policy is settled for longer than the baseline's in
                  the same episode; ½ for the baseline itself, and for a copy of it; over the
                  environments in which both have values

    control       the control mode in which an agent acts.  Agents of the mode of most are ranked
                  first; those of another mode below them, in a block of their own

All environments that all agents have attempted count, with equal weight whatever their number of
instances.  An agent that could not act, or failed, had no success.  Agents with the same success
and the same time share a rank.  For the intervals see `statistics`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
from rich.console import Console

from mmc_gym._console import text_for
from mmc_gym._errors import UserError
from mmc_gym._files import write_atomically
from mmc_gym._tables import Cell, Heading, Row, Table, interval, number, print_table
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.statistics import RESAMPLES, Bootstrap, Estimate
from mmc_gym.benchmark.store import CellKey, Manifest, read_episodes, read_manifest, reasons
from mmc_gym.measures import words

BASELINE_AGENT = "mmc"
_DIGITS = 12  # so that the order of summation makes no difference
_POLICY = ["agent", "training_seed"]


def rank_agents(
    episodes: pd.DataFrame,
    not_played: Iterable[CellKey] = (),
    baseline: str = BASELINE_AGENT,
    resamples: int = RESAMPLES,
    seed: int = 0,
    *,
    controls: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """Rank agents, without the ideal hand, which cannot play all environments.

    The `episodes` are those of `read_episodes`, and `not_played` are cells that were attempted but
    have none.  If the `baseline`, with which all are compared, did not play, improvement is NaN.
    Without `controls`, the control modes by agent, all are ranked together.

    Returns:
        A row for each agent, the best of each block first: rank, agent, control, success, settled
        and improvement (each with …_low and …_high, 95 %), time_to_target (s), training_seeds (0
        without training), environments, instances, not_played (cells).

    Raises:
        UserError: if no environment was attempted by all agents.
    """
    missing = [key for key in not_played if key.agent != REFERENCE]
    scores = ranked_scores(attempted_scores(episodes, missing))
    success, settled = (
        Bootstrap.of(scores, value, resamples, seed) for value in ("success", "settled")
    )
    shares = _mean_over_environments(scores, "success", "mean")
    times = _mean_over_environments(scores, "time_to_target", "median")
    lost = Counter(key.agent for key in missing if key.environment in set(scores["environment"]))
    rows = []
    for agent in success.scores.values:
        improvement = Estimate(math.nan, math.nan, math.nan)
        if baseline in success.scores.values:
            tables = settled.scores.values
            pair = {name: tables[name] for name in tables if name in (agent, baseline)}
            bootstrap = Bootstrap(replace(settled.scores, values=pair), resamples, seed)
            improvement = bootstrap.improvement(agent, baseline)
        estimates = {
            "success": success.estimate(agent)._replace(estimate=float(shares[agent])),
            "settled": settled.estimate(agent),
            "improvement": improvement,
        }
        row: dict[str, Any] = {"agent": agent, "control": (controls or {}).get(agent, "")}
        for name, (estimate, low, high) in estimates.items():
            ends = {name: estimate, f"{name}_low": low, f"{name}_high": high}
            row |= {column: value + 0.0 for column, value in ends.items()}  # no -0.0
        rows.append(
            {
                **row,
                "time_to_target": float(times[agent]),
                "training_seeds": success.scores.seeds[agent],
                "environments": len(success.scores.instances),
                "instances": sum(success.scores.instances),
                "not_played": lost[agent],
            }
        )
    by, ascending = ["success", "time_to_target"], [False, True]  # NaN is last
    ordered = pd.DataFrame(rows).sort_values(by, ascending=ascending)
    acts_by = ordered["control"].replace("", None)  # that of most for what did not act
    acts_by = acts_by.fillna(next(iter(acts_by.mode()), ""))
    blocks = [block for _, block in ordered.groupby(acts_by, sort=False)]
    blocks.sort(key=len, reverse=True)
    ranks: list[int] = []
    for block in blocks:
        scored = list(zip(block["success"], block["time_to_target"].fillna(math.inf)))
        ranks += [1 + scored.index(score) for score in scored]  # 1, 2, 2, 4, …
    ordered = pd.concat(blocks, ignore_index=True)
    ordered.insert(0, "rank", ranks)
    return ordered


def attempted_scores(episodes: pd.DataFrame, not_played: Iterable[CellKey] = ()) -> pd.DataFrame:
    """Return a row for each episode of each policy but the ideal hand, played or not.

    Columns agent, training_seed, environment, instance, success, time_to_target, settled.
    """
    scores = episodes[episodes["agent"] != REFERENCE]
    settled = 1 - scores["time_to_target"] / scores["duration"]
    unknown = set(scores.loc[settled.isna() & (scores["success"] > 0), "environment"])
    scores = scores[[*_POLICY, "environment", "instance", "success", "time_to_target"]].copy()
    scores["settled"] = settled.fillna(0.0)
    instances = {
        name: sorted(set(group["instance"])) for name, group in scores.groupby("environment")
    }
    nothing = {"success": 0.0, "time_to_target": np.nan, "settled": 0.0}
    empty = [
        {**key._asdict(), "instance": instance, **nothing}
        for key in not_played
        if key.agent != REFERENCE
        for instance in instances.get(key.environment, ())
    ]
    if empty:
        scores = pd.concat([scores, pd.DataFrame(empty)], ignore_index=True)
        scores["training_seed"] = scores["training_seed"].astype("Int64")
    scores.loc[scores["environment"].isin(unknown), "settled"] = np.nan
    return scores


def ranked_scores(scores: pd.DataFrame) -> pd.DataFrame:
    """Return the `attempted_scores` that a ranking uses: where all agents have attempted."""
    policies = len(scores[_POLICY].drop_duplicates())
    attempts = scores[[*_POLICY, "environment"]].drop_duplicates()["environment"].value_counts()
    common = attempts.index[attempts == policies]
    if scores.empty or not len(common):
        names = ", ".join(map(str, scores["agent"].unique()))
        others = "play them in the same ones, or some into another folder"
        raise UserError(f"there is no scenario that all agents have attempted ({names}): {others}")
    return scores[scores["environment"].isin(common)].reset_index(drop=True)


def _mean_over_environments(scores: pd.DataFrame, column: str, statistic: str) -> pd.Series[float]:
    """Return, by agent, the mean over environments of the mean or median over episodes."""
    by_environment = scores.groupby(["agent", "environment"])[column].agg(statistic)
    return cast("pd.Series[float]", by_environment.groupby("agent").mean().round(_DIGITS))


RANKING = "ranking.csv"  # in a store's folder, as `rank_agents` returns it, for other programs


def print_ranking(console: Console, folder: Path) -> pd.DataFrame:
    """Rank the agents of a store, print the table, write it to `RANKING`, and return it.

    If the store holds only the ideal hand, print that and return no rows.
    """
    manifest = read_manifest(folder)
    if set(manifest.agents) == {REFERENCE}:
        console.print(text_for(console, f"nothing to rank: {REFERENCE} is a hand without an arm"))
        return pd.DataFrame()
    episodes = read_episodes(folder, ["success", "time_to_target", "duration"])
    controls = {agent: manifest.control(agent) for agent in manifest.agents}
    try:
        lost = [cell.key for cell in manifest.not_played]
        ranking = rank_agents(episodes, lost, controls=controls)
    except UserError as error:
        raise UserError("; ".join([str(error), *reasons(manifest.not_played)])) from error
    write_atomically(folder / RANKING, ranking.to_csv(index=False, lineterminator="\n"))
    print_table(console, _table(manifest, ranking))
    for line in reasons(manifest.not_played):
        console.print(text_for(console, line))
    return ranking


def _table(manifest: Manifest, ranking: pd.DataFrame) -> Table:
    """Return the ranking as it is printed; columns without any value are left out."""
    columns: dict[Heading, Iterable[Cell]] = {}
    columns[Heading("agent", is_text=True)] = map(Cell, ranking["agent"])
    if ranking["control"].replace("", None).nunique() > 1:
        columns[Heading("acts by", is_text=True)] = map(Cell, ranking["control"])
    columns[Heading("success")] = _shares(ranking, "success")
    columns[Heading("settled")] = _shares(ranking, "settled")
    if ranking["improvement"].notna().any():
        columns[Heading(f"better\nthan {BASELINE_AGENT}")] = _shares(ranking, "improvement")
    columns[Heading("time", "s")] = (Cell(number(time, 2)) for time in ranking["time_to_target"])
    columns[Heading("seeds")] = (Cell(str(seeds or "–")) for seeds in ranking["training_seeds"])
    if ranking["not_played"].any():
        columns[Heading("not\nplayed")] = (Cell(str(n or "–")) for n in ranking["not_played"])
    cells = zip(*columns.values(), strict=True)
    return Table(
        headings=(Heading("#"), *columns),
        rows=tuple(Row(str(rank), row) for rank, row in zip(ranking["rank"], cells, strict=True)),
        caption=_note(manifest, ranking),
    )


def _shares(ranking: pd.DataFrame, name: str) -> Iterator[Cell]:
    """Yield the share of each agent with its interval."""
    for share, low, high in ranking[[name, f"{name}_low", f"{name}_high"]].to_numpy():
        yield Cell.of(number(share, 3), interval(low, high, 3))


def _note(manifest: Manifest, ranking: pd.DataFrame) -> str:
    scenarios, instances = map(int, ranking.loc[0, ["environments", "instances"]])
    is_compared = ranking["improvement"].notna().any()
    versions = [f"{name} {text}" for name, text in manifest.versions.items() if ", " in text]
    mixed = words.VERSIONS.format(versions="; ".join(versions)) if versions else ""
    if changed := ", ".join(manifest.changed):
        mixed += words.CHANGED.format(changed=changed)
    return words.RANKING.format(
        scenarios=words.scenarios(scenarios, len(manifest.environments), "have not been"),
        instances=instances,
        improvement=words.IMPROVEMENT.format(baseline=BASELINE_AGENT) if is_compared else "",
        controls=words.control_note(dict(zip(ranking["agent"], ranking["control"]))),
        seconds=sum(manifest.cpu_seconds.values()),
        reused=manifest.reused,
        mixed=mixed,
    )
