"""Facts about the pictures."""

import math
import subprocess
import sys
from collections.abc import Iterator

import gymnasium as gym
import numpy as np
import pygame
import pytest

from mmc_gym.envs import drawing
from mmc_gym.envs.drawing import View
from mmc_gym.envs.rendering import Renderer, Scene, Window
from mmc_gym.envs.setup import ReachSetup

LENGTHS = (1.0, 1.0, 1.0)
FAR = (-2.5, 0.0)


@pytest.fixture(autouse=True)
def no_display_before_or_after() -> Iterator[None]:
    pygame.display.quit()
    yield
    pygame.display.quit()


def picture(angles: list[float], target: tuple[float, float] = FAR) -> np.ndarray:
    frame = Renderer(ReachSetup(), "rgb_array", 50).draw(Scene(angles, target))
    assert frame is not None
    return frame.astype(int)


def differs(first: np.ndarray, second: np.ndarray, point: tuple[float, float]) -> bool:
    """Whether two pictures differ where they show a point of the world."""
    x, y = map(round, View(sum(LENGTHS)).pixel(point))
    near = np.s_[y - 1 : y + 2, x - 1 : x + 2]
    return bool(np.abs(first[near] - second[near]).max() > 40)


def test_importing_the_package_does_not_import_pygame() -> None:
    code = "import mmc_gym, sys; assert 'pygame' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_array_needs_no_display() -> None:
    env = gym.make("MMCReach-v0", render_mode="rgb_array")
    env.reset(seed=0)
    frame = env.render()
    assert isinstance(frame, np.ndarray)
    assert (frame.shape, frame.dtype) == ((640, 640, 3), np.uint8)
    env.step(np.zeros(3, np.float32))
    env.render()
    env.close()
    assert not pygame.display.get_init()


def test_frames_share_no_memory() -> None:
    renderer = Renderer(ReachSetup(), "rgb_array", 50)
    first = renderer.draw(Scene([0.0, 0.0, 0.0], FAR))
    assert first is not None
    kept = first.copy()
    renderer.draw(Scene([1.0, 1.0, 1.0], FAR))
    np.testing.assert_array_equal(first, kept)


def test_rendering_changes_nothing_in_the_world() -> None:
    seen, unseen = (
        gym.make("MMCReach-v0", render_mode=mode).unwrapped for mode in ("rgb_array", None)
    )
    for env in (seen, unseen):
        env.reset(seed=0)
    for _ in range(10):
        seen.render()
        action = np.array([0.1, 0.5, -0.3], np.float32)
        np.testing.assert_array_equal(seen.step(action)[0], unseen.step(action)[0])


def test_frames_fit_gymnasiums_collection() -> None:
    env = gym.wrappers.RenderCollection(gym.make("MMCReach-v0", render_mode="rgb_array"))
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.ones(3, np.float32))
    frames = env.render()
    assert [frame.shape for frame in frames] == [(640, 640, 3)] * 4
    assert len({frame.tobytes() for frame in frames}) == 4
    env.close()


def test_render_without_a_mode_says_what_to_do() -> None:
    env = gym.make("MMCReach-v0").unwrapped
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert env.render() is None


# --- What is to be seen


def test_the_arm_is_where_its_angles_say_with_y_up() -> None:
    empty, up = picture([math.pi] * 3), picture([math.pi / 2] * 3)
    for height in (0.5, 1.5, 2.5):
        assert differs(empty, up, (0.0, height))
        assert not differs(empty, up, (0.0, -height))
        assert not differs(empty, up, (height, 0.0))


def test_the_target_is_a_cross_and_a_ring_of_the_success_radius() -> None:
    elsewhere = picture([0.0] * 3, FAR)
    target = (-1.0, 1.0)
    there = picture([0.0] * 3, target)
    for angle in (0.4, 1.2, 2.5):
        on_ring = (target[0] + 0.05 * math.cos(angle), target[1] + 0.05 * math.sin(angle))
        assert differs(elsewhere, there, on_ring)
    assert differs(elsewhere, there, (-1.0 + 0.13, 1.0))
    assert differs(elsewhere, there, (-1.0, 1.0 - 0.13))


