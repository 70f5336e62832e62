"""Pictures of `MMCReachEnv`, frame by frame, as an array or in a window.

A picture is painted larger than it is shown and then averaged down, which smooths all edges.

Colour alone carries no meaning: the arm is the filled shape, the target the ring with a cross, with
a second ring when it is reached.  An internal model's arm is a thin line with hollow joints.  Dots,
or rings without a cross, show where the target will be.  A joint whose motor fails has a cross: its
action is a thin arc, by 90° if it is the largest, and what of it arrived is a thick arc within.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise, product
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
from numpy.typing import NDArray

from mmc_gym._errors import UserError
from mmc_gym.envs.arms import Arms
from mmc_gym.envs.cursor import Cursor
from mmc_gym.envs.motors import are_failing
from mmc_gym.envs.setup import Episode, ReachSetup
from mmc_gym.geometry import in_the_world, reachable_radii

Color = tuple[int, int, int]
Point = tuple[float, float]
Place = Sequence[float]  # (x, y), also a list or an array

SIZE = 640  # width and height of the picture in pixels; video encoders like multiples of 16
_OVERSAMPLING = 2
_HALF_WIDTH = 1.1  # of the picture, in reaches
_FONT_SIZE = 22  # of the caption

# Blue and vermilion of the Okabe-Ito palette: apart for every kind of colour vision.
BACKGROUND: Color = (246, 247, 249)
REACHABLE: Color = (255, 255, 255)
BORDER: Color = (205, 210, 218)
OUTLINE: Color = (22, 42, 66)
ROD: Color = (64, 132, 190)
BASE: Color = (120, 130, 144)
TRACE: Color = (92, 104, 122)
TARGET: Color = (213, 78, 0)
GHOST: Color = (0, 128, 96)
CURSOR: Color = (170, 60, 130)
FIELD: Color = (172, 180, 192)
SENSED: Color = (78, 93, 112)

BASE_WIDTH, HAND_WIDTH = 21.0, 8.0  # thickness of the arm at its ends


@dataclass(frozen=True)
class View:
    """The map from the world (x to the right, y up, the base in the middle) to a square picture."""

    reach: float  #: of the arm, segment lengths; the picture shows a little more
    size: int = SIZE  #: width and height of the picture, pixels

    @property
    def scale(self) -> float:
        """Pixels per segment length."""
        return self.size / (2 * _HALF_WIDTH * self.reach)

    def pixel(self, point: Place) -> Point:
        """Return the pixel of a point (x, y) of the world."""
        middle = self.size / 2
        return middle + point[0] * self.scale, middle - point[1] * self.scale

    def point(self, pixel: Place) -> Point:
        """Return the point (x, y) of the world at a pixel."""
        middle = self.size / 2
        return (pixel[0] - middle) / self.scale, (middle - pixel[1]) / self.scale

    def stroke(self, width: float) -> float:
        """Scale a width in pixels from a picture of `SIZE` to this one."""
        return width * self.size / SIZE


@dataclass(frozen=True)
class Canvas:
    """A surface of pygame on which the world is painted through a view.

    Points are in the world; widths and radii are in pixels of a picture of `SIZE`.
    """

    surface: pygame.Surface
    view: View

    def pixels(self, length: float) -> float:
        """Return a length of the world in pixels of a picture of `SIZE`."""
        return length * self.view.scale / self.view.stroke(1)

    def disc(self, color: Color, middle: Place, radius: float) -> None:
        """Paint a disc."""
        pixel, radius = self.view.pixel(middle), self.view.stroke(radius)
        pygame.draw.circle(self.surface, color, pixel, radius)

    def ring(self, color: Color, middle: Place, radius: float, width: float) -> None:
        """Paint a circle, with a line of this width centred on it."""
        pixel, outer = self.view.pixel(middle), self.view.stroke(radius + width / 2)
        line = max(1, round(self.view.stroke(width)))
        pygame.draw.circle(self.surface, color, pixel, outer, line)

    def square(self, color: Color, middle: Point, radius: float, turn: float = 0.0) -> None:
        """Paint a square on its corner, with half-diagonal `radius`, turned by `turn` radians."""
        (x, y), radius = self.view.pixel(middle), self.view.stroke(radius)
        angles = [turn + quarter * math.pi / 2 for quarter in range(4)]
        corners = [(x + radius * math.cos(a), y + radius * math.sin(a)) for a in angles]
        pygame.draw.polygon(self.surface, color, corners)

    def rod(self, color: Color, start: Place, end: Place, width: float, end_width: float) -> None:
        """Paint a tapering rod with round ends."""
        (x, y), (end_x, end_y) = self.view.pixel(start), self.view.pixel(end)
        length = math.hypot(end_x - x, end_y - y)
        if length > 0:
            half = self.view.stroke(0.5) / length
            across_x, across_y = (y - end_y) * half, (end_x - x) * half
            corners = [
                (x + width * across_x, y + width * across_y),
                (end_x + end_width * across_x, end_y + end_width * across_y),
                (end_x - end_width * across_x, end_y - end_width * across_y),
                (x - width * across_x, y - width * across_y),
            ]
            pygame.draw.polygon(self.surface, color, corners)
        self.disc(color, start, width / 2)
        self.disc(color, end, end_width / 2)

    def line(self, color: Color, points: Sequence[Place], width: float) -> None:
        """Paint a line through points."""
        for start, end in pairwise(points):
            self.rod(color, start, end, width, width)

    def edged_line(self, color: Color, points: Sequence[Place], width: float) -> None:
        """Paint a line with a light edge, which keeps it visible on the arm."""
        self.line(REACHABLE, points, width + 2.5)
        self.line(color, points, width)

    def hollow_diamond(self, color: Color, middle: Point, radius: float) -> None:
        """Paint a diamond with a light edge and a light middle."""
        for size, shade in ((radius + 2.5, REACHABLE), (radius, color), (radius / 2, REACHABLE)):
            self.square(shade, middle, size)


def _blend(start: Color, end: Color, share: float) -> Color:
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(start, end, strict=True))
    return red, green, blue


def _node_positions(segment_angles: Sequence[float], lengths: Sequence[float]) -> list[Point]:
    """Return base, joints and hand (N + 1 points) of an arm with these absolute angles."""
    nodes = [(0.0, 0.0)]
    for angle, length in zip(segment_angles, lengths, strict=True):
        x, y = nodes[-1]
        nodes.append((x + length * math.cos(angle), y + length * math.sin(angle)))
    return nodes


@dataclass(frozen=True)
class Scene:
    """The part of a picture that changes from frame to frame."""

    segment_angles: Sequence[float]  #: N absolute angles, radians
    target: Place  #: (x, y), segment lengths
    trace: Sequence[Point] = ()  #: position of the hand at each past control step, oldest first
    path: Sequence[Place] = ()  #: all places of the target; empty if it does not move
    ghost: Sequence[float] | None = None  #: N joint angles of an internal model, radians
    steps: int = 0  #: control steps since the reset
    cursor: Cursor | None = None  #: stands for the hand
    observation: Any = None  #: with noise and delay; drawn if the senses are disturbed
    arms: Arms | None = None  #: the present columns of the arm, (1, …); drawn if motors fail
    actions: Sequence[Any] = ()  #: as they were commanded, then as they arrived, each (N,)


class Renderer:
    """Paints an arm and its target, frame by frame, into an array or a window."""

    def __init__(
        self, setup: ReachSetup, episode: Episode, mode: str, size: tuple[int, int] = (SIZE, SIZE)
    ) -> None:
        """Make a renderer for one arm, whose world is a square in a picture of (width, height).

        In `mode` "human" it opens a window, and `draw` waits until the picture is due.
        """
        self._setup, self._episode = setup, episode
        self._lengths = episode.body.segment_lengths
        large = View(setup.limits.farthest, _OVERSAMPLING * min(size))
        self._canvas = Canvas(pygame.Surface((large.size,) * 2, depth=32), large)
        self._paint_scenery()
        self._scenery = self._canvas.surface.copy()
        self._picture = pygame.Surface(size, depth=32)
        self._picture.fill(BACKGROUND)
        side = min(size)
        corner = (size[0] - side) // 2, (size[1] - side) // 2
        self._world = self._picture.subsurface(corner, (side, side))
        self._window = Window(setup.frame_rate, size) if mode == "human" else None

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Return the picture, a new array (height, width, 3); None if a window shows it instead."""
        nodes = _node_positions(scene.segment_angles, self._lengths)
        self._canvas.surface.blit(self._scenery, (0, 0))
        self._paint_path(scene)
        self._paint_trace(scene)
        self._paint_arm(nodes)
        self._paint_changes(scene, nodes)
        if scene.observation is not None and self._setup.are_senses_disturbed:
            self._paint_sensed(scene.observation)
        self._paint_target(scene, nodes[-1])
        pygame.transform.smoothscale(self._canvas.surface, self._world.get_size(), self._world)
        if self._window is not None:
            self._window.show(self._picture)
            return None
        return np.ascontiguousarray(pygame.surfarray.pixels3d(self._picture).swapaxes(0, 1))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()

    def _paint_scenery(self) -> None:
        """Paint what is the same in every frame."""
        canvas, body, view = self._canvas, self._episode.body, self._canvas.view
        canvas.surface.fill(BACKGROUND)
        inner, outer = reachable_radii(self._lengths)
        for radius, color in ((outer, REACHABLE), (inner, BACKGROUND)):
            if radius > 0:
                canvas.disc(BORDER, (0, 0), canvas.pixels(radius) + 0.75)
                canvas.disc(color, (0, 0), canvas.pixels(radius) - 0.75)
        if body.force_field is not None:
            (_, right), (left, _) = body.force_field
            self._paint_curl_field(right - left)
        for obstacle in body.obstacles:
            middle, radius = obstacle[:2], canvas.pixels(obstacle[2])
            canvas.disc(BORDER, middle, radius)
            canvas.ring(OUTLINE, middle, radius, 4)
        if pull := math.hypot(*body.gravity):
            start, along = np.full(2, 0.85 * view.reach), np.array(body.gravity) / pull
            ways = [(start + share * view.reach * along).tolist() for share in (0, 0.15, 0.3)]
            canvas.line(TRACE, ways[:2], 4)
            canvas.rod(TRACE, ways[1], ways[2], 18, 0)
        canvas.square(OUTLINE, (0, 0), 31, math.pi / 4)  # the plate under the arm
        canvas.square(BASE, (0, 0), 28, math.pi / 4)
        pygame.font.init()
        font = pygame.font.Font(None, round(view.stroke(_FONT_SIZE)))
        corner = (view.stroke(12), view.stroke(10))
        canvas.surface.blit(font.render(self._setup.caption, True, TRACE), corner)

    def _paint_curl_field(self, curl: float) -> None:
        """Paint arrows that turn as the field bends movements, clockwise if `curl` is positive."""
        canvas, reach, sense = self._canvas, self._canvas.view.reach, -math.copysign(1, curl)
        turns = [sense * step / 12 * 1.4 * math.pi for step in range(13)]
        for row, column in product(range(-3, 4), repeat=2):
            x, y = column * reach / 3, row * reach / 3
            if 0 < math.hypot(x, y) < 0.95 * reach:
                radius = 0.045 * reach
                arc = [(x + radius * math.cos(a), y + radius * math.sin(a)) for a in turns]
                canvas.line(FIELD, arc, 2)
                canvas.rod(FIELD, arc[-3], arc[-1], 12, 0)  # the head of the arrow

    def _paint_path(self, scene: Scene) -> None:
        """Paint where a moving target will be: dots, or faint rings joined by a thin line."""
        canvas = self._canvas
        places = [tuple(place) for place in scene.path]
        if len(set(places)) <= 1:
            return
        if self._setup.task.periodic:
            for place in places[:: max(1, len(places) // 160)]:
                canvas.disc(_blend(BACKGROUND, TARGET, 0.45), place, 2)
            return
        color = _blend(BACKGROUND, TARGET, 0.55)
        now = max(index for index, place in enumerate(places) if place == tuple(scene.target))
        canvas.line(color, places[now:], 1.5)
        for place in places[now + 1 :]:
            canvas.disc(REACHABLE, place, self._target_radius + 3)
            canvas.ring(color, place, self._target_radius + 3, 2)

    @property
    def _target_radius(self) -> float:
        return max(self._canvas.pixels(self._setup.success_distance), 3)

    def _paint_trace(self, scene: Scene) -> None:
        for age, (start, end) in enumerate(pairwise(scene.trace), start=1):
            freshness = age / len(scene.trace)
            color = _blend(REACHABLE, TRACE, 0.2 + 0.8 * freshness)
            self._canvas.line(color, (start, end), 0.8 + 1.4 * freshness)
            self._canvas.disc(color, end, 1.5 + 1.8 * freshness)

    def _paint_arm(self, nodes: Sequence[Point]) -> None:
        canvas, along = self._canvas, [0.0, *accumulate(self._lengths)]
        taper = (HAND_WIDTH - BASE_WIDTH) / along[-1]
        widths = [BASE_WIDTH + taper * way for way in along]
        # From the hand to the base: the thicker rod lies on top at every joint.
        rods = list(zip(pairwise(nodes), pairwise(widths), strict=True))
        for (start, end), (width, end_width) in reversed(rods):
            canvas.rod(OUTLINE, start, end, width + 4, end_width + 4)
            canvas.rod(ROD, start, end, width, end_width)
        for node, width in zip(nodes[:-1], widths, strict=False):
            canvas.disc(OUTLINE, node, 0.36 * width + 2)
            canvas.disc(REACHABLE, node, 0.36 * width)
        canvas.disc(OUTLINE, nodes[-1], HAND_WIDTH / 2 + 2)

    def _paint_changes(self, scene: Scene, nodes: Sequence[Point]) -> None:
        """Paint former lengths, a mass at the hand, an internal model's arm, and locks."""
        canvas, setup, body = self._canvas, self._setup, self._episode.body
        old_lengths = setup.unperturbed.segment_lengths
        changes = zip(nodes, scene.segment_angles, self._lengths, old_lengths, strict=False)
        for start, angle, length, old in changes:
            if length != old:  # a line along the segment, and a bar across its former end
                along_x, along_y = math.cos(angle), math.sin(angle)
                x, y = start[0] + old * along_x, start[1] + old * along_y
                half = 18 / canvas.pixels(1)
                across_x, across_y = half * along_y, -half * along_x
                canvas.edged_line(OUTLINE, (start, (x, y)), 2)
                ends = (x - across_x, y - across_y), (x + across_x, y + across_y)
                canvas.edged_line(OUTLINE, ends, 2)
        if body.hand_mass:
            radius = 9 * body.hand_mass ** (1 / 3)  # of a ball whose volume grows with the mass
            canvas.disc(REACHABLE, nodes[-1], radius + 2.5)
            canvas.disc(OUTLINE, nodes[-1], radius)
        if scene.ghost is not None:
            lengths = setup.given_body.segment_lengths
            ghost = _node_positions(list(accumulate(scene.ghost)), lengths)
            canvas.edged_line(GHOST, ghost, 2.5)
            for node in ghost[1:]:
                canvas.disc(GHOST, node, 5.5)
                canvas.disc(REACHABLE, node, 3)
        for joint in np.flatnonzero(are_failing(scene.arms)).tolist() if scene.arms else ():
            self._paint_motor(joint, nodes[joint], scene)
        first, free = self._episode.lock_step, self._episode.unlock_step
        is_locked = 0 <= first <= scene.steps and not 0 <= free <= scene.steps
        for joint in body.lockable_joints if is_locked else ():
            canvas.square(REACHABLE, nodes[joint], 18, math.pi / 4)
            canvas.square(OUTLINE, nodes[joint], 15, math.pi / 4)
            canvas.disc(REACHABLE, nodes[joint], 3)  # the keyhole

    def _paint_motor(self, joint: int, node: Point, scene: Scene) -> None:
        """Paint a cross on a joint whose motor fails, and arcs from its segment by its actions."""
        canvas, shapes = self._canvas, zip((42, 33), (2, 5), scene.actions, strict=False)
        for radius, width, actions in shapes:
            turns = scene.segment_angles[joint] + np.linspace(0, actions[joint], 13) * math.pi / 2
            along = np.stack((np.cos(turns), np.sin(turns)), axis=-1)
            arc = (node + along * radius / canvas.pixels(1)).tolist()
            canvas.edged_line(OUTLINE, arc if actions[joint] else [], width)
        canvas.disc(OUTLINE, node, 12)
        canvas.disc(REACHABLE, node, 9.5)
        half = 6 / canvas.pixels(1)
        for up in (half, -half):
            ends = (node[0] - half, node[1] - up), (node[0] + half, node[1] + up)
            canvas.line(OUTLINE, ends, 3)

    def _paint_sensed(self, observation: NDArray[np.float32]) -> None:
        """Paint arm, hand and target as the agent observes them."""
        setup = self._setup
        seen = setup.layout.split(observation.astype(float))
        joint_angles = np.arctan2(seen.sines, seen.cosines)
        lengths = setup.given_body.segment_lengths
        nodes = _node_positions(np.cumsum(joint_angles).tolist(), lengths)
        self._canvas.edged_line(SENSED, nodes, 2)
        hand = seen.target - seen.offset
        hand_and_target = np.stack((hand, seen.target))  # in the frame of the first segment
        for x, y in in_the_world(hand_and_target, joint_angles).tolist():
            self._canvas.hollow_diamond(SENSED, (x, y), 8)

    def _paint_target(self, scene: Scene, hand: Point) -> None:
        """Paint cursor and target: a ring of the success radius, and a second when reached."""
        canvas, setup, (x, y) = self._canvas, self._setup, scene.target
        cursor = hand if scene.cursor is None else scene.cursor.at(*hand, (x, y))
        if scene.cursor is not None:
            canvas.line(CURSOR, (hand, cursor), 1.8)
            canvas.hollow_diamond(CURSOR, cursor, 9.5)
        is_reached = math.dist(cursor, scene.target) <= setup.success_distance
        radius = self._target_radius
        gap, tick = ((radius + more) / canvas.pixels(1) for more in (3, 14))
        # A light edge around everything keeps the target visible on the arm.
        for color, width in ((REACHABLE, 4.5), (TARGET, 2.5)):
            for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1)):
                ends = (x + gap * dx, y + gap * dy), (x + tick * dx, y + tick * dy)
                canvas.line(color, ends, width)
            for ring in (radius, radius + 8.5)[: 1 + is_reached]:
                canvas.ring(color, scene.target, ring, width)


def open_display(*, must_be_seen: bool = False) -> None:
    """Open the display for a window; raise a `UserError` if SDL cannot.

    With `must_be_seen`, a driver without a screen is refused, unless SDL_VIDEODRIVER is set.
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

    def __init__(self, frame_rate: int, size: tuple[int, int] = (SIZE, SIZE)) -> None:
        open_display()
        pygame.display.set_caption("mmc-gym")
        self._surface = pygame.display.set_mode(size)
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
