"""`mmc-gym play`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Play:
    """Open a window in which the mouse is the target of an agent's arm."""

    agent: str = "mmc"
    """Name of the agent to start with."""
    env: str = "MMCReach-v0"
    """Environment id."""
    seed: int | None = None
    """Seed of the first posture."""

    def run(self) -> None:
        """Play."""
        from mmc_gym.play import play

        play(self.agent, self.env, self.seed)
