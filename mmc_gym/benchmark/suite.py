"""The benchmark's scenarios: every task, and every family of perturbations in a few strengths."""

from __future__ import annotations

from collections.abc import Iterable

from mmc_gym.envs.scenarios import FAMILIES, TASK_SCENARIOS, Scenario, scenario

SCENARIOS: dict[str, Scenario] = {
    **TASK_SCENARIOS,
    **{one.name: one for family in FAMILIES.values() for one in family.scenarios},
}
"""The scenarios of the benchmark by name."""


def find_scenarios(names: Iterable[str]) -> dict[str, Scenario]:
    """Return scenarios by name: the benchmark's if no names are given, else any.

    Raises:
        UserError: for an unknown name, see `mmc_gym.envs.scenarios.scenario`.
    """
    found = map(scenario, names)
    return {one.name: one for one in found} or dict(SCENARIOS)
