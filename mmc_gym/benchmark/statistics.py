"""Bootstrap resamples of scores: of training seeds, and of the instances that all agents met.

    agent A               instance 1   2   3  …  of environment E
    training seed 1                ·   ·   ·         w_1         w_s: how often seed s is drawn
    training seed 2                ·   ·   ·         w_2
                                  u_1 u_2 u_3                    u_i: how often instance i is drawn

A resample draws as many training seeds of each agent as it has, and as many instances as there
are, both with replacement; the score of seed s at instance i then counts w_s u_i times.  So the
interval covers both that training again gives another policy, and that other starts and targets are
easier or harder.  Episodes of one policy are never drawn as if each came from its own training.

    paired        The u_i are the same for all agents: what makes an instance hard for all of them
                  drops out of their differences.
    stratified    Each environment counts equally, whatever its number of instances.
    shared        The u_i are the same for all environments with as many instances.  The battery
                  draws the i-th start and target from the same seed everywhere: what is hard
                  without perturbation is hard under all of them, and drawn for each on its own it
                  would seem to average out (95 % intervals would cover 50 to 70 %).  Sets that
                  have nothing in common but their size lose nothing: they vary independently.
    seeds         A seed is one policy: it is drawn in all environments or in none.
    no training   An agent that was not trained has one policy, and only instances are drawn.  A
                  single trained policy is treated alike: its interval cannot tell what training
                  again would change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mmc_gym.measures.reaching import Floats

COLUMNS = ("agent", "training_seed", "environment", "instance")
_UNTRAINED = "no training"
_INSTANCES, _POLICIES = 0, 1  # streams of random numbers


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of agents, (policies, instances) for each environment; NaN where there is none.

    Attributes:
        environments: their names, E of them.
        instances: the number of instances in each.
        values: by agent, E arrays (policies, instances), the instances in the order of their names.
        seeds: by agent, its number of training seeds; 0 for one policy without training.
    """

    environments: tuple[str, ...]
    instances: tuple[int, ...]
    values: Mapping[str, tuple[Floats, ...]]
    seeds: Mapping[str, int]

    def of(self, agent: str) -> tuple[Floats, ...]:
        """The scores of an agent.

        Raises:
            ValueError: if there is no such agent.
        """
        if agent not in self.values:
            raise ValueError(f"agent must be one of {list(self.values)}, got {agent!r}")
        return self.values[agent]


@dataclass(frozen=True, eq=False)
class Draws:
    """How often everything was drawn in R resamples; row 0 draws all once: the data themselves.

    Attributes:
        policies: by agent, (R + 1, policies).
        instances: by environment, (R + 1, instances).
    """

    policies: Mapping[str, Floats]
    instances: tuple[Floats, ...]


def arrange(frame: pd.DataFrame, value: str = "value") -> Scores:
    """The scores of a tidy frame as arrays.

    Args:
        frame: a row per episode, with the columns agent, training_seed (missing for an agent
            without training), environment, instance, and `value`.
        value: the column of the scores, NaN where an episode has none.

    Raises:
        ValueError: if a column is missing, an episode is there twice, or some agent's policy has
            not met all instances.
    """
    missing = [column for column in (*COLUMNS, value) if column not in frame.columns]
    if missing or frame.empty:
        raise ValueError(f"frame must have rows with {[*COLUMNS, value]}, it lacks {missing}")
    seeds = frame["training_seed"].astype(object).where(frame["training_seed"].notna(), _UNTRAINED)
    table = frame.assign(training_seed=seeds)
    if table.duplicated(list(COLUMNS)).any():
        twice = table.loc[table.duplicated(list(COLUMNS)), list(COLUMNS)].iloc[0].to_dict()
        raise ValueError(f"frame must have each episode once, got {twice} repeatedly")
    environments = tuple(dict.fromkeys(table["environment"]))
    instances = {
        environment: sorted(set(group["instance"]))
        for environment, group in table.groupby("environment", sort=False)
    }
    values, count = {}, {}
    for agent, group in table.groupby("agent", sort=False):
        policies = list(dict.fromkeys(group["training_seed"]))
        episodes = group.set_index(["environment", "training_seed", "instance"])[value]
        if len(episodes) != len(policies) * sum(map(len, instances.values())):
            raise ValueError(
                f"frame must have all instances of all environments for each of the training seeds "
                f"of {agent!r}, {len(policies)} × {sum(map(len, instances.values()))} episodes, "
                f"got {len(episodes)}"
            )
        values[str(agent)] = tuple(
            episodes.loc[environment]
            .unstack()
            .reindex(index=policies, columns=instances[environment])
            .to_numpy(dtype=np.float64)
            for environment in environments
        )
        count[str(agent)] = 0 if policies == [_UNTRAINED] else len(policies)
    sizes = tuple(len(instances[environment]) for environment in environments)
    return Scores(tuple(map(str, environments)), sizes, values, count)


def draw(scores: Scores, resamples: int, seed: int) -> Draws:
    """Draw policies, and instances: one draw for all environments with as many of them.

    Instances depend on the seed and their number alone, neither on agents nor on environments.
    """
    of_instances = {
        count: _counts((seed, _INSTANCES, count), count, resamples)
        for count in set(scores.instances)
    }
    of_policies = {
        agent: _counts((seed, _POLICIES, number), len(values[0]), resamples)
        for number, (agent, values) in enumerate(scores.values.items())
    }
    return Draws(of_policies, tuple(of_instances[count] for count in scores.instances))


def _counts(seed: tuple[int, ...], count: int, resamples: int) -> Floats:
    drawn = np.random.default_rng(seed).integers(count, size=(resamples, count))
    cells: NDArray[np.intp] = drawn + np.arange(resamples)[:, None] * count
    times = np.bincount(cells.ravel(), minlength=resamples * count).reshape(resamples, count)
    return np.concatenate([np.ones((1, count)), times])
