"""Shapes of the pictures: a `View` maps the world to pixels, and a `Canvas` paints on them.

Colour alone carries no meaning: the arm is the filled shape, the target the ring with a cross, with
a second ring when it is reached.  An internal model's arm is a thin line with hollow joints.  Dots,
or rings without a cross, show where the target will be.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise, product

import pygame

from mmc_gym.network.chain import reachable_radii

Color = tuple[int, int, int]
Point = tuple[float, float]
Place = Sequence[float]  # (x, y), also a list or an array

SIZE = 640  # width and height of the picture in pixels; video encoders like multiples of 16
_MARGIN = 1.1  # half the picture's width, in reaches
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
        return self.size / (2 * _MARGIN * self.reach)

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


def blend(start: Color, end: Color, share: float) -> Color:
    """Return the colour at a share of the way between two."""
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(start, end, strict=True))
    return red, green, blue


def node_positions(
    segment_angles: Sequence[float], segment_lengths: Sequence[float]
) -> list[Point]:
    """Return base, joints and hand (N + 1 points) of an arm with these absolute angles."""
    nodes = [(0.0, 0.0)]
    for angle, length in zip(segment_angles, segment_lengths, strict=True):
        x, y = nodes[-1]
        nodes.append((x + length * math.cos(angle), y + length * math.sin(angle)))
    return nodes


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
        """Paint a circle; the line is centred on it."""
        pixel, outer = self.view.pixel(middle), self.view.stroke(radius + width / 2)
        line = max(1, round(self.view.stroke(width)))
        pygame.draw.circle(self.surface, color, pixel, outer, line)

    def square(self, color: Color, middle: Point, radius: float, turn: float = 0.0) -> None:
        """Paint a square on its corner, `radius` from the middle to each; `turn` is in radians."""
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

    def draw_caption(self, words: str) -> None:
        """Write a line into the upper left corner."""
        pygame.font.init()
        font = pygame.font.Font(None, round(self.view.stroke(_FONT_SIZE)))
        corner = (self.view.stroke(12), self.view.stroke(10))
        self.surface.blit(font.render(words, True, TRACE), corner)

    def draw_reachable_set(self, segment_lengths: Sequence[float]) -> None:
        """Paint the reachable set: a faint disc, or a ring if the segments are unequal."""
        inner, outer = reachable_radii(segment_lengths)
        for radius, color in ((outer, REACHABLE), (inner, BACKGROUND)):
            if radius > 0:
                self.disc(BORDER, (0, 0), self.pixels(radius) + 0.75)
                self.disc(color, (0, 0), self.pixels(radius) - 0.75)

    def draw_arm(self, segment_angles: Sequence[float], segment_lengths: Sequence[float]) -> None:
        """Paint an arm of N segments (absolute angles) as tapering rods on round joints."""
        nodes = node_positions(segment_angles, segment_lengths)
        along = [0.0, *accumulate(segment_lengths)]
        taper = (HAND_WIDTH - BASE_WIDTH) / along[-1]
        widths = [BASE_WIDTH + taper * way for way in along]
        # From the hand to the base: the thicker rod lies on top at every joint.
        rods = list(zip(pairwise(nodes), pairwise(widths), strict=True))
        for (start, end), (width, end_width) in reversed(rods):
            self.rod(OUTLINE, start, end, width + 4, end_width + 4)
            self.rod(ROD, start, end, width, end_width)
        for node, width in zip(nodes[:-1], widths, strict=False):
            self.disc(OUTLINE, node, 0.36 * width + 2)
            self.disc(REACHABLE, node, 0.36 * width)
        self.disc(OUTLINE, nodes[-1], HAND_WIDTH / 2 + 2)

    def draw_ghost(self, joint_angles: Sequence[float], segment_lengths: Sequence[float]) -> None:
        """Paint an internal model's arm (N joint angles) as a thin line with hollow joints."""
        nodes = node_positions(list(accumulate(joint_angles)), segment_lengths)
        self.edged_line(GHOST, nodes, 2.5)
        for node in nodes[1:]:
            self.disc(GHOST, node, 5.5)
            self.disc(REACHABLE, node, 3)

    def draw_trace(self, points: Iterable[Place]) -> None:
        """Paint the past points of the hand, oldest first, as dots that fade with age."""
        points = list(points)
        for age, (start, end) in enumerate(pairwise(points), start=1):
            freshness = age / len(points)
            color = blend(REACHABLE, TRACE, 0.2 + 0.8 * freshness)
            self.line(color, (start, end), 0.8 + 1.4 * freshness)
            self.disc(color, end, 1.5 + 1.8 * freshness)

    def draw_target(self, target: Place, success_distance: float, reached: bool) -> None:
        """Paint the target: a ring of the success radius on a cross, and a second when reached."""
        x, y = target
        radius = self._target_radius(success_distance)
        gap, tick = ((radius + more) / self.pixels(1) for more in (3, 14))
        # A light edge around everything keeps the target visible on the arm.
        for color, width in ((REACHABLE, 4.5), (TARGET, 2.5)):
            for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1)):
                ends = (x + gap * dx, y + gap * dy), (x + tick * dx, y + tick * dy)
                self.line(color, ends, width)
            for ring in (radius, radius + 8.5)[: 1 + reached]:
                self.ring(color, target, ring, width)

    def _target_radius(self, success_distance: float) -> float:
        return max(self.pixels(success_distance), 3)

    def draw_next_targets(
        self, target: Place, points: Sequence[Place], success_distance: float
    ) -> None:
        """Paint the next targets as faint rings, joined in order by a thin line."""
        color, radius = blend(BACKGROUND, TARGET, 0.55), self._target_radius(success_distance) + 3
        self.line(color, (target, *points), 1.5)
        for point in points:
            self.disc(REACHABLE, point, radius)
            self.ring(color, point, radius, 2)

    def draw_curl_field(self, curl: float) -> None:
        """Paint arrows that turn as the field bends movements, clockwise if `curl` is positive."""
        reach, sense = self.view.reach, -math.copysign(1, curl)
        turns = [sense * step / 12 * 1.4 * math.pi for step in range(13)]
        for row, column in product(range(-3, 4), repeat=2):
            x, y = column * reach / 3, row * reach / 3
            if 0 < math.hypot(x, y) < 0.95 * reach:
                radius = 0.045 * reach
                arc = [(x + radius * math.cos(a), y + radius * math.sin(a)) for a in turns]
                self.line(FIELD, arc, 2)
                self.rod(FIELD, arc[-3], arc[-1], 12, 0)  # the head of the arrow

    def draw_lock(self, joint: Point) -> None:
        """Paint a lock on a joint: a dark square with a light keyhole."""
        for color, radius in ((REACHABLE, 18), (OUTLINE, 15)):
            self.square(color, joint, radius, math.pi / 4)
        self.disc(REACHABLE, joint, 3)

    def draw_old_length(self, start: Point, angle: float, length: float) -> None:
        """Paint the former length of a segment: a line along it, and a bar across its end."""
        along_x, along_y = math.cos(angle), math.sin(angle)
        x, y = start[0] + length * along_x, start[1] + length * along_y
        half = 18 / self.pixels(1)
        bar = (x - half * along_y, y + half * along_x), (x + half * along_y, y - half * along_x)
        self.edged_line(OUTLINE, (start, (x, y)), 2)
        self.edged_line(OUTLINE, bar, 2)
