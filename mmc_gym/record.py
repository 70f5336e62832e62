"""Record: films of agents as GIF or MP4, without a display."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.wrappers import RenderCollection
from numpy.typing import NDArray

from mmc_gym._errors import UserError, missing
from mmc_gym._files import write_atomically
from mmc_gym.agents.base import Predictor
from mmc_gym.agents.resolver import AgentLike, resolve
from mmc_gym.benchmark.suite import make_player
from mmc_gym.envs.scenarios import EnvLike, parse_environment
from mmc_gym.measures import Episode, episode_seeds, run_episodes

Picture = NDArray[np.uint8]
_LEAST_DURATION = 0.02  # seconds for each picture of a GIF; browsers show shorter ones more slowly


def record(
    out: Path | str,
    agent: AgentLike = "mmc",
    env: EnvLike = "MMCReach-v0",
    episodes: int = 1,
    seed: int = 0,
    on_episode: Callable[[Episode], None] | None = None,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    interface: Any = None,
    allow_pickle: bool = False,
) -> Path:
    """Write a film of an agent in the first episodes that `compare` plays, and return its path.

    The file `out` ends in .gif, or in .mp4, which needs the extra `video`.  `on_episode` is called
    with each episode after it ends.  The other arguments are those of `mmc_gym.compare`.
    """
    out = Path(out)
    films = {".gif": gif, ".mp4": mp4}
    if out.suffix not in films or out.is_dir():
        raise UserError(f"out must be a file that ends in .gif or .mp4, got {str(out)!r}")
    if out.suffix == ".mp4":
        _require_ffmpeg()
    resolved = resolve(agent, allow_pickle=allow_pickle)
    seeds = episode_seeds(seed, episodes)
    given = {**(env_kwargs or {}), "render_mode": "rgb_array"}
    world, player = make_player(resolved, parse_environment(env, given, interface))
    try:
        pictures = _pictures(player, RenderCollection(world), seeds, on_episode)
        film = films[out.suffix](pictures, world.metadata["render_fps"])
    finally:
        world.close()
    return write_atomically(out, film)


def _pictures(
    player: Predictor,
    world: RenderCollection[Any, Any],
    seeds: Sequence[int],
    on_episode: Callable[[Episode], None] | None,
) -> Iterator[Picture]:
    """Play the episodes and yield a picture of each start and each step."""
    for seed in seeds:
        run_episodes(player, world, [seed], on_episode, records_effort=False)
        frames: Any = world.render()
        yield from frames


def gif(pictures: Iterable[Picture], frame_rate: int) -> bytes:
    """Return pictures (height, width, 3) as a GIF that loops, at most 50 pictures a second."""
    from PIL import Image

    every = math.ceil(_LEAST_DURATION * frame_rate)
    images = (
        Image.fromarray(picture).quantize()
        for number, picture in enumerate(pictures)
        if number % every == 0
    )
    film = io.BytesIO()
    next(images).save(
        film,
        format="GIF",
        save_all=True,
        append_images=images,
        duration=round(1000 * every / frame_rate),
        loop=0,
    )
    return film.getvalue()


def mp4(pictures: Iterable[Picture], frame_rate: int) -> bytes:
    """Return pictures (height, width, 3) as an MP4 film, H.264."""
    write_frames = _require_ffmpeg()
    with tempfile.TemporaryDirectory() as folder:
        path, left = Path(folder) / "film.mp4", iter(pictures)
        first = next(left)
        height, width, _ = first.shape
        writer = write_frames(path, (width, height), fps=frame_rate, quality=7)
        writer.send(None)
        for picture in chain((first,), left):
            writer.send(picture)
        writer.close()
        return path.read_bytes()


def _require_ffmpeg() -> Any:
    """Return the function that writes MP4, or raise a `MissingExtraError`."""
    try:
        from imageio_ffmpeg import write_frames
    except ImportError as error:
        raise missing("a film that ends in .mp4", "imageio_ffmpeg", "video") from error
    return write_frames
