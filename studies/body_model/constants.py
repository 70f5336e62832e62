"""Measure what half and double of each constant of `mmc-body` cost.

All settings play the same episodes, so that a difference is due to the constant.  A constant costs
nothing where no episode ends otherwise.  Those of arms in space and of learning are not played.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from types import ModuleType

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from mmc_gym.agents import body_model as package
from mmc_gym.envs.scenarios import parse_scenario
from studies.body_model.playing import body_model, play, successes
from studies.tables import table_of

SCENARIOS = """
    random locks-2 hand-mass-10 force-field-90 joint-noise-0.05 vision-noise-0.1 delay-400
    obstacles-2+joint-noise-0.03 pursuit+joint-noise-0.03 gain-3.6 mirror-at-1 delay-160-at-0.4
    rotation-40+rotation--80-at-1 locked-2-at-0.2-until-1 motor-gain-0.4-of-1 motor-offset-0.2-of-2
    servo-gain-0.5 dead-zone-0.3 stuck-sensor-2 dropped-numbers-0.1
"""
NOT_PLAYED = ("memory", "spatial")
FACTORS = (0.5, 2.0)
MODULES = [
    importlib.import_module(f"{package.__name__}.{module.name}")
    for module in pkgutil.iter_modules(package.__path__)
]


@dataclass(frozen=True)
class Constant:
    """A positive number that a module of the body agents holds."""

    module: str
    name: str
    value: float | int

    @contextmanager
    def times(self, factor: float) -> Iterator[None]:
        """Let every module that has the constant hold a multiple of it; 1 at least if it counts.

        Of a share that is kept (`KEEP`) what is forgotten is multiplied.
        """
        other = factor * self.value
        if isinstance(self.value, int):
            other = max(1, round(other))
        elif self.name.startswith("KEEP"):
            other = 1 - factor * (1 - self.value)
        owner = importlib.import_module(self.module)
        value = getattr(owner, self.name)
        holders = [module for module in MODULES if vars(module).get(self.name) is value]
        for module in holders:
            setattr(module, self.name, other)
        try:
            yield
        finally:
            for module in holders:
                setattr(module, self.name, value)


@dataclass(frozen=True)
class Arguments:
    """Measure what half and double of each constant cost."""

    episodes: int = 40  # in each scenario
    seed: int = 80_000  # seed of the episodes
    only: tuple[str, ...] = ()  # names of constants; by default all
    scenarios: tuple[str, ...] = tuple(SCENARIOS.split())
    processes: int = 2


def constants_of(module: ModuleType) -> list[Constant]:
    """Return the positive numbers that a module assigns, in its order."""
    body = ast.parse(inspect.getsource(module)).body
    targets = [target for line in body if isinstance(line, ast.Assign) for target in line.targets]
    nodes = [node for target in targets for node in ast.walk(target)]
    values = {node.id: vars(module)[node.id] for node in nodes if isinstance(node, ast.Name)}
    return [
        Constant(module.__name__, name, value)
        for name, value in values.items()
        if isinstance(value, int | float) and value > 0
    ]


def results(
    arguments: Arguments, constant: Constant | None = None, factor: float = 1.0
) -> np.ndarray:
    """Return successes, with a multiple of a constant if given, per cent, (scenarios, episodes)."""
    scenarios = map(parse_scenario, arguments.scenarios)
    played = (play(body_model(), each, arguments.episodes, arguments.seed) for each in scenarios)
    with constant.times(factor) if constant else nullcontext():
        return np.array([100 * successes(episodes)[0] for episodes in played])


def row_of(
    constant: Constant, plain: np.ndarray, multiples: Sequence[np.ndarray], names: Sequence[str]
) -> dict[str, str]:
    """Return the row of a constant in the table."""
    change = [(multiple - plain).mean(axis=-1) for multiple in multiples]
    worst = np.minimum(*change)
    return {
        "constant": f"{constant.module.rpartition('.')[2]}.{constant.name}",
        "value": f"{constant.value:g}",
        "half": f"{change[0].mean():+.2f}",
        "double": f"{change[1].mean():+.2f}",
        "worst scenario": f"{worst.min():+.1f} {names[worst.argmin()]}" if worst.any() else "–",
        "other ends": f"{np.sum([multiple != plain for multiple in multiples])}",
    }


def main(arguments: Arguments) -> None:
    constants = [
        constant
        for module in MODULES
        if module.__name__.rpartition(".")[2] not in NOT_PLAYED
        for constant in constants_of(module)
        if constant.name in arguments.only or not arguments.only
    ]
    if unknown := {*arguments.only} - {constant.name for constant in constants}:
        raise SystemExit(f"--only must be names of constants, such as LAG, got {sorted(unknown)}")
    with ProcessPoolExecutor(arguments.processes) as pool:
        plain = pool.submit(results, arguments)
        jobs = [
            [pool.submit(results, arguments, constant, factor) for factor in FACTORS]
            for constant in constants
        ]
        rows = [
            row_of(constant, plain.result(), [job.result() for job in pair], arguments.scenarios)
            for constant, pair in zip(track(constants, transient=True), jobs)
        ]
    title = f"success of mmc-body, points of per cent: {len(arguments.scenarios)} scenarios, "
    title += f"{arguments.episodes} episodes each; {plain.result().mean():.1f} % as it is"
    Console(width=110).print(table_of(rows, title))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
