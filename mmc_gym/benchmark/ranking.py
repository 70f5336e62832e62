"""The ranking of agents over a battery of environments.

    rank          by success s = mean over environments of the fraction of episodes, of all training
                  seeds, that end at the target; agents with the same s by time to target, the mean
                  over environments of its median over the episodes that have one
    settled       part of an episode after which the hand has come to stay at the target,
                  1 − time to target / duration, 0 if it never does: its interquartile mean
    improvement   probability that the agent's policy is settled for longer in an episode than the
                  baseline's is in the same; ½ for the baseline itself, and for a copy of it

Every environment weighs the same, whatever its number of instances.  Environments count that all
agents have attempted.  Where an agent could not act, or failed, it had no success.  Agents with the
same success and the same time have the same rank; intervals tell which differences mean something.
They are over training seeds and instances, see `resampling`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from mmc_gym._files import write_atomically
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.benchmark.runner import Manifest, not_played, untrained
from mmc_gym.benchmark.statistics import RESAMPLES, Bootstrap, Estimate
from mmc_gym.benchmark.store import CellKey, read_episodes, read_manifest

BASELINE_AGENT = "mmc"
_DIGITS = 12  # sums of the same numbers in another order are the same
_POLICY = ["agent", "training_seed"]


def summarize_battery(
    episodes: pd.DataFrame,
    not_played: Iterable[CellKey] = (),
    untrained: Collection[str] = (),
    baseline: str = BASELINE_AGENT,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pd.DataFrame:
    """Rank agents; the ideal hand, which has not met all environments, is left out.

    Args:
        episodes: as `read_episodes` returns them.
        not_played: cells that were attempted and have no episodes.
        untrained: agents that have no training seeds, although one stands in the column.
        baseline: the agent that all are compared with; no comparison if it is not there.
        resamples: of the bootstrap.
        seed: of the bootstrap.

    Returns:
        A row for each agent, the best first: rank, agent, success, settled and improvement (each
        with …_low and …_high, 95 %), time_to_target (s), training_seeds (0 without training),
        environments, instances, not_played (cells).

    Raises:
        ValueError: if there is no environment that all agents have attempted.
    """
    missing = [key for key in not_played if key.agent != REFERENCE]
    scores = battery_scores(episodes, missing)
    scores["training_seed"] = scores["training_seed"].astype(object)
    scores.loc[scores["agent"].isin(list(untrained)), "training_seed"] = None
    success, settled = (
        Bootstrap.of(scores, value, resamples, seed) for value in ("success", "settled")
    )
    exact = _mean_over_environments(scores, "success", "mean").round(_DIGITS)
    times = _mean_over_environments(scores, "time_to_target", "median").round(_DIGITS)
    present = set(scores["environment"])
    rows = []
    for agent in success.scores.values:
        found = success.estimate(agent, "mean")
        improvement = Estimate(np.nan, np.nan, np.nan, (), 0, 0)
        if baseline in success.scores.values:
            pair = scores[scores["agent"].isin([agent, baseline])]
            both = Bootstrap.of(pair, "settled", resamples, seed)
            improvement = both.improvement(agent, baseline)
        rows.append(
            {
                "agent": agent,
                **_columns("success", replace(found, estimate=float(exact[agent]))),
                **_columns("settled", settled.estimate(agent)),
                **_columns("improvement", improvement),
                "time_to_target": float(times[agent]),
                "training_seeds": found.seeds[0],
                "environments": found.environments,
                "instances": found.instances,
                "not_played": sum(
                    key.agent == agent and key.environment in present for key in missing
                ),
            }
        )
    frame = pd.DataFrame(rows)
    ordered = frame.sort_values(
        ["success", "time_to_target"], ascending=[False, True], na_position="last", kind="stable"
    ).reset_index(drop=True)
    ordered.insert(0, "rank", _ranks(ordered))
    return ordered


def success_by_environment(
    episodes: pd.DataFrame, not_played: Iterable[CellKey] = ()
) -> pd.DataFrame:
    """Success in each environment: a row for each agent, a column for each environment.

    Args:
        episodes: as `read_episodes` returns them.
        not_played: cells that were attempted and have no episodes: without success.

    Returns:
        The mean over training seeds and instances; NaN where nothing was attempted.
    """
    tables = [episodes[["agent", "training_seed", "environment", "success"]]]
    for key in not_played:
        tables.append(pd.DataFrame([{**key._asdict(), "success": 0.0}]))
    cells = pd.concat(tables, ignore_index=True)
    policies = cells.groupby(["agent", "environment", "training_seed"], sort=False)[
        "success"
    ].mean()
    table: pd.DataFrame = policies.groupby(["agent", "environment"], sort=False).mean().unstack()
    return table


def battery_scores(episodes: pd.DataFrame, not_played: Iterable[CellKey] = ()) -> pd.DataFrame:
    """The scores that a ranking is made of.

    Returns:
        Columns agent, training_seed, environment, instance, success, time_to_target, settled; a
        row for each episode of each policy in the environments that all have attempted, also for
        those that were not played.

    Raises:
        ValueError: if there is no such environment.
    """
    played = episodes[episodes["agent"] != REFERENCE]
    scores = played[[*_POLICY, "environment", "instance", "success", "time_to_target"]].copy()
    scores["settled"] = (1 - played["time_to_target"] / played["duration"]).fillna(0.0)
    instances = {
        name: sorted(set(group["instance"])) for name, group in scores.groupby("environment")
    }
    empty = [
        {
            **key._asdict(),
            "instance": instance,
            "success": 0.0,
            "time_to_target": np.nan,
            "settled": 0.0,
        }
        for key in not_played
        for instance in instances.get(key.environment, ())
    ]
    if empty:
        scores = pd.concat([scores, pd.DataFrame(empty)], ignore_index=True)
    policies = len(scores[_POLICY].drop_duplicates())
    attempts = scores[[*_POLICY, "environment"]].drop_duplicates()["environment"].value_counts()
    common = attempts.index[attempts == policies]
    if not len(common):
        raise ValueError("episodes must be of an environment that all agents have attempted")
    return scores[scores["environment"].isin(common)].reset_index(drop=True)


def _columns(name: str, found: Estimate) -> dict[str, float]:
    values = {name: found.estimate, f"{name}_low": found.low, f"{name}_high": found.high}
    return {column: value + 0.0 for column, value in values.items()}  # no -0.0


def _mean_over_environments(scores: pd.DataFrame, column: str, statistic: str) -> pd.Series[float]:
    """By agent, the mean over environments of the mean or median over episodes; NaNs left out."""
    by_environment = scores.groupby(["agent", "environment"])[column].agg(statistic)
    mean: pd.Series[float] = by_environment.groupby("agent").mean()
    return mean


def _ranks(ordered: pd.DataFrame) -> list[int]:
    """1, 2, 2, 4, …: one more than the number of agents that are better."""
    ranks: list[int] = []
    last: tuple[float, float] | None = None
    for place, (success, seconds) in enumerate(
        zip(ordered["success"], ordered["time_to_target"].fillna(np.inf)), start=1
    ):
        ranks.append(ranks[-1] if (success, seconds) == last else place)
        last = success, seconds
    return ranks


RANKING = "ranking.csv"
"""The ranking in a store's folder, as `summarize_battery` returns it, for other programs."""

