"""Draw the film at the top of README: three agents whose second joint locks on the way.

python docs/draw_film.py [docs/film.gif]
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
from generate import Filmed, named
from PIL import Image

from mmc_gym._files import write_atomically
from mmc_gym.agents import resolve
from mmc_gym.benchmark.suite import make_player
from mmc_gym.envs.scenarios import parse_scenario
from mmc_gym.measures import episode_seeds, run_episodes

AGENTS = ("mmc", "mmc-body", "ppo")
EPISODES = (0, 11)  # of those that `mmc-gym compare` plays
SCENARIO = parse_scenario("locks-2", render_mode="rgb_array")
SIZE = 360  # pixels of a panel
COLOURS = 64


def panels(agent: str) -> list[Image.Image]:
    """Return the pictures of one agent, with its name."""
    world, player = make_player(resolve(agent), SCENARIO)
    filmed, found = Filmed(world), []
    for number in EPISODES:
        run_episodes(player, filmed, [episode_seeds(0, number + 1)[-1]], records_effort=False)
        found += filmed.pictures
    world.close()
    small = (picture.resize((SIZE, SIZE), Image.Resampling.LANCZOS) for picture in found)
    return [named(picture, agent) for picture in small]


def film() -> bytes:
    """Return the film as a GIF that repeats."""
    frames = [
        Image.fromarray(np.hstack([np.asarray(picture) for picture in together]))
        for together in zip(*map(panels, AGENTS), strict=True)
    ]
    palette = frames[0].quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [80] * len(small)
    for last in range(len(small) // len(EPISODES) - 1, len(small), len(small) // len(EPISODES)):
        durations[last] = 1000
    held = io.BytesIO()
    small[0].save(
        held, format="GIF", save_all=True, append_images=small[1:], duration=durations, loop=0
    )
    return held.getvalue()


if __name__ == "__main__":
    default = Path(__file__).resolve().parent / "film.gif"
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    print(f"wrote {write_atomically(out, film())}")
