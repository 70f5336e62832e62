"""`mmc-gym benchmark`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mmc_gym.progress import progress_bar


@dataclass(frozen=True)
class Benchmark:
    """Let agents play a battery of environments; keep all in a store, and print a ranking."""

    agents: tuple[str, ...] = ()
    """Names (ppo: all its training seeds; ppo-3: one), module:function, or LABEL=NAME."""
    environments: tuple[str, ...] = ()
    """Names of environments of the battery (default: all)."""
    episodes: int = 100
    """Episodes in each environment; numbered trials are played once each."""
    seed: int = 0
    """Seed of the starts and targets."""
    out: Path = Path("runs/benchmark")
    """Folder of the store; a benchmark that is there goes on, or is added to."""
    jobs: int | None = None
    """How many cells at once (default: one per core)."""
    cluster: str | None = None
    """Where, if not here: "ray", or "ray://HOST:PORT", to play on a Ray cluster."""

    def run(self) -> None:
        """Play, with a progress bar, and print the ranking."""
        from mmc_gym._console import make_console
        from mmc_gym.benchmark.entries import default_agents
        from mmc_gym.benchmark.ranking_table import print_ranking
        from mmc_gym.benchmark.runner import Progress, benchmark

        with progress_bar() as bar:
            task = bar.add_task("cells")

            def report(progress: Progress) -> None:
                bar.update(task, completed=progress.done, total=progress.total)

            benchmark(
                self.agents or default_agents(),
                self.out,
                self.environments,
                self.episodes,
                self.seed,
                jobs=self.jobs,
                cluster=self.cluster,
                on_progress=report,
            )
        print_ranking(make_console(), self.out)