_PLAIN = str.maketrans({"–": "-", "−": "-", "½": "1/2"})


def print_ranking(console: Console, folder: Path) -> pd.DataFrame:
    """Rank the agents of a store, print the table, write it to `RANKING`, and return it.

    Where nothing can be ranked it prints why, and returns no rows.

    Raises:
        ValueError: if the folder holds no store, or no agent could play.
    """
    manifest = read_manifest(folder)
    if set(manifest["agents"]) == {REFERENCE}:
        console.print(_text(console, f"nothing to rank: {REFERENCE} is a hand without an arm"))
        return pd.DataFrame()
    try:
        ranking = summarize_battery(
            read_episodes(folder), not_played(manifest), untrained(manifest)
        )
    except ValueError:
        _print_reasons(console, manifest)
        raise
    write_atomically(folder / RANKING, ranking.to_csv(index=False, lineterminator="\n"))
    _print_table(console, ranking)
    console.print(_text(console, _note(manifest, ranking)))
    _print_reasons(console, manifest)
    return ranking


def _print_table(console: Console, ranking: pd.DataFrame) -> None:
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="bold")
    rows = ranking.to_dict("records")
    for heading in _cells(rows[0]):
        justify: Any = "left" if heading == "agent" else "right"
        table.add_column(_text(console, heading), justify=justify, vertical="top")
    for row in rows:
        table.add_row(*(_text(console, content) for content in _cells(row).values()))
    console.print(Padding(table, (1, 0)))


