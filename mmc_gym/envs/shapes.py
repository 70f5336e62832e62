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

import numpy as np
import pygame

from mmc_gym.network.chain import reachable_radii

Color = tuple[int, int, int]
Point = tuple[float, float]

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

BASE_WIDTH, HAND_WIDTH = 21.0, 8.0  # thickness of the arm at its ends


@dataclass(frozen=True)
class View:
    """The map from the world (x to the right, y up, the base in the middle) to a square picture.

    Attributes:
        reach: of the arm, segment lengths; the picture shows a little more.
        size: width and height of the picture, pixels.
    """

    reach: float
    size: int = SIZE

    @property
    def scale(self) -> float:
        """Pixels per segment length."""
        return self.size / (2 * _MARGIN * self.reach)

    def pixel(self, point: Sequence[float]) -> Point:
        """Return the pixel of a point (x, y) of the world."""
        middle = self.size / 2
        return middle + point[0] * self.scale, middle - point[1] * self.scale

    def point(self, pixel: Sequence[float]) -> Point:
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


def rod_outline(start: Point, end: Point, half_width: float) -> list[Point]:
    """Return the outline of a rod with round ends, closed."""
    along = math.atan2(end[1] - start[1], end[0] - start[0])
    turns = [step / 12 * math.pi for step in range(13)]
    outline = [
        (x + half_width * math.cos(angle), y + half_width * math.sin(angle))
        for (x, y), first in ((end, along - math.pi / 2), (start, along + math.pi / 2))
        for angle in (first + turn for turn in turns)
    ]
    return [*outline, outline[0]]


