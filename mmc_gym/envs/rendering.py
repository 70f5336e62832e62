"""Pictures of `MMCReachEnv`, frame by frame: into an array, or into a window.

A picture is painted larger than it is shown and then averaged down, which smooths all edges.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import gymnasium as gym
import numpy as np
import pygame
from numpy.typing import NDArray

from mmc_gym.envs import drawing
from mmc_gym.envs.drawing import SIZE, View
from mmc_gym.envs.setup import ReachSetup

TRACE_SECONDS = 1.0
_OVERSAMPLING = 2


class Renderer:
    """Paints an arm and its target, frame by frame, into an array or a window.

    Attributes:
        view: maps the world to the picture.
    """

    def __init__(self, setup: ReachSetup, mode: str, fps: int) -> None:
        """Make a renderer for one arm.

        Args:
            setup: of its environment.
            mode: "rgb_array", for which no display is touched, or "human", which opens a window.
            fps: frames per second; `draw` waits for its turn if there is a window.
        """
        self.view = View(setup.farthest)
        self._segment_lengths = setup.body.segment_lengths
        self._success_distance = setup.success_distance
        self._trace: deque[drawing.Point] = deque(maxlen=max(2, round(TRACE_SECONDS * fps)))
        self._large_view = View(self.view.reach, _OVERSAMPLING * SIZE)
        self._canvas = pygame.Surface((self._large_view.size,) * 2, depth=32)
        self._picture = pygame.Surface((SIZE, SIZE), depth=32)
        self._scenery = self._canvas.copy()
        self._scenery.fill(drawing.BACKGROUND)
        drawing.draw_reachable_set(self._scenery, self._large_view, self._segment_lengths)
        drawing.draw_base(self._scenery, self._large_view)
        self._window = Window((SIZE, SIZE), "mmc-gym", fps) if mode == "human" else None

    def draw(
        self,
        segment_angles: Sequence[float],
        target: Sequence[float],
        ghost: Sequence[float] | None = None,
    ) -> NDArray[np.uint8] | None:
        """Paint one frame.

        Args:
            segment_angles: N absolute angles, radians.
            target: (x, y), segment lengths.
            ghost: N joint angles of a second arm to show, radians.

        Returns:
            The picture (height, width, 3) in a new array, or None if it is shown in a window.
        """
        canvas, view = self._canvas, self._large_view
        hand = drawing.node_positions(segment_angles, self._segment_lengths)[-1]
        self._trace.append(hand)
        canvas.blit(self._scenery, (0, 0))
        drawing.draw_trace(canvas, view, self._trace)
        drawing.draw_arm(canvas, view, segment_angles, self._segment_lengths)
        reached = math.dist(hand, target) <= self._success_distance
        drawing.draw_target(canvas, view, target, self._success_distance, reached)
        pygame.transform.smoothscale(canvas, (SIZE, SIZE), self._picture)
        if self._window is not None:
            self._window.show(self._picture)
            return None
        return np.ascontiguousarray(pygame.surfarray.pixels3d(self._picture).swapaxes(0, 1))

    def clear_trace(self) -> None:
        """Forget where the hand has been."""
        self._trace.clear()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()


class Window:
    """A window that shows pictures at a steady rate, until its user closes it."""

    def __init__(self, size: tuple[int, int], title: str, fps: int) -> None:
        """Open the window."""
        pygame.display.init()
        pygame.display.set_caption(title)
        self.surface = pygame.display.set_mode(size)
        self._fps = fps
        self._clock = pygame.time.Clock()
        self.is_open = True

    def show(self, picture: pygame.Surface) -> None:
        """Show a picture and wait for its turn; nothing happens once the window is closed."""
        if not self.is_open:
            return
        if not pygame.display.get_init() or pygame.event.get(pygame.QUIT):
            self.close()
            gym.logger.warn("the window was closed: the environment runs on, unseen")
            return
        # Keys are left for the caller; motion would fill the queue, and then no QUIT gets in.
        pygame.event.clear(pygame.MOUSEMOTION)
        self.surface.blit(picture, (0, 0))
        pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window."""
        if self.is_open:
            pygame.display.quit()
        self.is_open = False
