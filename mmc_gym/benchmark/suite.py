"""The benchmark's scenarios: every task, and every family of perturbations in a few strengths."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

from mmc_gym.envs.perturbations import FAMILIES, Family
from mmc_gym.envs.scenarios import (
    TASK_SCENARIOS,
    EnvLike,
    Scenario,
    own_scenario,
    perturbed,
    scenario,
)


def _in_strengths(family: Family) -> list[Scenario]:
    given = [perturbed(family, strength, told=True) for strength in family.told or ()]
    return [*(perturbed(family, strength) for strength in family.strengths), *given]


SCENARIOS: dict[str, Scenario] = {
    **TASK_SCENARIOS,
    **{one.name: one for family in FAMILIES.values() for one in _in_strengths(family)},
}
"""The scenarios of the benchmark by name."""


Environments: TypeAlias = "Iterable[str] | Mapping[str, EnvLike]"
"""Names of scenarios and of your own environments; or these by names of yours."""


def find_scenarios(
    environments: Environments, env_kwargs: Mapping[str, Any] | None = None
) -> dict[str, Scenario]:
    """Return scenarios by name: the benchmark's if none are given, else any.

    Args:
        environments: names, see `mmc_gym.envs.scenarios.scenario`; a mapping has environments of
            yours by names of yours, see `mmc_gym.envs.scenarios.make_environment`.
        env_kwargs: arguments of all of them.

    Raises:
        UserError: for an unknown name, or an environment that cannot be made.
    """
    if isinstance(environments, Mapping):
        found = [own_scenario(env, name) for name, env in environments.items()]
    else:
        names = [environments] if isinstance(environments, str) else environments
        found = [scenario(name) for name in names]
    chosen = {one.name: one for one in found} or dict(SCENARIOS)
    if not env_kwargs:
        return chosen
    return {name: replace(one, env_kwargs=env_kwargs) for name, one in chosen.items()}
