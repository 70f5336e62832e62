"""Drawing an arm and its target with pygame: small functions that each paint one thing.

They paint on a surface through a `View`, which maps the world (x to the right, y up, the base in
the middle) to pixels.  Nothing here depends on colour alone: the arm is the filled shape, the
target the ring with a cross, reaching it adds a second ring, and the dots of the trace lie one
frame apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import pygame

from mmc_gym.network.chain import reachable_radii

SIZE = 640  # width and height of the picture in pixels; video encoders like multiples of 16
_MARGIN = 1.1  # half the picture's width, in reaches

Color = tuple[int, int, int]
Point = tuple[float, float]

# Blue and vermilion of the Okabe-Ito palette: apart for every kind of colour vision.
BACKGROUND: Color = (246, 247, 249)
REACHABLE: Color = (255, 255, 255)
BORDER: Color = (205, 210, 218)
OUTLINE: Color = (22, 42, 66)
ROD: Color = (64, 132, 190)
BASE: Color = (120, 130, 144)
TRACE: Color = (92, 104, 122)
TARGET: Color = (213, 78, 0)


@dataclass(frozen=True)
class View:
    """The map between the world and a square picture.

    Attributes:
        reach: reach of the arm, in segment lengths; the picture shows a little more.
        size: width and height of the picture, pixels.
    """

    reach: float
    size: int = SIZE

    @property
    def scale(self) -> float:
        """Pixels per segment length."""
        return self.size / (2 * _MARGIN * self.reach)

    def pixel(self, point: Sequence[float]) -> Point:
        """Where in the picture a point (x, y) of the world is."""
        middle = self.size / 2
        return middle + point[0] * self.scale, middle - point[1] * self.scale

    def point(self, pixel: Sequence[float]) -> Point:
        """Which point (x, y) of the world a pixel shows."""
        middle = self.size / 2
        return (pixel[0] - middle) / self.scale, (middle - pixel[1]) / self.scale

    def stroke(self, width: float) -> float:
        """Pixels of a width given for a picture of `SIZE`: lines keep their share of it."""
        return width * self.size / SIZE


@dataclass(frozen=True)
class ArmStyle:
    """What an arm looks like; widths are for a picture of `SIZE` pixels.

    Attributes:
        fill: colour of the rods.
        outline: colour of their edges and joints.
        base_width: thickness of the arm at its base.
        hand_width: thickness at its hand.
    """

    fill: Color = ROD
    outline: Color = OUTLINE
    base_width: float = 21.0
    hand_width: float = 8.0


def draw_reachable_set(
    surface: pygame.Surface, view: View, segment_lengths: Sequence[float]
) -> None:
    """Paint what the hand can reach: a faint disc, or a ring if the segments are unequal."""
    inner, outer = reachable_radii(segment_lengths)
    line = view.stroke(1.5)
    for radius, color in ((outer, REACHABLE), (inner, BACKGROUND)):
        if radius > 0:
            pixels = radius * view.scale
            pygame.draw.circle(surface, BORDER, view.pixel((0, 0)), pixels + line / 2)
            pygame.draw.circle(surface, color, view.pixel((0, 0)), pixels - line / 2)


def draw_base(surface: pygame.Surface, view: View) -> None:
    """Paint the plate that the arm stands on, with its four bolts."""
    half, corner, bolt = view.stroke(22), view.stroke(15), view.stroke(2.5)
    x, y = view.pixel((0, 0))
    for inset, color in ((0.0, OUTLINE), (view.stroke(2), BASE)):
        side = 2 * (half - inset)
        plate = pygame.Rect(0, 0, round(side), round(side))
        plate.center = round(x), round(y)
        pygame.draw.rect(surface, color, plate, border_radius=round(view.stroke(7) - inset / 2))
    for sign_x in (-1, 1):
        for sign_y in (-1, 1):
            middle = (x + sign_x * corner, y + sign_y * corner)
            pygame.draw.circle(surface, OUTLINE, middle, bolt)


def draw_arm(
    surface: pygame.Surface,
    view: View,
    segment_angles: Sequence[float],
    segment_lengths: Sequence[float],
    style: ArmStyle = ArmStyle(),
) -> None:
    """Paint an arm of N segments as tapering rods on round joints.

    Args:
        surface: what to paint on.
        view: maps the world to it.
        segment_angles: N absolute angles, radians.
        segment_lengths: N lengths.
        style: colours and widths.
    """
    nodes = node_positions(segment_angles, segment_lengths)
    pixels = [view.pixel(node) for node in nodes]
    # The arm tapers with its length, so that its thickness at a joint is one for both rods.
    along = [0.0, *accumulate(segment_lengths)]
    widths = [
        view.stroke(style.base_width + (style.hand_width - style.base_width) * way / along[-1])
        for way in along
    ]
    edge = view.stroke(2)
    # From the hand to the base: the thicker rod lies on top at every joint.
    for (start, end), (width, end_width) in reversed(
        list(zip(pairwise(pixels), pairwise(widths), strict=True))
    ):
        _draw_rod(surface, style.outline, start, end, width + 2 * edge, end_width + 2 * edge)
        _draw_rod(surface, style.fill, start, end, width, end_width)
    for pixel, width in zip(pixels[:-1], widths, strict=False):
        pygame.draw.circle(surface, style.outline, pixel, 0.36 * width + edge)
        pygame.draw.circle(surface, REACHABLE, pixel, 0.36 * width)
    pygame.draw.circle(surface, style.outline, pixels[-1], widths[-1] / 2 + edge)


def draw_target(
    surface: pygame.Surface,
    view: View,
    target: Sequence[float],
    success_distance: float,
    reached: bool,
) -> None:
    """Paint the target: a ring of the success radius on a cross; reached, a second ring."""
    x, y = view.pixel(target)
    radius = max(success_distance * view.scale, view.stroke(3))
    gap, tick = radius + view.stroke(3), radius + view.stroke(14)
    # A light edge around everything keeps the target visible on the arm.
    for color, line in ((REACHABLE, view.stroke(4.5)), (TARGET, view.stroke(2.5))):
        for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            start, end = (x + gap * dx, y + gap * dy), (x + tick * dx, y + tick * dy)
            _draw_rod(surface, color, start, end, line, line)
        for ring in (radius, radius + view.stroke(8.5))[: 1 + reached]:
            _draw_ring(surface, color, (x, y), ring, line)


def draw_trace(surface: pygame.Surface, view: View, points: Iterable[Sequence[float]]) -> None:
    """Paint where the hand has been, oldest first and faintest, a dot at every point."""
    pixels = [view.pixel(point) for point in points]
    for age, (start, end) in enumerate(pairwise(pixels), start=1):
        freshness = age / len(pixels)
        color = _blend(REACHABLE, TRACE, 0.2 + 0.8 * freshness)
        width = view.stroke(0.8 + 1.4 * freshness)
        _draw_rod(surface, color, start, end, width, width)
        pygame.draw.circle(surface, color, end, view.stroke(1.5 + 1.8 * freshness))


def node_positions(
    segment_angles: Sequence[float], segment_lengths: Sequence[float]
) -> list[Point]:
    """Base, joints and hand (N + 1 points) of an arm with the given absolute angles."""
    nodes = [(0.0, 0.0)]
    for angle, length in zip(segment_angles, segment_lengths, strict=True):
        x, y = nodes[-1]
        nodes.append((x + length * math.cos(angle), y + length * math.sin(angle)))
    return nodes


def _draw_rod(
    surface: pygame.Surface,
    color: Color,
    start: Point,
    end: Point,
    start_width: float,
    end_width: float,
) -> None:
    """Paint a tapering rod with round ends."""
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length = math.hypot(along_x, along_y)
    if length > 0:
        across_x, across_y = -along_y / length / 2, along_x / length / 2
        corners = [
            (x + side * width * across_x, y + side * width * across_y)
            for (x, y), width, side in (
                (start, start_width, 1),
                (end, end_width, 1),
                (end, end_width, -1),
                (start, start_width, -1),
            )
        ]
        pygame.draw.polygon(surface, color, corners)
    pygame.draw.circle(surface, color, start, start_width / 2)
    pygame.draw.circle(surface, color, end, end_width / 2)


def _draw_ring(
    surface: pygame.Surface, color: Color, middle: Point, radius: float, width: float
) -> None:
    """Paint a circle's line, half of it to either side of the radius."""
    pygame.draw.circle(surface, color, middle, radius + width / 2, max(1, round(width)))


def _blend(start: Color, end: Color, share: float) -> Color:
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(start, end, strict=True))
    return red, green, blue
