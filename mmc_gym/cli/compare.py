"""`mmc-gym compare`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Compare:
    """Run agents over the same starts and targets; print a table, write data and figure."""

    agents: tuple[str, ...] = (
        "mmc",
        "mmc-classical",
        "mmc-neural",
        "ik-dls",
        "ppo",
        "sac",
        "tqc-her",
        "random",
    )
    """Names of agents, or module:function, called with the environment."""
    env: str = "MMCReach-v0"
    """Environment id."""
    episodes: int = 200
    """Episodes per agent."""
    seed: int = 0
    """Seed of the starts and targets."""
    out: Path = Path("runs/compare")
    """Folder for episodes.csv, the summary and the figure."""

    def run(self) -> None:
        """Compare."""
        from mmc_gym.benchmark.compare import compare

        compare(self.agents, self.env, self.episodes, self.seed, self.out)
