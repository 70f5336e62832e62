"""Shapes that pygame lacks: tapering rods, dashed lines, outlines.  All lengths are in pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate, pairwise

import numpy as np
import pygame

Color = tuple[int, int, int]
Point = tuple[float, float]


def draw_rod(
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


def draw_ring(
    surface: pygame.Surface, color: Color, middle: Point, radius: float, width: float
) -> None:
    """Paint a circle's line, half of it to either side of the radius."""
    pygame.draw.circle(surface, color, middle, radius + width / 2, max(1, round(width)))


def blend(start: Color, end: Color, share: float) -> Color:
    """The colour at a share of the way between two."""
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(start, end, strict=True))
    return red, green, blue


def draw_dashes(
    surface: pygame.Surface, color: Color, corners: Sequence[Point], width: float, dash: float
) -> None:
    """Paint a dashed line through corners; dashes and gaps are of one length, and go round them."""
    ways = [0.0, *accumulate(math.dist(start, end) for start, end in pairwise(corners))]
    xs, ys = zip(*corners, strict=True)

    def at(way: float) -> Point:
        return float(np.interp(way, ways, xs)), float(np.interp(way, ways, ys))

    for number in range(math.ceil(ways[-1] / (2 * dash))):
        start, end = 2 * number * dash, min((2 * number + 1) * dash, ways[-1])
        stops = [start, *(way for way in ways if start < way < end), end]
        for one, other in pairwise(stops):
            draw_rod(surface, color, at(one), at(other), width, width)


def draw_diamond(surface: pygame.Surface, middle: Point, half: float, color: Color) -> None:
    """Paint a square that stands on a corner, `half` from its middle to each."""
    x, y = middle
    pygame.draw.polygon(
        surface, color, [(x - half, y), (x, y - half), (x + half, y), (x, y + half)]
    )


def rod_outline(start: Point, end: Point, half_width: float) -> list[Point]:
    """The outline of a rod with round ends, closed."""
    along = math.atan2(end[1] - start[1], end[0] - start[0])
    turns = [step / 12 * math.pi for step in range(13)]
    outline = [
        (x + half_width * math.cos(angle), y + half_width * math.sin(angle))
        for (x, y), first in ((end, along - math.pi / 2), (start, along + math.pi / 2))
        for angle in (first + turn for turn in turns)
    ]
    return [*outline, outline[0]]
