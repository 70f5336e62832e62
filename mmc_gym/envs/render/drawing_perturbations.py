"""Drawing what perturbs an arm: small functions that each paint one perturbation.

None depends on colour alone: a force field is turning arrows, obstacles are hatched, a hand mass
is a weight, a locked joint a padlock, a changed segment has its old length around it in dashes,
a cursor is a diamond on a dashed line to the hand, and what is sensed is a dashed skeleton.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import pygame

from mmc_gym.envs.render.shapes import (
    BACKGROUND,
    BORDER,
    OUTLINE,
    REACHABLE,
    TRACE,
    View,
    arm_widths,
    node_positions,
)
from mmc_gym.envs.render.strokes import (
    Color,
    Point,
    blend,
    draw_dashes,
    draw_diamond,
    draw_ring,
    draw_rod,
    rod_outline,
)

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
    """Paint what is sensed: a dashed skeleton, and hollow diamonds for hand and target as seen.

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
