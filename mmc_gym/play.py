"""Play: a window in which the mouse moves the target and an agent moves the arm."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from typing import Any, cast

import gymnasium as gym
import numpy as np
import pygame

from mmc_gym.agents import AGENTS
from mmc_gym.agents.base import Predictor
from mmc_gym.agents.resolver import AgentLike, resolve
from mmc_gym.benchmark.suite import make_player
from mmc_gym.envs import render as drawing
from mmc_gym.envs.reach import MMCReachEnv
from mmc_gym.envs.render import open_display
from mmc_gym.envs.scenarios import EnvLike, parse_environment

HELP = "mouse: target    1-9, Tab: agent    Space: pause    R: new posture    Q: quit"
_LINE = 26  # height of a line of text, pixels
_INDENT = 14
_FONT_SIZE = 20


def play(
    agent: AgentLike = "mmc",
    env: EnvLike = "MMCReach-v0",
    seed: int | None = None,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    allow_pickle: bool = False,
) -> None:
    """Open a window in which the mouse moves the target and an agent the arm.

    Keys choose among `mmc_gym.agents.AGENTS`; `agent` is the first.  Without a `seed` postures
    differ each time.  The other arguments are those of `mmc_gym.compare`; there is no time limit.

    Raises:
        UserError: without a display, for an unknown agent, or for an environment without an arm.
    """
    open_display(must_be_seen=True)
    try:
        first = resolve(agent, allow_pickle=allow_pickle)
        given = {**(env_kwargs or {}), "render_mode": "rgb_array", "max_episode_steps": -1}
        world, _ = make_player(first, parse_environment(env, given))
        with closing(world):
            makers: dict[str, Callable[[], Predictor]]
            makers = {name: partial(one.make, world) for name, one in AGENTS.items()}
            makers[first.label] = partial(first.factory, world)
            Game(world, makers, first.label, seed).run()
    finally:
        pygame.display.quit()


class Game:
    """The window: it reads keys and mouse, and simulates one control step per frame."""

    def __init__(
        self,
        env: gym.Env[Any, Any],
        makers: Mapping[str, Callable[[], Predictor]],
        agent: str,
        seed: int | None = None,
    ) -> None:
        """Open the window for an `MMCReachEnv` that renders "rgb_array" and has no time limit.

        The `makers` make the agents, by name, when they are chosen; `agent` is the first.
        """
        self._env, self._reach = env, cast("MMCReachEnv", env.unwrapped)
        self._view = drawing.View(self._reach.setup.farthest)
        self._makers, self._agents = dict(makers), {agent: makers[agent]()}
        self.agent, self.message = agent, ""
        self.paused, self.running = False, True
        self._restart(seed=seed)
        self._open_window()

    def run(self) -> None:
        """Play until the user quits."""
        while self.running:
            self.frame()
            self._clock.tick(self._env.metadata["render_fps"])

    def frame(self) -> None:
        """Read keys and mouse, simulate one control step unless paused, and draw the state."""
        changed = [self._handle(event) for event in pygame.event.get()]
        if not self.paused:
            self._step()
        if any(changed) or not self.paused:
            self._show()

    def choose(self, agent: str) -> None:
        """Let another agent move the arm; if that fails, `message` says why."""
        try:
            if agent not in self._agents:
                self._agents[agent] = self._makers[agent]()
        except (ImportError, OSError, ValueError) as error:
            self.message = f"{agent}: {error}".splitlines()[0]
            return
        self.agent, self.message = agent, ""
        self._state = None

    def _restart(self, **arguments: Any) -> None:
        self._observation, info = self._env.reset(**arguments)
        self._see(info)
        self._state, self._hand_speed = None, 0.0

    def _see(self, info: Mapping[str, Any]) -> None:
        self.target, self._hand = tuple(info["target"].tolist()), info["end_effector"]
        self._seen_hand = info.get("cursor", self._hand)

    def _step(self) -> None:
        start = np.full(1, self._state is None)
        action, self._state = self._agents[self.agent].predict(
            self._observation, self._state, start, deterministic=True
        )
        hand = self._hand
        self._observation, _, _, _, info = self._env.step(action)
        self._see(info)
        self._hand_speed = math.dist(hand, self._hand) / self._reach.parameters.control_step

    def _handle(self, event: pygame.event.Event) -> bool:
        """Handle an event; return whether it may change the picture."""
        if event.type == pygame.QUIT:
            self.running = False
        elif event.type == pygame.KEYDOWN:
            self._handle_key(event.key)
        elif event.type == pygame.MOUSEMOTION:
            self._move_target(self._view.point(event.pos))
        else:
            return False
        return True

    def _move_target(self, point: tuple[float, float]) -> None:
        """Move the target to the point in reach nearest to `point`, unless an obstacle is there."""
        workspace = self._reach.setup.workspace
        nearest = workspace.nearest(point)
        if workspace.contains(nearest):
            self.target = nearest
            self._reach.set_target(nearest)

    def _handle_key(self, key: int) -> None:
        names = list(self._makers)
        if key in (pygame.K_ESCAPE, pygame.K_q):
            self.running = False
        elif key == pygame.K_SPACE:
            self.paused = not self.paused
        elif key == pygame.K_r:
            self._restart(options={"target": self.target})
        elif key == pygame.K_TAB:
            self.choose(names[(names.index(self.agent) + 1) % len(names)])
        elif 0 <= key - pygame.K_1 < min(9, len(names)):
            self.choose(names[key - pygame.K_1])

    def _open_window(self) -> None:
        open_display()
        pygame.font.init()
        pygame.display.set_caption("mmc-gym play")
        size = self._view.size
        self._font = pygame.font.Font(None, _FONT_SIZE)
        self._text_top = size + self._agents_line().get_height() + _LINE // 2
        self._window = pygame.display.set_mode((size, self._text_top + 2 * _LINE))
        self._picture = self._window.subsurface((0, 0, size, size))
        self._clock = pygame.time.Clock()

    def _show(self) -> None:
        picture: Any = self._env.render()
        self._window.fill(drawing.BACKGROUND)
        pygame.surfarray.blit_array(self._picture, picture.swapaxes(0, 1))
        self._window.blit(self._agents_line(), (_INDENT, self._view.size))
        lines = (self.message or self._measures(), drawing.OUTLINE), (HELP, drawing.TRACE)
        for number, (words, color) in enumerate(lines):
            text = self._font.render(words, True, color)
            self._window.blit(text, (_INDENT, self._text_top + number * _LINE))
        pygame.display.flip()

    def _measures(self) -> str:
        distance = math.dist(self._seen_hand, self.target)
        reached = "reached" if distance <= self._reach.success_distance else ""
        numbers = f"distance {distance:.2f}    hand speed {self._hand_speed:.1f}/s"
        return f"{self.agent}    {numbers}    {'paused' if self.paused else reached}"

    def _agents_line(self) -> pygame.Surface:
        """Return the names of all agents with their keys, the present one in brackets."""
        labels = []
        for number, name in enumerate(self._makers, start=1):
            label = f"{number}:{name}" if number <= 9 else name
            labels.append(f"[{label}]" if name == self.agent else f" {label} ")
        width = self._view.size - 2 * _INDENT
        return self._font.render("  ".join(labels), True, drawing.TRACE, None, width)
