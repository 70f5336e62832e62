"""Pictures of `MMCReachEnv`, frame by frame, as an array or in a window.

A picture is painted larger than it is shown and then averaged down, which smooths all edges.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
from numpy.typing import NDArray

from mmc_gym._errors import UserError
from mmc_gym.envs import shapes
from mmc_gym.envs.shapes import SIZE, Canvas, Point, View
from mmc_gym.envs.spec import ReachSetup
from mmc_gym.interface import in_the_world

_OVERSAMPLING = 2


@dataclass(frozen=True)
class Scene:
    """The part of a picture that changes from frame to frame."""

    segment_angles: Sequence[float]  #: N absolute angles, radians
    target: Sequence[float]  #: (x, y), segment lengths
    trace: Sequence[Point] = ()  #: position of the hand at each past control step, oldest first
    path: Sequence[Sequence[float]] = ()  #: all places of the target; empty if it stands still
    ghost: Sequence[float] | None = None  #: N joint angles of an internal model, radians
    steps: int = 0  #: control steps since the reset
    observation: Any = None  #: the last one; it is drawn if the senses are disturbed


class Renderer:
    """Paints an arm and its target, frame by frame, into an array or a window."""

    def __init__(self, setup: ReachSetup, mode: str) -> None:
        """Make a renderer for one arm.

        In `mode` "human" it opens a window, and `draw` waits until the picture is due.
        """
        self._setup = setup
        self._lengths = setup.body.segment_lengths
        self._old_lengths = setup.unperturbed.segment_lengths
        large = View(setup.farthest, _OVERSAMPLING * SIZE)
        self._canvas = Canvas(pygame.Surface((large.size,) * 2, depth=32), large)
        self._scenery = Canvas(self._canvas.surface.copy(), large)
        self._picture = pygame.Surface((SIZE, SIZE), depth=32)
        self._paint_scenery()
        self._window = Window(setup.frame_rate) if mode == "human" else None

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Return a picture (height, width, 3), a new array; None if it is shown in a window."""
        nodes = shapes.node_positions(scene.segment_angles, self._lengths)
        self._canvas.surface.blit(self._scenery.surface, (0, 0))
        self._paint_path(scene)
        self._canvas.draw_trace(scene.trace)
        self._paint_arm(scene, nodes)
        if scene.observation is not None and self._setup.are_senses_disturbed:
            self._paint_sensed(scene.observation)
        self._paint_target(scene, nodes[-1])
        pygame.transform.smoothscale(self._canvas.surface, (SIZE, SIZE), self._picture)
        if self._window is not None:
            self._window.show(self._picture)
            return None
        return np.ascontiguousarray(pygame.surfarray.pixels3d(self._picture).swapaxes(0, 1))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()

    def _paint_scenery(self) -> None:
        """Paint the parts that are the same in every frame."""
        canvas, body = self._scenery, self._setup.body
        canvas.surface.fill(shapes.BACKGROUND)
        canvas.draw_reachable_set(self._lengths)
        if body.force_field is not None:
            (_, right), (left, _) = body.force_field
            canvas.draw_curl_field(right - left)
        for obstacle in body.obstacles:
            middle, radius = obstacle[:2], canvas.pixels(obstacle[2])
            canvas.disc(shapes.BORDER, middle, radius)
            canvas.ring(shapes.OUTLINE, middle, radius, 4)
        if pull := math.hypot(*body.gravity):
            start, along = np.full(2, 0.85 * canvas.view.reach), np.array(body.gravity) / pull
            ways = [
                (start + share * canvas.view.reach * along).tolist() for share in (0, 0.15, 0.3)
            ]
            canvas.line(shapes.TRACE, ways[:2], 4)
            canvas.rod(shapes.TRACE, ways[1], ways[2], 18, 0)
        canvas.square(shapes.OUTLINE, (0, 0), 31, math.pi / 4)  # the plate under the arm
        canvas.square(shapes.BASE, (0, 0), 28, math.pi / 4)
        canvas.draw_caption(self._setup.caption)

    def _paint_path(self, scene: Scene) -> None:
        """Paint the places where a moving target will be."""
        canvas, setup = self._canvas, self._setup
        target, places = tuple(scene.target), [tuple(place) for place in scene.path]
        if len(set(places)) <= 1:
            return
        if setup.task.periodic:
            color = shapes.blend(shapes.BACKGROUND, shapes.TARGET, 0.45)
            for place in places[:: max(1, len(places) // 160)]:
                canvas.disc(color, place, 2)
            return
        last = len(places) - 1 - places[::-1].index(target)
        canvas.draw_next_targets(target, places[last + 1 :], setup.success_distance)

    def _paint_arm(self, scene: Scene, nodes: Sequence[Point]) -> None:
        canvas, body = self._canvas, self._setup.body
        canvas.draw_arm(scene.segment_angles, self._lengths)
        changes = zip(nodes, scene.segment_angles, self._lengths, self._old_lengths, strict=False)
        for start, angle, length, old in changes:
            if length != old:
                canvas.draw_old_length(start, angle, old)
        if body.hand_mass:
            radius = 9 * body.hand_mass ** (1 / 3)  # of a ball whose volume grows with the mass
            canvas.disc(shapes.REACHABLE, nodes[-1], radius + 2.5)
            canvas.disc(shapes.OUTLINE, nodes[-1], radius)
        if scene.ghost is not None:
            canvas.draw_ghost(scene.ghost, self._setup.given_body.segment_lengths)
        lock_step = self._setup.lock_step
        is_locked = lock_step is not None and scene.steps >= lock_step
        for joint in body.lockable_joints if is_locked else ():
            canvas.draw_lock(nodes[joint])

    def _paint_target(self, scene: Scene, hand: Point) -> None:
        canvas, setup, (x, y) = self._canvas, self._setup, scene.target
        cursor = hand if setup.cursor is None else setup.cursor.cursor(*hand, (x, y))
        if setup.cursor is not None:
            canvas.line(shapes.CURSOR, (hand, cursor), 1.8)
            canvas.hollow_diamond(shapes.CURSOR, cursor, 9.5)
        is_reached = math.dist(cursor, scene.target) <= setup.success_distance
        canvas.draw_target(scene.target, setup.success_distance, is_reached)

    def _paint_sensed(self, observation: NDArray[np.float32]) -> None:
        """Paint arm, hand and target where an observation of `MMCReach-v0` shows them."""
        setup = self._setup
        seen = setup.layout.split(observation.astype(float))
        relative = np.arctan2(seen.sines, seen.cosines)
        lengths = setup.given_body.segment_lengths
        nodes = shapes.node_positions(np.cumsum(relative).tolist(), lengths)
        points = np.stack((seen.target - seen.offset, seen.target))
        self._canvas.edged_line(shapes.SENSED, nodes, 2)
        for x, y in in_the_world(points, relative).tolist():
            self._canvas.hollow_diamond(shapes.SENSED, (x, y), 8)


def open_display(*, must_be_seen: bool = False) -> None:
    """Open the display for a window; raise a `UserError` if SDL cannot.

    If it `must_be_seen`, a driver without a screen is refused, unless SDL_VIDEODRIVER names it.
    """
    reason = "SDL finds no screen"
    try:
        pygame.display.init()
        is_seen = pygame.display.get_driver() not in ("offscreen", "dummy")
        if is_seen or not must_be_seen or os.environ.get("SDL_VIDEODRIVER"):
            return
        pygame.display.quit()
    except pygame.error as error:
        reason = str(error)
    raise UserError(
        f"a window needs a display, and there is none: {reason}. Without one, `mmc-gym record "
        '--agents mmc` makes a film, and render_mode="rgb_array" gives pictures'
    )


class Window:
    """A window that shows pictures at a steady rate until its user closes it."""

    def __init__(self, frame_rate: int) -> None:
        """Open the window; it shows at most `frame_rate` pictures a second."""
        open_display()
        pygame.display.set_caption("mmc-gym")
        self._surface = pygame.display.set_mode((SIZE, SIZE))
        self._frame_rate = frame_rate
        self._clock = pygame.time.Clock()
        self._is_open = True

    def show(self, picture: pygame.Surface) -> None:
        """Show a picture when it is due; do nothing once the window is closed."""
        if not self._is_open:
            return
        if not pygame.display.get_init() or pygame.event.get(pygame.QUIT):
            self.close()
            gym.logger.warn("the window was closed: the environment continues without it")
            return
        # Keys are left for the caller; motion would fill the queue, and then no QUIT gets in.
        pygame.event.clear(pygame.MOUSEMOTION)
        self._surface.blit(picture, (0, 0))
        pygame.display.flip()
        self._clock.tick(self._frame_rate)

    def close(self) -> None:
        """Close the window."""
        if self._is_open:
            pygame.display.quit()
        self._is_open = False