def _print_reasons(console: Console, manifest: Manifest) -> None:
    for status in ("skipped", "failed"):
        for line, count in _reasons(manifest, status).items():
            cells = f"{count} cell{'s' * (count != 1)}"
            console.print(_text(console, f"{status}, {cells}: {line}"))


def _cells(row: Mapping[Hashable, Any]) -> dict[str, str]:
    return {
        "rank": str(row["rank"]),
        "agent": str(row["agent"]),
        "success": _interval(row, "success"),
        "settled": _interval(row, "settled"),
        f"better than {BASELINE_AGENT}": _interval(row, "improvement"),
        "time to target [s]": _number(row["time_to_target"], 2),
        "seeds": str(row["training_seeds"] or "-"),
        "not played": str(row["not_played"] or "-"),
    }


def _interval(row: Mapping[Hashable, Any], name: str) -> str:
    low, high = (_number(row[f"{name}_{end}"], 3) for end in ("low", "high"))
    return f"{_number(row[name], 3)} [{low}, {high}]"


def _number(value: float, decimals: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{decimals}f}"


def _note(manifest: Manifest, ranking: pd.DataFrame) -> str:
    one = ranking.iloc[0]
    left_out = len(manifest["environments"]) - int(one["environments"])
    partly = f" ({left_out} more have not been attempted by all)" if left_out else ""
    return (
        f"{one['environments']} environments{partly}, {one['instances']} instances for each "
        "agent and training seed, the same for all. Ranked by success: the fraction of episodes "
        "that end at the target, each environment weighing the same; then by time to target (mean "
        "of medians). settled: interquartile mean of the part of an episode after which the hand "
        f"stays at the target. better than {BASELINE_AGENT}: probability of being settled for "
        "longer in the same episode, ½ if equal. Intervals: 95 % bootstrap over training seeds and "
        "instances; without several training seeds over instances alone. Cells that were not "
        "played count as without success. All cells took "
        f"{sum(manifest['cpu_seconds'].values()):.0f} s of one processor's time; "
        f"{manifest.get('reused', 0)} were there already and not played again.{_mixed(manifest)}"
    )


def _mixed(manifest: Manifest) -> str:
    """What differs among the cells of a store that came about over time."""
    versions = [f"{name} {found}" for name, found in manifest["versions"].items() if ", " in found]
    changed = manifest.get("changed", ())
    return "".join(
        (
            f" They were played with several versions: {'; '.join(versions)}." if versions else "",
            f" Changed since some of their cells were played: {', '.join(changed)}; play them "
            "again in all environments."
            if changed
            else "",
        )
    )


def _reasons(manifest: Manifest, status: str) -> dict[str, int]:
    """How many cells of an agent have come to nothing for the same reason."""
    counts: dict[str, int] = {}
    for entry in manifest[status]:
        line = f"{entry['agent']}: {entry['reason']}"
        counts[line] = counts.get(line, 0) + 1
    return counts


def _text(console: Console, content: str) -> Text:
    if not console.is_terminal or not console.encoding.lower().startswith("utf"):
        content = content.translate(_PLAIN).encode("ascii", "replace").decode()
    return Text(content)
