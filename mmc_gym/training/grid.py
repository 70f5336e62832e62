"""Train many policies as one grid, over the cores or on a cluster."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from mmc_gym._errors import UserError, require
from mmc_gym._files import check_folder, write_atomically
from mmc_gym._grid import run_grid
from mmc_gym.agents import AGENTS
from mmc_gym.agents.policy import PolicyCard, file_stem, load_policy
from mmc_gym.training.hyperparameters import read_recipe
from mmc_gym.training.training import Training, usable_device


class PolicyName(NamedTuple):
    """A policy to train: the name of its hyperparameters, and the seed of its training."""

    name: str
    seed: int


@dataclass(frozen=True)
class TrainingCell:
    """One training of a grid.

    Attributes:
        steps: environment steps; None for those of the hyperparameters.
        device: that torch computes on.
        folder: of the checkpoint, on this machine.  None on a cluster: where a node is lost, its
            training starts again, and ends with the same policy.
    """

    policy: PolicyName
    steps: int | None = None
    device: str = "cpu"
    folder: str | None = None

    @property
    def label(self) -> str:
        """The name of the policy's files, without suffix."""
        return file_stem(*self.policy)

    def training(self, folder: Path) -> Training:
        """Return the training, with everything in `folder`."""
        recipe = read_recipe(self.policy.name, steps=self.steps)
        return Training(recipe, self.policy.seed, folder, device=self.device)


def shipped_policies() -> list[PolicyName]:
    """Return every policy that ships."""
    return [
        PolicyName(name, seed)
        for name, entry in AGENTS.items()
        for seed in range(entry.training_seeds)
    ]


def train_all(
    policies: Sequence[PolicyName],
    out: Path,
    *,
    steps: int | None = None,
    device: str = "cpu",
    jobs: int | None = None,
    cluster: str | None = None,
    on_policy: Callable[[PolicyCard], None] = lambda card: None,
    on_note: Callable[[str], None] = lambda note: None,
) -> list[PolicyCard]:
    """Train policies, many at once, write their files into `out`, and return their cards.

    Policies that are there, trained with the same hyperparameters, are not trained again.
    Interrupted trainings go on from their checkpoints.

    Args:
        policies: to train.
        out: folder for the files.
        steps: environment steps, instead of those of the hyperparameters.
        device: that torch computes on.
        jobs: how many are trained at once, see `run_grid`.
        cluster: where, see `run_grid`.
        on_policy: called with the card of each policy that is ready.
        on_note: called when a checkpoint is discarded, with the reason.

    Raises:
        UserError: if `out` is a file, `steps` is below 1, or there are no such hyperparameters or
            no such device.
        CellError: if a training failed.
    """
    check_folder(out, "out")
    require(steps is None or steps >= 1, "steps", steps, "at least 1")
    if cluster is None:
        usable_device(device)
    cards: dict[PolicyName, PolicyCard] = {}
    cells = []
    for policy in policies:
        folder = None if cluster else str(out / "checkpoints" / file_stem(*policy))
        cell = TrainingCell(policy, steps, device, folder)
        card = _finished(cell, out)
        if card is None:
            _discard_other(cell, on_note)
            cells.append(cell)
        else:
            cards[policy] = card
            on_policy(card)

    def keep(index: int, contents: dict[str, bytes]) -> None:
        cell = cells[index]
        for file, content in contents.items():
            write_atomically(out / file, content)
        if cell.folder is not None:  # replay buffers are large
            shutil.rmtree(cell.folder)
        _, card = load_policy(out / f"{cell.label}.json")
        cards[cell.policy] = card
        on_policy(card)

    run_grid(train_cell, cells, jobs=jobs, cluster=cluster, on_result=keep)
    return [cards[policy] for policy in policies]


def train_cell(cell: TrainingCell) -> dict[str, bytes]:
    """Train a policy; return the contents of its files by their names."""
    with tempfile.TemporaryDirectory() as temporary:
        training = cell.training(Path(cell.folder or temporary))
        training.run(resume=True)
        return {file.name: file.read_bytes() for file in training.policy_files}


def _discard_other(cell: TrainingCell, on_note: Callable[[str], None]) -> None:
    """Remove the cell's checkpoint if the training cannot go on from it."""
    if cell.folder is None:
        return
    training = cell.training(Path(cell.folder))
    if not training.checkpoint.exists():
        return
    try:
        training.read_checkpoint_head()
    except UserError as error:
        on_note(f"{cell.label} begins anew: {error}")
        training.checkpoint.unlink()


def _finished(cell: TrainingCell, out: Path) -> PolicyCard | None:
    """Return the card of the cell's policy if it is there."""
    try:
        _, card = load_policy(out / f"{cell.label}.json")
    except (FileNotFoundError, ValueError):
        return None
    recipe = read_recipe(cell.policy.name, steps=cell.steps)
    same = (card.env_id, card.hyperparameters) == (recipe.env_id, recipe.hyperparameters)
    return card if same else None
