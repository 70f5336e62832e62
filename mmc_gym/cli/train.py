"""`mmc-gym train`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mmc_gym.progress import progress_bar

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

# Options of Train that --all has no use for, and that only --all has one for.
_FOR_ONE = ("env", "seed", "tensorboard")
_FOR_ALL = ("jobs", "cluster")


@dataclass(frozen=True)
class Train:
    """Train an agent by its YAML hyperparameters; a killed training goes on with --resume."""

    name: Annotated[str, tyro.conf.Positional] = ""
    """A name that ships, such as ppo or tqc-her, or a YAML file of one's own: my/ppo-mine.yml."""
    all: bool = False
    """Train every policy that ships with the package; goes on where it was interrupted."""
    env: str | None = None
    """Environment id, of those in the YAML file (default: the first)."""
    seed: int = 0
    """Seed of everything random."""
    steps: int | None = None
    """Environment steps, instead of those in the YAML file."""
    out: Path | None = None
    """Folder for checkpoint and policy (default: runs/NAME-SEED, or runs/train-all)."""
    resume: bool = False
    """Go on from the checkpoint in the folder, if there is one; --all always does."""
    tensorboard: Path | None = None
    """Folder for TensorBoard's logs."""
    device: str = "cpu"
    """Device that PyTorch computes on: cpu, cuda, cuda:1, auto."""
    jobs: int | None = None
    """With --all: how many trainings at once (default: one per core)."""
    cluster: str | None = None
    """With --all: "ray", or "ray://HOST:PORT", to train on a Ray cluster."""

    def run(self) -> None:
        """Train, with a progress bar."""
        from mmc_gym.training.hyperparameters import names

        if self.all == bool(self.name):
            raise ValueError(
                f"name must be one of {', '.join(names())}, or the path of a YAML file, "
                f"or else give --all, got {self.name!r}{' and --all' if self.all else ''}"
            )
        for option in _FOR_ONE if self.all else _FOR_ALL:
            if getattr(self, option) != getattr(Train, option):
                other = "a single training" if self.all else "--all"
                raise ValueError(f"--{option} is for {other} only, got {getattr(self, option)}")
        with progress_bar() as bar:
            (self._train_all if self.all else self._train_one)(bar)

    def _train_one(self, bar: Bar) -> None:
        from mmc_gym.agents.policy import FINAL_EPISODES
        from mmc_gym.training.hyperparameters import policy_name, read_hyperparameters
        from mmc_gym.training.training import Progress, Training

        env_id, hyperparameters = read_hyperparameters(self.name, self.env)
        if self.steps is not None:
            hyperparameters["n_timesteps"] = self.steps
        name = policy_name(self.name)
        folder = self.out or Path("runs") / f"{name}-{self.seed}"
        task = bar.add_task(f"{name}, seed {self.seed}")

        def report(progress: Progress) -> None:
            bar.update(task, completed=progress.steps)
            if scores := progress.evaluation:
                bar.console.print(
                    f"{progress.steps:>10,} steps  success {scores['success']:6.1%}  "
                    f"final distance {scores['final_distance']:.3f}  {scores['seconds']:6.0f} s"
                )

        training = Training(
            name,
            hyperparameters,
            env_id,
            self.seed,
            folder,
            report,
            device=self.device,
            tensorboard=self.tensorboard,
        )
        bar.update(task, total=training.total_steps)
        card = training.run(self.resume)
        bar.stop()
        print(
            f"{folder / card.file_stem}.safetensors: success {card.scores['success']:.1%} over "
            f"{FINAL_EPISODES} fixed episodes after {card.training_steps:,} steps in "
            f"{card.training_seconds:.0f} s"
        )

    def _train_all(self, bar: Bar) -> None:
        from mmc_gym.agents.policy import PolicyCard
        from mmc_gym.training.grid import shipped_cells, train_all

        policies = shipped_cells()
        task = bar.add_task("policies", total=len(policies))

        def on_policy(card: PolicyCard) -> None:
            bar.advance(task)
            bar.console.print(
                f"{card.file_stem:<16} success {card.scores['success']:6.1%}  "
                f"{card.training_steps:>10,} steps  {card.training_seconds:6.0f} s"
            )

        def on_note(note: str) -> None:
            bar.console.print(note, markup=False, highlight=False)

        train_all(
            policies,
            self.out or Path("runs/train-all"),
            steps=self.steps,
            device=self.device,
            jobs=self.jobs,
            cluster=self.cluster,
            on_policy=on_policy,
            on_note=on_note,
        )