@dataclass(frozen=True)
class Canvas:
    """A surface of pygame on which the world is painted through a view."""

    surface: pygame.Surface
    view: View

    def rod(
        self, color: Color, start: Point, end: Point, width: float, end_width: float | None = None
    ) -> None:
        """Paint a tapering rod with round ends; widths in pixels."""
        end_width = width if end_width is None else end_width
        along_x, along_y = end[0] - start[0], end[1] - start[1]
        length = math.hypot(along_x, along_y)
        if length > 0:
            across_x, across_y = -along_y / length / 2, along_x / length / 2
            wide = ((start, width), (end, end_width), (end, -end_width), (start, -width))
            corners = [(x + across * across_x, y + across * across_y) for (x, y), across in wide]
            pygame.draw.polygon(self.surface, color, corners)
        self.disc(color, start, width / 2)
        self.disc(color, end, end_width / 2)

    def disc(self, color: Color, middle: Point, radius: float) -> None:
        """Paint a disc; radius in pixels."""
        pygame.draw.circle(self.surface, color, middle, radius)

    def ring(self, color: Color, middle: Point, radius: float, width: float) -> None:
        """Paint a circle; radius, and width of the line centred on it, in pixels."""
        pygame.draw.circle(self.surface, color, middle, radius + width / 2, max(1, round(width)))

    def dashes(self, color: Color, corners: Sequence[Point], width: float, dash: float) -> None:
        """Paint a line through corners, in dashes and gaps of one length along the line."""
        width, dash = self.view.stroke(width), self.view.stroke(dash)
        ways = [0.0, *accumulate(math.dist(start, end) for start, end in pairwise(corners))]
        xs, ys = zip(*corners, strict=True)

        def at(way: float) -> Point:
            return float(np.interp(way, ways, xs)), float(np.interp(way, ways, ys))

        for number in range(math.ceil(ways[-1] / (2 * dash))):
            start, end = 2 * number * dash, min((2 * number + 1) * dash, ways[-1])
            stops = [start, *(way for way in ways if start < way < end), end]
            for one, other in pairwise(stops):
                self.rod(color, at(one), at(other), width)

    def diamond(self, color: Color, middle: Point, half: float) -> None:
        """Paint a square on its corner, `half` from the middle to each corner."""
        (x, y), half = middle, self.view.stroke(half)
        corners = [(x - half, y), (x, y - half), (x + half, y), (x, y + half)]
        pygame.draw.polygon(self.surface, color, corners)

    def draw_caption(self, words: str) -> None:
        """Write a line into the upper left corner."""
        pygame.font.init()
        font = pygame.font.Font(None, round(self.view.stroke(_FONT_SIZE)))
        corner = (self.view.stroke(12), self.view.stroke(10))
        self.surface.blit(font.render(words, True, TRACE), corner)

    def draw_reachable_set(self, segment_lengths: Sequence[float]) -> None:
        """Paint the reachable set: a faint disc, or a ring if the segments are unequal."""
        inner, outer = reachable_radii(segment_lengths)
        line, middle = self.view.stroke(1.5), self.view.pixel((0, 0))
        for radius, color in ((outer, REACHABLE), (inner, BACKGROUND)):
            if radius > 0:
                pixels = radius * self.view.scale
                self.disc(BORDER, middle, pixels + line / 2)
                self.disc(color, middle, pixels - line / 2)

    def draw_base(self) -> None:
        """Paint the plate under the arm with its four bolts."""
        stroke = self.view.stroke
        half, corner, bolt = stroke(22), stroke(15), stroke(2.5)
        x, y = self.view.pixel((0, 0))
        for inset, color in ((0.0, OUTLINE), (stroke(2), BASE)):
            side = 2 * (half - inset)
            self._plate(color, (x, y), side, side, round(stroke(7) - inset / 2))
        for sign_x, sign_y in product((-1, 1), repeat=2):
            self.disc(OUTLINE, (x + sign_x * corner, y + sign_y * corner), bolt)

    def _plate(
        self, color: Color, middle: Point, width: float, height: float, rounding: int
    ) -> None:
        plate = pygame.Rect(0, 0, round(width), round(height))
        plate.center = round(middle[0]), round(middle[1])
        pygame.draw.rect(self.surface, color, plate, border_radius=rounding)

    def draw_arm(self, segment_angles: Sequence[float], segment_lengths: Sequence[float]) -> None:
        """Paint an arm of N segments (absolute angles) as tapering rods on round joints."""
        nodes = node_positions(segment_angles, segment_lengths)
        pixels = [self.view.pixel(node) for node in nodes]
        widths = self.arm_widths(segment_lengths)
        edge = self.view.stroke(2)
        # From the hand to the base: the thicker rod lies on top at every joint.
        rods = list(zip(pairwise(pixels), pairwise(widths), strict=True))
        for (start, end), (width, end_width) in reversed(rods):
            self.rod(OUTLINE, start, end, width + 2 * edge, end_width + 2 * edge)
            self.rod(ROD, start, end, width, end_width)
        for pixel, width in zip(pixels[:-1], widths, strict=False):
            self.disc(OUTLINE, pixel, 0.36 * width + edge)
            self.disc(REACHABLE, pixel, 0.36 * width)
        self.disc(OUTLINE, pixels[-1], widths[-1] / 2 + edge)

    def arm_widths(self, segment_lengths: Sequence[float]) -> list[float]:
        """Return the thickness of the arm at its base, joints and hand (N + 1), in pixels.

        It decreases along the arm, so that both rods at a joint are equally thick there.
        """
        along = [0.0, *accumulate(segment_lengths)]
        taper = (HAND_WIDTH - BASE_WIDTH) / along[-1]
        return [self.view.stroke(BASE_WIDTH + taper * way) for way in along]

    def draw_ghost(self, joint_angles: Sequence[float], segment_lengths: Sequence[float]) -> None:
        """Paint an internal model's arm (N joint angles) as a thin line with hollow joints."""
        nodes = node_positions(list(accumulate(joint_angles)), segment_lengths)
        pixels = [self.view.pixel(node) for node in nodes]
        for color, line in ((REACHABLE, self.view.stroke(5)), (GHOST, self.view.stroke(2.5))):
            for start, end in pairwise(pixels):
                self.rod(color, start, end, line)
        for pixel in pixels[1:]:
            self.disc(GHOST, pixel, self.view.stroke(5.5))
            self.disc(REACHABLE, pixel, self.view.stroke(3))

    def draw_trace(self, points: Iterable[Sequence[float]]) -> None:
        """Paint the past points of the hand, oldest first, as dots that fade with age."""
        pixels = [self.view.pixel(point) for point in points]
        for age, (start, end) in enumerate(pairwise(pixels), start=1):
            freshness = age / len(pixels)
            color = blend(REACHABLE, TRACE, 0.2 + 0.8 * freshness)
            self.rod(color, start, end, self.view.stroke(0.8 + 1.4 * freshness))
            self.disc(color, end, self.view.stroke(1.5 + 1.8 * freshness))

    def draw_target(self, target: Sequence[float], success_distance: float, reached: bool) -> None:
        """Paint the target: a ring of the success radius on a cross, and a second when reached."""
        stroke = self.view.stroke
        x, y = self.view.pixel(target)
        radius = self._target_radius(success_distance)
        gap, tick = radius + stroke(3), radius + stroke(14)
        # A light edge around everything keeps the target visible on the arm.
        for color, line in ((REACHABLE, stroke(4.5)), (TARGET, stroke(2.5))):
            for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1)):
                start, end = (x + gap * dx, y + gap * dy), (x + tick * dx, y + tick * dy)
                self.rod(color, start, end, line)
            for ring in (radius, radius + stroke(8.5))[: 1 + reached]:
                self.ring(color, (x, y), ring, line)

    def _target_radius(self, success_distance: float) -> float:
        return max(success_distance * self.view.scale, self.view.stroke(3))

    def draw_track(self, points: Sequence[Sequence[float]]) -> None:
        """Paint the path of a moving target as faint dots."""
        color = blend(BACKGROUND, TARGET, 0.45)
        for point in points[:: max(1, len(points) // 160)]:
            self.disc(color, self.view.pixel(point), self.view.stroke(2))

    def draw_next_targets(
        self, target: Sequence[float], points: Sequence[Sequence[float]], success_distance: float
    ) -> None:
        """Paint the next targets as faint rings, joined in order by dashes."""
        color, line = blend(BACKGROUND, TARGET, 0.55), self.view.stroke(2)
        pixels = [self.view.pixel(point) for point in (target, *points)]
        self.dashes(color, pixels, 1.5, 5)
        radius = self._target_radius(success_distance) + self.view.stroke(3)
        for pixel in pixels[1:]:
            self.disc(REACHABLE, pixel, radius)
            self.ring(color, pixel, radius, line)

    def draw_curl_field(self, curl: float) -> None:
        """Paint arrows that turn as the field bends movements, clockwise if `curl` is positive."""
        spacing = self.view.reach / 3
        for row, column in product(range(-3, 4), repeat=2):
            middle = (column * spacing, row * spacing)
            if 0 < math.hypot(*middle) < 0.95 * self.view.reach:
                self._draw_turn(self.view.pixel(middle), -math.copysign(1, curl))

    def _draw_turn(self, middle: Point, sense: float) -> None:
        """Paint three quarters of a circle with an arrowhead; `sense` 1 is counter-clockwise."""
        radius, line, head = map(self.view.stroke, (13, 2, 6))

        def at(angle: float, distance: float = radius) -> Point:
            x, y = distance * math.cos(angle), sense * distance * math.sin(angle)
            return middle[0] + x, middle[1] - y

        arc = [at(step / 24 * 1.4 * math.pi) for step in range(25)]
        for start, end in pairwise(arc):
            self.rod(FIELD, start, end, line)
        last = 1.4 * math.pi
        tip = at(last + 1.5 * head / radius)
        corners = [at(last, radius - head), at(last, radius + head), tip]
        pygame.draw.polygon(self.surface, FIELD, corners)

    def draw_obstacle(self, disc: tuple[float, float, float]) -> None:
        """Paint a disc (x, y, radius) that stops the arm: hatched."""
        (x, y), radius = self.view.pixel(disc[:2]), disc[2] * self.view.scale
        self.disc(BORDER, (x, y), radius)
        spacing, line = self.view.stroke(7), self.view.stroke(1.6)
        lines = int(radius / spacing)
        for number in range(-lines, lines + 1):
            across = number * spacing / math.sqrt(2)
            half = math.sqrt(radius**2 - (number * spacing) ** 2) / math.sqrt(2)
            start, end = ((x + across + side * half, y + across - side * half) for side in (-1, 1))
            self.rod(OUTLINE, start, end, line)
        self.ring(OUTLINE, (x, y), radius, self.view.stroke(2))

    def draw_hand_mass(self, hand: Point, mass: float) -> None:
        """Paint a weight with its handle at the hand; its volume grows with the mass."""
        x, y = self.view.pixel(hand)
        size = self.view.stroke(9) * mass ** (1 / 3)
        self.ring(OUTLINE, (x, y - 0.95 * size), 0.42 * size, 0.24 * size)
        for grown, color in ((self.view.stroke(2.5), REACHABLE), (0.0, OUTLINE)):
            half_top, half_bottom = 0.75 * size + grown, 1.15 * size + grown
            top, bottom = y - 0.7 * size - grown, y + 0.9 * size + grown
            upper = [(x - half_top, top), (x + half_top, top)]
            lower = [(x + half_bottom, bottom), (x - half_bottom, bottom)]
            pygame.draw.polygon(self.surface, color, upper + lower)

    def draw_lock(self, joint: Point) -> None:
        """Paint a closed padlock on a joint."""
        stroke = self.view.stroke
        x, y = self.view.pixel(joint)
        side, edge = stroke(18), stroke(2)
        for color, line in ((REACHABLE, stroke(7)), (OUTLINE, stroke(3.5))):
            self.ring(color, (x, y - 0.42 * side), 0.34 * side, line)
        for grown, color in ((edge, REACHABLE), (0.0, OUTLINE)):
            width, height = side + 2 * grown, 0.85 * side + 2 * grown
            self._plate(color, (x, y + 0.1 * side), width, height, round(stroke(3)))
        self.disc(REACHABLE, (x, y + 0.05 * side), stroke(2.4))
        self.rod(REACHABLE, (x, y), (x, y + 0.3 * side), stroke(1.8))

    def draw_old_lengths(
        self,
        segment_angles: Sequence[float],
        segment_lengths: Sequence[float],
        old_lengths: Sequence[float],
    ) -> None:
        """Paint the former outline of each segment whose length has changed, in dashes."""
        nodes = node_positions(segment_angles, segment_lengths)
        widths = self.arm_widths(segment_lengths)
        segments = zip(nodes, widths, segment_angles, segment_lengths, old_lengths, strict=False)
        for (x, y), width, angle, length, old in segments:
            if not math.isclose(length, old):
                end = (x + old * math.cos(angle), y + old * math.sin(angle))
                half = width / 2 + self.view.stroke(5)
                pixels = rod_outline(self.view.pixel((x, y)), self.view.pixel(end), half)
                self.dashes(REACHABLE, pixels, 4, 400)
                self.dashes(OUTLINE, pixels, 1.8, 6)

    def draw_cursor(self, hand: Point, cursor: Point) -> None:
        """Paint the cursor as a diamond, with a dashed line to the hand."""
        self.dashes(CURSOR, [self.view.pixel(hand), self.view.pixel(cursor)], 1.8, 6)
        for size, color in ((12, REACHABLE), (9.5, CURSOR), (4, REACHABLE)):
            self.diamond(color, self.view.pixel(cursor), size)

    def draw_sensed(self, nodes: Sequence[Point], hand: Point, target: Point) -> None:
        """Paint the sensed arm (N + 1 nodes) in dashes, hand and target as hollow diamonds."""
        pixels = [self.view.pixel(node) for node in nodes]
        color = blend(BACKGROUND, OUTLINE, 0.75)
        for start, end in pairwise(pixels):
            self.rod(REACHABLE, start, end, self.view.stroke(4))
        self.dashes(color, pixels, 2, 7)
        for point in (hand, target):
            for size, shade in ((10, REACHABLE), (8, color), (5, REACHABLE)):
                self.diamond(shade, self.view.pixel(point), size)
