"""Watch agents: films, alone or side by side, without a display; and a window to play in."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from itertools import chain, islice
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
from gymnasium.wrappers import RenderCollection
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mmc_gym._errors import missing, require, require_arguments, require_whole
from mmc_gym._files import write_atomically
from mmc_gym.agents.base import Predictor
from mmc_gym.agents.resolver import AgentLike, Agents, Statistics, Wrappers, resolve, resolve_all
from mmc_gym.benchmark.suite import make_player
from mmc_gym.envs.episodes import EXAMPLES
from mmc_gym.envs.render import View, open_display
from mmc_gym.envs.scenarios import EnvLike, parse_environment, parse_scenario
from mmc_gym.interface import InterfaceLike
from mmc_gym.measures import Episode, episode_seeds, run_episodes

Picture = NDArray[np.uint8]
_MOMENT = 11  # control steps
_HELD = 1.0  # seconds for which the end of an episode is shown
_LEAST_DURATION = 0.02  # seconds for each picture of a GIF; browsers show shorter ones more slowly


def record(
    out: Path | str,
    agents: AgentLike | Agents = "mmc",
    env: EnvLike = "MMCReach-v0",
    episodes: int = 1,
    seed: int = 0,
    on_episode: Callable[[Episode], None] | None = None,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    interface: InterfaceLike | None = None,
    allow_pickle: bool = False,
    wrapper: Wrappers = (),
    statistics: Statistics = (),
    every: int = 1,
) -> Path:
    """Write a film of agents in the first episodes that `compare` plays, and return its path.

    The file `out` ends in .gif, or in .mp4, which needs the extra `video`.  Several agents are side
    by side, half as large, under their names.  `on_episode` is called with each episode after it
    ends.  There is a picture of `every` so many steps; the film runs as fast.  The other arguments
    are those of `mmc_gym.compare`.
    """
    out = Path(out)
    formats = {".gif": gif, ".mp4": mp4}
    is_film = out.suffix in formats and not out.is_dir()
    require(is_film, "out", str(out), "a file that ends in .gif or .mp4")
    if out.suffix == ".mp4":
        _require_ffmpeg()
    loading: Any = {"allow_pickle": allow_pickle, "wrapper": wrapper, "statistics": statistics}
    all_agents: Any = agents if isinstance(agents, (list, tuple, Mapping)) else [agents]
    resolved_agents = resolve_all(all_agents, every_training=False, **loading)
    seeds, every = episode_seeds(seed, episodes), require_whole("every", every)
    arguments = require_arguments("env_kwargs", env_kwargs) | {"render_mode": "rgb_array"}
    scenario = parse_environment(env, arguments, interface)
    with ExitStack() as stack:
        players: dict[str, tuple[Predictor, RenderCollection[Any, Any]]] = {}
        for agent in resolved_agents:
            world, player = make_player(agent, scenario)
            stack.callback(world.close)
            players[agent.label] = player, RenderCollection(world)
        rate = world.metadata["render_fps"] / every
        pictures = _pictures(players, seeds, on_episode, every, math.ceil(_HELD * rate))
        return write_atomically(out, formats[out.suffix](pictures, rate))


def picture_draws(scenario: str, out: Path | str) -> Path:
    """Write the first episodes of a scenario, of the seeds 0 to 4, next to each other as a PNG.

    Each is shown a moment after its start, under what it has drawn; `mmc` acts.
    """
    require(Path(out).suffix == ".png", "out", str(out), "a file that ends in .png")
    world, player = make_player(resolve("mmc"), parse_scenario(scenario, render_mode="rgb_array"))
    panels = []
    with closing(world):
        for seed in range(EXAMPLES):
            (observation, info), state = world.reset(seed=seed), None
            for _ in range(_MOMENT):
                action, state = player.predict(observation, state)
                observation = world.step(action)[0]
            frame: Any = world.render()
            context = info.get("context", {})
            values = [f"{value:.3g}" for value in context.values() if value == value]
            panels.append(np.asarray(named(Image.fromarray(frame).reduce(2), ", ".join(values))))
    picture = io.BytesIO()
    Image.fromarray(np.hstack(panels)).save(picture, format="PNG", optimize=True)
    return write_atomically(out, picture.getvalue())


def _pictures(
    players: Mapping[str, tuple[Predictor, RenderCollection[Any, Any]]],
    seeds: Sequence[int],
    on_episode: Callable[[Episode], None] | None,
    every: int,
    held: int,
) -> Iterator[Picture]:
    """Play the episodes; yield a picture of each start, of `every` so many steps, and of the end.

    The end is yielded so many more times as it is `held`.
    """
    for seed in seeds:
        films: list[Sequence[Picture]] = []
        for player, world in players.values():
            run_episodes(player, world, [seed], on_episode, records_effort=False)
            frames: Any = world.render()
            films.append(frames)
        longest = max(films, key=len)
        for number in (*range(0, len(longest) - 1, every), *[len(longest) - 1] * (1 + held)):
            panels = [film[min(number, len(film) - 1)] for film in films]
            if len(panels) > 1:  # next to each other, half as large, under their names
                halves = [Image.fromarray(panel).reduce(2) for panel in panels]
                panels = [np.asarray(named(half, name)) for half, name in zip(halves, players)]
            yield np.hstack(panels)


def named(picture: Image.Image, name: str) -> Image.Image:
    """Return a picture with a name in place of its caption, large enough for a narrow screen."""
    width, height, caption = picture.width, picture.width // 9, picture.width // 22
    disc = picture.crop((0, caption, width, picture.height))
    tall = -(-(height + disc.height) // 16) * 16  # as encoders of video like it
    panel = Image.new("RGB", (width, tall), picture.getpixel((0, width - 1)))
    panel.paste(disc, (0, tall - disc.height))
    font = ImageFont.load_default(0.85 * height)
    ImageDraw.Draw(panel).text((6, 0), name, font=font, fill=(30, 40, 60))
    return panel


def gif(pictures: Iterable[Picture], frame_rate: float) -> bytes:
    """Return pictures (height, width, 3) as a GIF that loops, at most 50 pictures a second."""
    every = math.ceil(_LEAST_DURATION * frame_rate)
    images = (Image.fromarray(frame).quantize() for frame in islice(pictures, None, None, every))
    film, timing = io.BytesIO(), {"duration": round(1000 * every / frame_rate), "loop": 0}
    next(images).save(film, format="GIF", save_all=True, append_images=images, **timing)
    return film.getvalue()


def mp4(pictures: Iterable[Picture], frame_rate: float) -> bytes:
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


def _require_ffmpeg() -> Callable[..., Any]:
    try:
        from imageio_ffmpeg import write_frames
    except ImportError as error:
        raise missing("a film that ends in .mp4", "imageio_ffmpeg", "video") from error
    return write_frames


def play(
    agent: AgentLike = "mmc",
    env: EnvLike = "MMCReach-v0",
    seed: int | None = None,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    allow_pickle: bool = False,
    wrapper: Wrappers = (),
    statistics: Statistics = (),
) -> None:
    """Open a window in which the mouse moves the target and an agent the arm.

    R draws a new posture, Q ends.  Without a `seed` postures differ each time.  The other arguments
    are those of `mmc_gym.compare`; there is no time limit.

    Raises:
        UserError: without a display, for an unknown agent, or for an environment without an arm.
    """
    open_display(must_be_seen=True)
    try:
        arguments = require_arguments("env_kwargs", env_kwargs)
        arguments |= {"render_mode": "human", "max_episode_steps": -1}
        loading: Any = {"allow_pickle": allow_pickle, "wrapper": wrapper, "statistics": statistics}
        (resolved,) = resolve_all([agent], every_training=False, **loading)
        world, player = make_player(resolved, parse_environment(env, arguments))
        with closing(world):
            for _ in frames(world, player, seed):
                pass
    finally:
        pygame.display.quit()


def frames(
    world: gym.Env[Any, Any], player: Predictor, seed: int | None = None
) -> Iterator[dict[str, Any]]:
    """Play until the window is closed, and yield the info of the start and of each step."""
    reach: Any = world.unwrapped
    view, workspace = View(reach.setup.limits.farthest), reach.episode.workspace
    observation, info = world.reset(seed=seed)
    state = None
    yield info
    while pygame.display.get_init():
        keys = {event.key for event in pygame.event.get(pygame.KEYDOWN)}
        if keys & {pygame.K_q, pygame.K_ESCAPE}:
            return
        if pygame.K_r in keys:
            observation, info = world.reset(options={"target": tuple(info["target"])})
            state = None
        if pygame.mouse.get_focused():
            nearest = workspace.nearest(view.point(pygame.mouse.get_pos()))
            if workspace.contains(nearest):  # no obstacle is there
                reach.set_target(nearest)
        start = np.full(1, state is None)
        action, state = player.predict(observation, state, start, deterministic=True)
        observation, _, _, _, info = world.step(action)
        yield info
