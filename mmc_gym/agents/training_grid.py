"""Many trainings as one grid: every policy that ships, over the cores or on a cluster."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mmc_gym._files import write_atomically
from mmc_gym._grid import run_grid
from mmc_gym.agents import AGENTS
from mmc_gym.agents.hyperparameters import Hyperparameters, read_hyperparameters
from mmc_gym.agents.reinforcement import PolicyCard, load_policy
from mmc_gym.agents.training import CHECKPOINT, Training


@dataclass(frozen=True)
class TrainingCell:
    """One training of a grid.

    Attributes:
        name: of the hyperparameters.
        seed: of everything random.
        steps: environment steps, instead of those of the hyperparameters; None for these.
        device: that torch computes on.
        folder: where the checkpoint lies, on this machine; None on a cluster, whose nodes start
            a training that was lost anew, and come to the same policy.
    """

    name: str
    seed: int
    steps: int | None = None
    device: str = "cpu"
    folder: str | None = None

    def hyperparameters(self) -> tuple[str, Hyperparameters]:
        """Environment id and hyperparameters."""
        env_id, hyperparameters = read_hyperparameters(self.name)
        if self.steps is not None:
            hyperparameters["n_timesteps"] = self.steps
        return env_id, hyperparameters


def shipped_cells() -> list[tuple[str, int]]:
    """Name and seed of every policy that ships."""
    return [(name, seed) for name, entry in AGENTS.items() for seed in range(entry.training_seeds)]


def train_all(
    policies: Sequence[tuple[str, int]],
    out: Path,
    *,
    steps: int | None = None,
    device: str = "cpu",
    jobs: int | None = None,
    cluster: str | None = None,
    on_policy: Callable[[PolicyCard], None] = lambda card: None,
) -> list[PolicyCard]:
    """Train policies, many at once, and write their files into a folder.

    What is there already, trained with the same hyperparameters, is not trained again; trainings
    that were interrupted go on from their checkpoints.

    Args:
        policies: name and seed of each.
        out: the folder.
        steps: environment steps, instead of those of the hyperparameters.
        device: that torch computes on.
        jobs: how many are trained at once, see `run_grid`.
        cluster: where, see `run_grid`.
        on_policy: called with the card of each policy that is ready.

    Returns:
        The cards, in the order of `policies`.
    """
    cards: dict[tuple[str, int], PolicyCard] = {}
    cells = []
    for name, seed in policies:
        folder = None if cluster else str(out / "checkpoints" / f"{name}-{seed}")
        cell = TrainingCell(name, seed, steps, device, folder)
        card = _finished(cell, out)
        if card is None:
            cells.append(cell)
        else:
            cards[name, seed] = card
            on_policy(card)

    def keep(index: int, contents: dict[str, bytes]) -> None:
        cell = cells[index]
        for file, content in contents.items():
            write_atomically(out / file, content)
        _, card = load_policy(out / f"{cell.name}-{cell.seed}.json")
        cards[cell.name, cell.seed] = card
        on_policy(card)

    run_grid(train_cell, cells, jobs=jobs, cluster=cluster, on_result=keep)
    return [cards[policy] for policy in policies]


def train_cell(cell: TrainingCell) -> dict[str, bytes]:
    """Train a policy; the contents of its files by their names."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(cell.folder or temporary)
        env_id, hyperparameters = cell.hyperparameters()
        training = Training(
            cell.name, hyperparameters, env_id, cell.seed, folder, device=cell.device
        )
        card = training.run(resume=True)
        names = (f"{card.file_stem}.{suffix}" for suffix in ("safetensors", "json"))
        contents = {name: (folder / name).read_bytes() for name in names}
        (folder / CHECKPOINT).unlink()  # of no more use, and replay buffers are large
        return contents


def _finished(cell: TrainingCell, out: Path) -> PolicyCard | None:
    """The card of the policy that the cell asks for, if it is there."""
    try:
        _, card = load_policy(out / f"{cell.name}-{cell.seed}.json")
    except (FileNotFoundError, ValueError):
        return None
    asked: tuple[str, dict[str, Any]] = cell.hyperparameters()
    return card if (card.env_id, card.hyperparameters) == asked else None
