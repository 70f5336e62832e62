"""Many trainings as one grid: every policy that ships, over the cores or on a cluster."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mmc_gym._files import check_folder, write_atomically
from mmc_gym._grid import run_grid
from mmc_gym.agents import AGENTS
from mmc_gym.agents.policy import PolicyCard, load_policy
from mmc_gym.training.hyperparameters import Hyperparameters, read_hyperparameters
from mmc_gym.training.training import CHECKPOINT, Training, usable_device


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

    def training(self, folder: Path) -> Training:
        """The training, with everything in `folder`."""
        env_id, hyperparameters = self.hyperparameters()
        return Training(self.name, hyperparameters, env_id, self.seed, folder, device=self.device)


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
    on_note: Callable[[str], None] = lambda note: None,
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
        on_note: called with what else is to be said, of checkpoints that are discarded.

    Returns:
        The cards, in the order of `policies`.

    Raises:
        ValueError: if `out` is a file, `steps` below 1, or there are no such hyperparameters or no
            such device.
        CellError: if a training failed.
    """
    check_folder(out, "out")
    if steps is not None and steps < 1:
        raise ValueError(f"steps must be at least 1, got {steps}")
    if cluster is None:
        usable_device(device)
    cards: dict[tuple[str, int], PolicyCard] = {}
    cells = []
    for name, seed in policies:
        folder = None if cluster else str(out / "checkpoints" / f"{name}-{seed}")
        cell = TrainingCell(name, seed, steps, device, folder)
        card = _finished(cell, out)
        if card is None:
            _discard_other(cell, on_note)
            cells.append(cell)
        else:
            cards[name, seed] = card
            on_policy(card)

    def keep(index: int, contents: dict[str, bytes]) -> None:
        cell = cells[index]
        for file, content in contents.items():
            write_atomically(out / file, content)
        if cell.folder is not None:  # of no more use, and replay buffers are large
            shutil.rmtree(cell.folder)
        _, card = load_policy(out / f"{cell.name}-{cell.seed}.json")
        cards[cell.name, cell.seed] = card
        on_policy(card)

    run_grid(train_cell, cells, jobs=jobs, cluster=cluster, on_result=keep)
    return [cards[policy] for policy in policies]


def train_cell(cell: TrainingCell) -> dict[str, bytes]:
    """Train a policy; the contents of its files by their names."""
    with tempfile.TemporaryDirectory() as temporary:
        training = cell.training(Path(cell.folder or temporary))
        training.run(resume=True)
        return {file.name: file.read_bytes() for file in training.policy_files}


def _discard_other(cell: TrainingCell, on_note: Callable[[str], None]) -> None:
    """Remove the cell's checkpoint if the training cannot go on from it."""
    if cell.folder is None or not (Path(cell.folder) / CHECKPOINT).exists():
        return
    training = cell.training(Path(cell.folder))
    try:
        training.check_checkpoint()
    except ValueError as error:
        on_note(f"{cell.name}-{cell.seed} begins anew: {error}")
        (Path(cell.folder) / CHECKPOINT).unlink()


def _finished(cell: TrainingCell, out: Path) -> PolicyCard | None:
    """The card of the policy that the cell asks for, if it is there."""
    try:
        _, card = load_policy(out / f"{cell.name}-{cell.seed}.json")
    except (FileNotFoundError, ValueError):
        return None
    return card if (card.env_id, card.hyperparameters) == cell.hyperparameters() else None
