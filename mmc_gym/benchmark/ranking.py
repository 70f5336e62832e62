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

from collections.abc import Collection, Iterable
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.benchmark.replication import (
    NESTED_RESAMPLES,
    Estimate,
    probability_of_improvement,
    stratified_bootstrap,
)
from mmc_gym.benchmark.store import CellKey
from mmc_gym.benchmark.weighted import weighted_iqm, weighted_mean

BASELINE_AGENT = "mmc"
_DIGITS = 12  # sums of the same numbers in another order are the same
_POLICY = ["agent", "training_seed"]


def summarize_battery(
    episodes: pd.DataFrame,
    not_played: Iterable[CellKey] = (),
    untrained: Collection[str] = (),
    baseline: str = BASELINE_AGENT,
    resamples: int = NESTED_RESAMPLES,
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
    bootstrap = partial(stratified_bootstrap, scores, resamples=resamples, seed=seed)
    success = bootstrap(weighted_mean, "success")
    settled = bootstrap(weighted_iqm, "settled")
    exact = _mean_over_environments(scores, "success", "mean").round(_DIGITS)
    times = _mean_over_environments(scores, "time_to_target", "median").round(_DIGITS)
    present = set(scores["environment"])
    rows = []
    for agent, found in success.items():
        improvement = Estimate(np.nan, np.nan, np.nan, (), 0, 0)
        if baseline in success:
            pair = scores[scores["agent"].isin([agent, baseline])]
            improvement = probability_of_improvement(
                pair, agent, baseline, "high", "settled", resamples, seed
            )
        rows.append(
            {
                "agent": agent,
                **_columns("success", replace(found, estimate=float(exact[agent]))),
                **_columns("settled", settled[agent]),
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