def test_reaching_the_target_shows_without_colour() -> None:
    hand = (3.0, 0.0)
    short, reached = picture([0.0] * 3, (2.94, 0.0)), picture([0.0] * 3, (2.96, 0.0))
    gray_short, gray_reached = short.mean(axis=-1), reached.mean(axis=-1)
    assert (gray_reached < 150).sum() > (gray_short < 150).sum() + 50
    assert math.dist(hand, (2.96, 0.0)) < 0.05


def test_the_hand_leaves_a_trace_that_fades_and_can_be_cleared() -> None:
    renderer = Renderer(ReachSetup(), "rgb_array", 50)
    clean = picture([1.0] * 3)
    darkness = []
    for step in range(70):
        frame = renderer.draw(Scene([min(1.0, 0.1 * step)] * 3, FAR))
        assert frame is not None
        x, y = map(round, View(3.0).pixel((3 * math.cos(0.2), 3 * math.sin(0.2))))
        darkness.append(255 - frame[y - 2 : y + 3, x - 2 : x + 3].mean(axis=-1).min())
    assert darkness[12] > darkness[30] > darkness[50] > 0
    renderer.clear_trace()
    np.testing.assert_array_equal(renderer.draw(Scene([1.0] * 3, FAR)), clean)


def test_edges_are_smooth() -> None:
    shades = np.unique(picture([0.3, 0.4, 0.5]).reshape(-1, 3), axis=0)
    assert len(shades) > 20


@pytest.mark.parametrize("lengths", [(1.0,), (2.0, 0.5), (1.0, 0.6, 0.4, 0.2, 0.1), (30.0,) * 8])
def test_arms_of_any_segments_fill_the_same_picture(lengths: tuple[float, ...]) -> None:
    env = gym.make("MMCReach-v0", render_mode="rgb_array", segment_lengths=lengths)
    env.reset(seed=0, options={"joint_angles": [0.0] * len(lengths)})
    frame = env.render()
    assert isinstance(frame, np.ndarray)
    x, y = map(round, View(sum(lengths)).pixel((sum(lengths) * 0.9, 0.0)))
    assert frame[y, x].tolist() == list(drawing.ROD)


def test_a_view_maps_there_and_back() -> None:
    view = View(reach=3.0, size=200)
    assert view.pixel((0.0, 0.0)) == (100.0, 100.0)
    for point in ((3.0, 0.0), (-1.0, 2.5)):
        x, y = view.pixel(point)
        assert 0 < x < 200
        assert 0 < y < 200
        assert view.point((x, y)) == pytest.approx(point)


# --- The window (SDL's dummy driver stands in for a screen)


def test_a_window_shows_every_step_at_the_control_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks: list[int] = []

    class Clock:
        def tick(self, rate: int) -> None:
            ticks.append(rate)

    monkeypatch.setattr(pygame.time, "Clock", Clock)
    env = gym.make("MMCReach-v0", render_mode="human")
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(3, np.float32))
    assert ticks == [50] * 4
    assert pygame.display.get_surface().get_size() == (640, 640)
    env.close()
    env.close()
    assert not pygame.display.get_init()


def test_the_window_shows_what_the_array_holds() -> None:
    human, array = (gym.make("MMCReach-v0", render_mode=mode) for mode in ("human", "rgb_array"))
    for env in (human, array):
        env.reset(seed=0)
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    np.testing.assert_array_equal(shown, array.render())
    human.close()


def test_an_environment_outlives_the_window_that_its_user_closes() -> None:
    env = gym.make("MMCReach-v0", render_mode="human").unwrapped
    env.reset(seed=0)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    with pytest.warns(UserWarning, match="window was closed"):
        env.step(np.zeros(3, np.float32))
    assert not pygame.display.get_init()
    env.step(np.zeros(3, np.float32))
    env.reset()
    assert not pygame.display.get_init()
    env.close()
    env.render()  # a closed environment that is shown again opens a window again
    assert pygame.display.get_init()
    env.close()


def test_a_window_leaves_keys_to_others_and_its_queue_empty_of_motion() -> None:
    window = Window((20, 20), "test", 1000)
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_a))
    pygame.event.post(pygame.event.Event(pygame.MOUSEMOTION, pos=(1, 1), rel=(0, 0)))
    window.show(pygame.Surface((20, 20)))
    assert pygame.event.peek(pygame.KEYDOWN)
    assert not pygame.event.peek(pygame.MOUSEMOTION)
