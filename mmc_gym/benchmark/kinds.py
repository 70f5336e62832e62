"""Kinds never met: how good an agent is at groups of perturbations that its training never had.

A policy is trained on all groups but one (`mmc-gym train --without motors`) and judged on that one.
Kirk, Zhang, Grefenstette & Rocktäschel (2023), JAIR 76:201, ask how a policy does at strengths that
it never met, see `generalisation`; this asks it of kinds.
"""

from __future__ import annotations

import re
from collections.abc import Container
from contextlib import suppress

from mmc_gym._errors import UserError
from mmc_gym.benchmark.suite import SUITES
from mmc_gym.envs.names import BASELINE
from mmc_gym.envs.perturbations import GROUPS
from mmc_gym.envs.scenarios import parse_scenario


def name_without(name: str, group: str) -> str:
    """Return the name of a training without a group, by which the report knows it.

    >>> name_without("ppo-drawn", "motors"), name_without("ppo-drawn-3", "motors")
    ('ppo-drawn-without-motors', 'ppo-drawn-without-motors-3')
    """
    return re.sub(r"(-\d+)?$", rf"-without-{group}\1", name, count=1)


def lacks_group(name: str) -> bool:
    """Return whether a training of this name left a group out, see `name_without`."""
    return any(f"-without-{group}" in name for group in GROUPS)


def group_of(scenario: str) -> str:
    """Return the group of all of a scenario's perturbations; "" if there is none."""
    with suppress(UserError):  # an environment of yours
        groups = {change.family.group for change in parse_scenario(scenario).changes}
        return groups.pop() if len(groups) == 1 else ""
    return ""


def protocol() -> list[str]:
    """Return the scenarios of the protocol: no change, and those with changes of one group."""
    names = dict.fromkeys((*SUITES["standard"], *SUITES["faults"]))
    return [BASELINE, *(name for name in names if group_of(name))]


def trained_without(name: str, agents: Container[str]) -> dict[str, str]:
    """Return which of the agents are trainings like that of `name` without a group, by group."""
    names = {group: name_without(name, group) for group in GROUPS}
    return {group: label for group, label in names.items() if label in agents}
