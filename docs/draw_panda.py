"""Draw the film of a Panda whose second joint is locked: `mmc-body` and plain IK.

Needs panda-gym: pip install "mmc-gym[bodies]".

    python docs/draw_panda.py [docs/panda.gif]
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from examples.panda_reach import BASE, Encoders
from studies.other_bodies.panda import INTERFACE, make
from studies.other_bodies.panda_bodies import make_env

LOCKED = 1  # the shoulder
SEEDS = (6, 9, 5)
AGENTS = {"mmc-body": "mmc-body", "least squares": "plain IK"}
LONGEST = 24  # steps that are shown of an episode
COLOURS = 48


def episodes(name: str) -> list[tuple[np.ndarray, np.ndarray, bool]]:
    """Return postures, target and success of each episode."""
    env: Any = Encoders(make_env(locked=(LOCKED,)))
    agent, found = make(name, env, Path()), []
    for seed in SEEDS:
        observation, _ = env.reset(seed=seed)
        state, postures, ended = None, [observation["joints"][0]], False
        while not ended:
            action, state = agent.predict(observation, state)
            observation, _, reached, truncated, _ = env.step(action)
            postures.append(observation["joints"][0])
            ended = reached or truncated
        found.append((np.array(postures), observation["desired_goal"] - BASE, reached))
    env.close()
    return found


def picture(played: dict[str, Any], number: int, step: int) -> Image.Image:
    """Return the picture of a step of all agents."""
    figure = plt.figure(figsize=(6.4, 3.4), dpi=90)
    for place, (name, label) in enumerate(AGENTS.items(), start=1):
        postures, target, reached = played[name][number]
        nodes = INTERFACE.arm.nodes(postures[: step + 1])
        axes: Any = figure.add_subplot(1, len(AGENTS), place, projection="3d")
        arm = np.vstack([np.zeros(3), nodes[-1]])
        axes.plot(*arm.T, "o-", color="black", linewidth=4, markersize=6)
        axes.plot(*arm[1], "o", color="tab:red", fillstyle="none", markersize=16, markeredgewidth=2)
        axes.plot(*nodes[:, -1].T, "--", color="tab:blue", linewidth=1.5)
        axes.plot(*target, "x", color="black", markersize=12, markeredgewidth=3)
        is_over = step >= len(postures) - 1
        end = " reaches" if is_over and reached else ""
        axes.set_title(f"{label}{end}", fontsize=12)
        axes.set(xlim=(0, 0.8), ylim=(-0.4, 0.4), zlim=(0, 0.8))
        axes.set(xticklabels=[], yticklabels=[], zticklabels=[])
        axes.set_box_aspect((1, 1, 1), zoom=1.25)
        axes.view_init(elev=15, azim=-50)
    figure.subplots_adjust(left=0, right=1, bottom=0, top=0.9, wspace=0)
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()  # type: ignore[attr-defined]
    plt.close(figure)
    return Image.fromarray(pixels)


def main(out: Path) -> None:
    """Draw the film, a GIF that repeats."""
    played = {name: episodes(name) for name in AGENTS}
    frames, durations = [], []
    for number in range(len(SEEDS)):
        last = max(len(played[name][number][0]) for name in AGENTS) - 1
        for step in range(min(last, LONGEST) + 1):
            frames.append(picture(played, number, step))
            durations.append(120)
        durations[-1] = 1200
    palette = frames[-1].quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    small[0].save(out, save_all=True, append_images=small[1:], duration=durations, loop=0)
    print(f"wrote {out}, {out.stat().st_size // 1024} kB, {len(frames)} pictures")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("panda.gif"))
