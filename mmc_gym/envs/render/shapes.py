"""Drawing an arm, its target and its path with pygame: small functions that each paint one thing.

They paint on a surface through a `View`, which maps the world (x to the right, y up, the base in
the middle) to pixels.  Nothing here depends on colour alone: the arm is the filled shape, the
target the ring with a cross, reaching it adds a second ring, and the dots of the trace lie one
frame apart; an internal model's arm is a thin line with hollow joints; dots, or rings without a
cross, show where the target will be.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
import pygame

from mmc_gym.network.chain import reachable_radii

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
    """Return the colour at a share of the way between two."""
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
    """Return the outline of a rod with round ends, closed."""
    along = math.atan2(end[1] - start[1], end[0] - start[0])
    turns = [step / 12 * math.pi for step in range(13)]
    outline = [
        (x + half_width * math.cos(angle), y + half_width * math.sin(angle))
        for (x, y), first in ((end, along - math.pi / 2), (start, along + math.pi / 2))
        for angle in (first + turn for turn in turns)
    ]
    return [*outline, outline[0]]


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
        """Return where in the picture a point (x, y) of the world is."""
        middle = self.size / 2
        return middle + point[0] * self.scale, middle - point[1] * self.scale

    def point(self, pixel: Sequence[float]) -> Point:
        """Return which point (x, y) of the world a pixel shows."""
        middle = self.size / 2
        return (pixel[0] - middle) / self.scale, (middle - pixel[1]) / self.scale

    def stroke(self, width: float) -> float:
        """Return the pixels of a width that is given for a picture of `SIZE`."""
        return width * self.size / SIZE


@dataclass(frozen=True)
class ArmStyle:
    """The look of an arm; widths are for a picture of `SIZE` pixels.

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
    """Paint the reachable set: a faint disc, or a ring if the segments are unequal."""
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
    """Return the thickness of the arm at its base, joints and hand (N + 1 pixels).

    It tapers with its length, so that both rods at a joint are equally thick there.
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
    """Return base, joints and hand (N + 1 points) of an arm with these absolute angles."""
    nodes = [(0.0, 0.0)]
    for angle, length in zip(segment_angles, segment_lengths, strict=True):
        x, y = nodes[-1]
        nodes.append((x + length * math.cos(angle), y + length * math.sin(angle)))
    return nodes


CURSOR: Color = (170, 60, 130)
_FIELD: Color = (172, 180, 192)
_FONT_SIZE = 22  # of the caption, in a picture of `SIZE`


def draw_caption(surface: pygame.Surface, view: View, words: str) -> None:
    """Write a line into the upper left corner."""
    pygame.font.init()
    text = pygame.font.Font(None, round(view.stroke(_FONT_SIZE))).render(words, True, TRACE)
    surface.blit(text, (view.stroke(12), view.stroke(10)))


def draw_curl_field(surface: pygame.Surface, view: View, curl: float) -> None:
    """Paint a curl field: arrows that turn the way in which movements are bent.

    Args:
        surface: what to paint on.
        view: maps the world to it.
        curl: positive bends to the right, so that the arrows turn clockwise.
    """
    spacing = view.reach / 3
    for row in range(-3, 4):
        for column in range(-3, 4):
            middle = (column * spacing, row * spacing)
            if 0 < math.hypot(*middle) < 0.95 * view.reach:
                _draw_turn(surface, view, view.pixel(middle), -math.copysign(1, curl))


def _draw_turn(surface: pygame.Surface, view: View, middle: Point, sense: float) -> None:
    """Paint three quarters of a circle with an arrowhead; `sense` 1 is counter-clockwise."""
    radius, line, head = view.stroke(13), view.stroke(2), view.stroke(6)

    def at(angle: float, distance: float = radius) -> Point:
        return (
            middle[0] + distance * math.cos(angle),
            middle[1] - sense * distance * math.sin(angle),
        )

    arc = [at(step / 24 * 1.4 * math.pi) for step in range(25)]
    for start, end in pairwise(arc):
        draw_rod(surface, _FIELD, start, end, line, line)
    last = 1.4 * math.pi
    tip = at(last + 1.5 * head / radius)
    pygame.draw.polygon(surface, _FIELD, [at(last, radius - head), at(last, radius + head), tip])


def draw_obstacle(surface: pygame.Surface, view: View, disc: tuple[float, float, float]) -> None:
    """Paint a disc (x, y, radius) that stops the arm: hatched."""
    (x, y), radius = view.pixel(disc[:2]), disc[2] * view.scale
    pygame.draw.circle(surface, BORDER, (x, y), radius)
    spacing, line = view.stroke(7), view.stroke(1.6)
    lines = int(radius / spacing)
    for number in range(-lines, lines + 1):
        across = number * spacing / math.sqrt(2)
        half = math.sqrt(radius**2 - (number * spacing) ** 2) / math.sqrt(2)
        start, end = ((x + across + side * half, y + across - side * half) for side in (-1, 1))
        draw_rod(surface, OUTLINE, start, end, line, line)
    draw_ring(surface, OUTLINE, (x, y), radius, view.stroke(2))


def draw_hand_mass(surface: pygame.Surface, view: View, hand: Point, mass: float) -> None:
    """Paint a weight with its handle at the hand; its volume grows with the mass."""
    x, y = view.pixel(hand)
    size = view.stroke(9) * mass ** (1 / 3)
    draw_ring(surface, OUTLINE, (x, y - 0.95 * size), 0.42 * size, 0.24 * size)
    for grown, color in ((view.stroke(2.5), REACHABLE), (0.0, OUTLINE)):
        half_top, half_bottom = 0.75 * size + grown, 1.15 * size + grown
        top, bottom = y - 0.7 * size - grown, y + 0.9 * size + grown
        corners = [
            (x - half_top, top),
            (x + half_top, top),
            (x + half_bottom, bottom),
            (x - half_bottom, bottom),
        ]
        pygame.draw.polygon(surface, color, corners)


def draw_lock(surface: pygame.Surface, view: View, joint: Point) -> None:
    """Paint a closed padlock on a joint."""
    x, y = view.pixel(joint)
    side, edge = view.stroke(18), view.stroke(2)
    draw_ring(surface, REACHABLE, (x, y - 0.42 * side), 0.34 * side, view.stroke(7))
    draw_ring(surface, OUTLINE, (x, y - 0.42 * side), 0.34 * side, view.stroke(3.5))
    for grown, color in ((edge, REACHABLE), (0.0, OUTLINE)):
        body = pygame.Rect(0, 0, round(side + 2 * grown), round(0.85 * side + 2 * grown))
        body.center = round(x), round(y + 0.1 * side)
        pygame.draw.rect(surface, color, body, border_radius=round(view.stroke(3)))
    pygame.draw.circle(surface, REACHABLE, (x, y + 0.05 * side), view.stroke(2.4))
    draw_rod(surface, REACHABLE, (x, y), (x, y + 0.3 * side), view.stroke(1.8), view.stroke(1.8))


def draw_old_lengths(
    surface: pygame.Surface,
    view: View,
    segment_angles: Sequence[float],
    segment_lengths: Sequence[float],
    old_lengths: Sequence[float],
) -> None:
    """Paint in dashes, around each segment of another length than it was, the one it was."""
    nodes = node_positions(segment_angles, segment_lengths)
    widths = arm_widths(view, segment_lengths)
    for index, (length, old) in enumerate(zip(segment_lengths, old_lengths, strict=True)):
        if not math.isclose(length, old):
            angle = segment_angles[index]
            x, y = nodes[index]
            end = (x + old * math.cos(angle), y + old * math.sin(angle))
            half = widths[index] / 2 + view.stroke(5)
            pixels = rod_outline(view.pixel((x, y)), view.pixel(end), half)
            draw_dashes(surface, REACHABLE, pixels, view.stroke(4), view.stroke(400))
            draw_dashes(surface, OUTLINE, pixels, view.stroke(1.8), view.stroke(6))


def draw_cursor(surface: pygame.Surface, view: View, hand: Point, cursor: Point) -> None:
    """Paint the cursor that stands for the hand: a diamond, on a dashed line to the hand."""
    draw_dashes(
        surface, CURSOR, [view.pixel(hand), view.pixel(cursor)], view.stroke(1.8), view.stroke(6)
    )
    for size, color in ((12, REACHABLE), (9.5, CURSOR), (4, REACHABLE)):
        draw_diamond(surface, view.pixel(cursor), view.stroke(size), color)


def draw_sensed(
    surface: pygame.Surface,
    view: View,
    nodes: Sequence[Point],
    hand: Point,
    target: Point,
) -> None:
    """Paint the sensed arm: a dashed skeleton, and hollow diamonds for hand and target as seen.

    Args:
        surface: what to paint on.
        view: maps the world to it.
        nodes: base, joints and hand (N + 1 points) as the joints are felt.
        hand: where the hand, or its cursor, is seen.
        target: where the target is seen.
    """
    pixels = [view.pixel(node) for node in nodes]
    color = blend(BACKGROUND, OUTLINE, 0.75)
    for start, end in pairwise(pixels):
        draw_rod(surface, REACHABLE, start, end, view.stroke(4), view.stroke(4))
    draw_dashes(surface, color, pixels, view.stroke(2), view.stroke(7))
    for point in (hand, target):
        for size, shade in ((10, REACHABLE), (8, color), (5, REACHABLE)):
            draw_diamond(surface, view.pixel(point), view.stroke(size), shade)
