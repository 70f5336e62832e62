"""The environments by id: one for every task and for every perturbation by name.

Only names stand here, for the tables themselves import the physics; arguments by name also keep
Gymnasium's specs serialisable.  A test keeps the names and the tables in step.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym

STEPS = 100  # of an episode, 2 s, unless said otherwise

TASK_STEPS: dict[str, int] = {
    "paper": STEPS,
    "centre-out": STEPS,
    "double-step-100": STEPS,
    "double-step-200": STEPS,
    "pursuit": 500,  # one period of the target's path
    "via-points": 200,
}
"""Steps of an episode of each task that has an id; the task "random" is `MMCReach-v0`."""

_AS_IN_THE_EXPERIMENTS = ("force-field", "rotation-30", "rotation-45")
_ELSEWHERE = (
    "hand-mass",
    *(
        f"{change}-{percent}{told}"
        for change in ("longer", "shorter")
        for percent in (10, 20, 50)
        for told in ("", "-told")
    ),
    *("locked", "locked-told", "locks", "locks-told"),
    *("joint-noise", "joint-noise-speed", "vision-noise", "vision-noise-distance"),
    *("delay-40", "delay-100", "delay-200"),
    "obstacles",
)

PERTURBATION_TASKS: dict[str, str] = {
    **dict.fromkeys(_AS_IN_THE_EXPERIMENTS, "centre-out"),
    **dict.fromkeys(_ELSEWHERE, "random"),
}
"""The task in which each perturbation is met under its id; `task=` sets another."""


def register_all() -> None:
    """Register every environment with Gymnasium."""
    goal = ("reach:MMCReachGoalEnv", "vector:MMCReachGoalVectorEnv")
    _register("MMCReach", STEPS)
    _register("MMCReachGoal", STEPS, *goal)
    for name, steps in TASK_STEPS.items():
        _register(f"MMCReach{camel_case(name)}", steps, task=name)
    for name, task in PERTURBATION_TASKS.items():
        arguments: dict[str, Any] = {} if task == "random" else {"task": task}
        _register(f"MMCReach{camel_case(name)}", STEPS, **arguments, perturbations=[name])


def camel_case(name: str) -> str:
    """`longer-10-told` as it stands in an id: `Longer10Told`."""
    return "".join(word.capitalize() for word in name.split("-"))


def _register(
    name: str,
    steps: int,
    single: str = "reach:MMCReachEnv",
    vector: str = "vector:MMCReachVectorEnv",
    **arguments: Any,
) -> None:
    gym.register(
        id=f"{name}-v0",
        entry_point=f"mmc_gym.envs.{single}",
        vector_entry_point=f"mmc_gym.envs.{vector}",
        max_episode_steps=steps,
        kwargs=arguments,
    )
