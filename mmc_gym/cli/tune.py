"""`mmc-gym tune`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mmc_gym.progress import progress_bar


@dataclass(frozen=True)
class Tune:
    """Let Optuna look for better constants; goes on where it stopped."""

    name: Annotated[str, tyro.conf.Positional]
    """What to tune: mmc, mmc-feedback, or what train takes."""
    trials: int = 20
    """Number of trials, those of earlier calls included."""
    steps: int = 200_000
    """Environment steps of each trial."""
    out: Path = Path("runs/tune")
    """Folder for trials and result."""

    def run(self) -> None:
        """Tune, with a progress bar."""
        from mmc_gym.training.tuning import tune

        with progress_bar() as bar:
            task = bar.add_task(f"trials of {self.name}", total=self.trials)

            def on_trial(number: int, value: float) -> None:
                bar.update(task, completed=number + 1)
                bar.console.print(f"trial {number:>3}  time at target {value:6.2%}")

            result = tune(self.name, self.trials, self.steps, self.out, on_trial)
        print(
            f"{result['name']}: time at target {result['best_value']:.2%} with {result['best']}; "
            f"{result['value_of_those_in_use']:.2%} with the constants in use"
        )
