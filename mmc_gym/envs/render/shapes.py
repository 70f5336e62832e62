"""Drawing an arm, its target and its path with pygame: small functions that each paint one thing.

They paint on a surface through a `View`, which maps the world (x to the right, y up, the base in
the middle) to pixels.  Nothing here depends on colour alone: the arm is the filled shape, the
target the ring with a cross, reaching it adds a second ring, and the dots of the trace lie one
frame apart; an internal model's arm is a thin line with hollow joints, and where the target will
be are dots or rings without a cross.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import pygame

from mmc_gym.envs.render.strokes import Color as Color
from mmc_gym.envs.render.strokes import Point, blend, draw_dashes, draw_ring, draw_rod
from mmc_gym.network.chain import reachable_radii

SIZE = 640  # width and height of the picture in pixels; video encoders like multiples of 16
_MARGIN = 1.1  # half the picture's width, in reaches

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
    widths = arm_widths(view, segment_lengths, style)
    edge = view.stroke(2)
    # From the hand to the base: the thicker rod lies on top at every joint.
    for (start, end), (width, end_width) in reversed(
        list(zip(pairwise(pixels), pairwise(widths), strict=True))
    ):
        draw_rod(surface, style.outline, start, end, width + 2 * edge, end_width + 2 * edge)
        draw_rod(surface, style.fill, start, end, width, end_width)
    for pixel, width in zip(pixels[:-1], widths, strict=False):
        pygame.draw.circle(surface, style.outline, pixel, 0.36 * width + edge)
        pygame.draw.circle(surface, REACHABLE, pixel, 0.36 * width)
    pygame.draw.circle(surface, style.outline, pixels[-1], widths[-1] / 2 + edge)


def arm_widths(
    view: View, segment_lengths: Sequence[float], style: ArmStyle = ArmStyle()
) -> list[float]:
    """How thick the arm is at its base, joints and hand (N + 1 pixels).

    It tapers with its length, so that its thickness at a joint is one for both rods.
    """
    along = [0.0, *accumulate(segment_lengths)]
    taper = (style.hand_width - style.base_width) / along[-1]
    return [view.stroke(style.base_width + taper * way) for way in along]


def draw_ghost(
    surface: pygame.Surface,
    view: View,
    joint_angles: Sequence[float],
    segment_lengths: Sequence[float],
) -> None:
    """Paint an internal model's arm (N joint angles): a thin line with hollow joints."""
    nodes = node_positions(list(accumulate(joint_angles)), segment_lengths)
    pixels = [view.pixel(node) for node in nodes]
    for color, line in ((REACHABLE, view.stroke(5)), (GHOST, view.stroke(2.5))):
        for start, end in pairwise(pixels):
            draw_rod(surface, color, start, end, line, line)
    for pixel in pixels[1:]:
        pygame.draw.circle(surface, GHOST, pixel, view.stroke(5.5))
        pygame.draw.circle(surface, REACHABLE, pixel, view.stroke(3))


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
            draw_rod(surface, color, start, end, line, line)
        for ring in (radius, radius + view.stroke(8.5))[: 1 + reached]:
            draw_ring(surface, color, (x, y), ring, line)


def draw_track(surface: pygame.Surface, view: View, points: Sequence[Sequence[float]]) -> None:
    """Paint the path of a moving target as faint dots."""
    for point in points[:: max(1, len(points) // 160)]:
        pygame.draw.circle(
            surface, blend(BACKGROUND, TARGET, 0.45), view.pixel(point), view.stroke(2)
        )


def draw_next_targets(
    surface: pygame.Surface,
    view: View,
    target: Sequence[float],
    points: Sequence[Sequence[float]],
    success_distance: float,
) -> None:
    """Paint the targets to come: faint rings, joined to the present one by dashes in order."""
    color, line = blend(BACKGROUND, TARGET, 0.55), view.stroke(2)
    pixels = [view.pixel(point) for point in (target, *points)]
    draw_dashes(surface, color, pixels, view.stroke(1.5), view.stroke(5))
    radius = max(success_distance * view.scale, view.stroke(3)) + view.stroke(3)
    for pixel in pixels[1:]:
        pygame.draw.circle(surface, REACHABLE, pixel, radius)
        draw_ring(surface, color, pixel, radius, line)


def draw_trace(surface: pygame.Surface, view: View, points: Iterable[Sequence[float]]) -> None:
    """Paint where the hand has been, oldest first and faintest, a dot at every point."""
    pixels = [view.pixel(point) for point in points]
    for age, (start, end) in enumerate(pairwise(pixels), start=1):
        freshness = age / len(pixels)
        color = blend(REACHABLE, TRACE, 0.2 + 0.8 * freshness)
        width = view.stroke(0.8 + 1.4 * freshness)
        draw_rod(surface, color, start, end, width, width)
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
