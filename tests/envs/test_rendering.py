"""Facts about the pictures."""

import math
import os
import subprocess
import sys
from unittest.mock import Mock, call

import gymnasium as gym
import numpy as np
import pygame
import pytest
from gymnasium.wrappers.vector import RecordVideo

from mmc_gym import UserError
from mmc_gym.envs import render as drawing
from mmc_gym.envs.arguments import ReachArguments
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.envs.reach import MMCReachEnv
from mmc_gym.envs.render import Renderer, Scene, View, Window
from mmc_gym.envs.setup import ReachSetup
from mmc_gym.envs.trials import Options

FAR = (-2.5, 0.0)


@pytest.fixture(autouse=True)
def no_display_before_or_after():
    pygame.display.quit()
    yield
    pygame.display.quit()


POSTURE = [0.5, 1.0, 1.5]  # absolute angles
NODES = np.cumsum([(0.0, 0.0), *((math.cos(a), math.sin(a)) for a in POSTURE)], axis=0)


def make(mode="rgb_array", **arguments):
    return gym.make("MMCReach-v0", render_mode=mode, **arguments)


def setup_of(**arguments):
    return ReachSetup(ReachArguments(**arguments))


def picture(angles, target=FAR, setup=None, **scene):
    setup = setup or setup_of()
    shown = Scene(angles, target, cursor=setup.first.cursor, **scene)
    return Renderer(setup, setup.first, "rgb_array").draw(shown) * 1.0


def gray(image, point, size=5):
    """The surroundings of a point of the world, of an arm of reach 3, without colour."""
    x, y = map(round, View(3.0).pixel(point))
    return image[y - size : y + size + 1, x - size : x + size + 1].mean(axis=-1)


def differ(first, second, point, size=5):
    """Whether pictures differ near a point of the world, were there no colour."""
    return bool(np.abs(gray(first, point, size) - gray(second, point, size)).max() > 30)


@pytest.mark.parametrize(("width", "height"), [(320, 320), (480, 240), (100, 300)])
def test_pictures_have_the_width_and_height_that_are_asked_for(width, height):
    env, side = make(width=width, height=height), min(width, height)
    env.reset(seed=0)
    frame = env.render()
    assert frame.shape == (height, width, 3)
    top, left = (height - side) // 2, (width - side) // 2
    world = frame[top : top + side, left : left + side]
    square = make(width=side, height=side)
    square.reset(seed=0)
    np.testing.assert_array_equal(world, square.render())
    assert (np.delete(frame, np.s_[top : top + side], 0) == drawing.BACKGROUND).all()


def test_pictures_are_new_arrays_and_need_a_mode_but_no_display():
    env, unseen = make(), make(None)
    env.reset(seed=0)
    frame = env.render()
    before = frame.copy()
    assert (frame.shape, frame.dtype) == ((640, 640, 3), np.uint8)
    env.step(np.ones(3, np.float32))
    assert not np.array_equal(env.render(), before)
    np.testing.assert_array_equal(frame, before)
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert unseen.unwrapped.render() is None
    env.close()
    assert not pygame.display.get_init()


def test_the_arm_is_where_its_angles_say_with_y_up():
    empty, up = picture([math.pi] * 3), picture([math.pi / 2] * 3)
    for height in (0.5, 1.5, 2.5):
        assert differ(empty, up, (0.0, height), 1)
        assert not differ(empty, up, (0.0, -height), 1)
        assert not differ(empty, up, (height, 0.0), 1)


def test_the_target_is_a_cross_and_a_ring_of_the_success_radius_that_shows_success():
    elsewhere, there = (picture([0.0] * 3, target) for target in (FAR, (-1.0, 1.0)))
    on_ring = [(0.05 * math.cos(angle), 0.05 * math.sin(angle)) for angle in (0.4, 1.2, 2.5)]
    for x, y in ((0.13, 0.0), (0.0, -0.13), *on_ring):
        assert differ(elsewhere, there, (x - 1.0, y + 1.0), 1)
    short, reached = picture([0.0] * 3, (2.94, 0.0)), picture([0.0] * 3, (2.96, 0.0))
    dark = [(image.mean(axis=-1) < 150).sum() for image in (short, reached)]
    assert dark[1] > dark[0] + 50


def test_the_trace_is_the_hands_path_whatever_frames_are_drawn():
    """It fades within a second, and a reset clears it."""
    often, once, resting = make(), make(), make()
    reset = {"seed": 0, "options": {"joint_angles": [0.5, 0.5, 0.5], "target": FAR}}
    start, darkness = tuple(NODES[-1]), []
    for env in (often, once, resting):
        env.reset(**reset)
    for step in range(60):
        for env in (often, once):
            env.step(np.float32([1, 0, 0] if step < 20 else [0, 0, 0]))
        darkness.append(255 - gray(often.render(), start, 2).min())
    assert darkness[10] > darkness[30] > darkness[45] > darkness[55]
    np.testing.assert_array_equal(often.render(), once.render())
    once.reset(**reset)
    np.testing.assert_array_equal(once.render(), resting.render())


@pytest.mark.parametrize("lengths", [(1.0,), (2.0, 0.5), (30.0,) * 8])
def test_arms_of_any_segments_fill_the_same_picture(lengths):
    env = make(segment_lengths=lengths)
    env.reset(seed=0, options={"joint_angles": [0.0] * len(lengths)})
    x, y = map(round, View(sum(lengths)).pixel((sum(lengths) * 0.9, 0.0)))
    assert env.render()[y, x].tolist() == list(drawing.ROD)


def test_an_environment_shows_the_posture_it_is_given():
    env = make().unwrapped
    env.reset(seed=0, options={"joint_angles": [0.0] * 3, "target": FAR})
    plain = env.render()
    env.show_posture([0.5, 0.5, 0.5])
    assert all(differ(plain.astype(float), env.render(), tuple(node)) for node in NODES[1:])
    env.show_posture(None)
    np.testing.assert_array_equal(env.render(), plain)


def test_targets_to_come_are_shown_and_those_that_were_are_not():
    setup = setup_of(task="via-points")
    path = [(-1.0, 1.0), (-1.0, -1.0), (1.0, -2.0)]
    for now, target in enumerate(path):
        images = [picture([0.0] * 3, target, setup, path=shown) for shown in (path, ())]
        assert not any(differ(*images, place) for place in path[:now])
        assert all(differ(*images, place) for place in path[now + 1 :])
    np.testing.assert_array_equal(*images)  # nothing comes after the last
    pursuit = setup_of(task="pursuit")
    random, workspace = np.random.default_rng(0), pursuit.first.workspace
    path = pursuit.trials.draw(workspace, random, Options()).targets
    images = [picture([0.0] * 3, path[0], pursuit, path=shown) for shown in (path, ())]
    assert all(differ(*images, path[place]) for place in (100, 250, 400))


def looks_perturbed(perturbation, point, **scene):
    """Whether a picture differs near a point from one without the perturbation."""
    setup = setup_of(perturbations=[perturbation])
    return differ(picture(POSTURE, FAR, setup, **scene), picture(POSTURE), point)


def test_a_hand_mass_is_at_the_hand_and_larger_the_heavier():
    x, y = NODES[-1]
    beside = (x + 0.16, y - 0.05)
    assert looks_perturbed("hand-mass-1", (x + 0.05, y))
    assert looks_perturbed("hand-mass-20", beside)
    assert not looks_perturbed("hand-mass-1", beside)


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_a_lock_is_on_its_joint_and_only_once_it_is_locked(joint):
    lock, point = f"locks-{joint}", tuple(NODES[joint - 1])
    assert looks_perturbed(lock, point, steps=10)
    assert not looks_perturbed(lock, point, steps=9)


def acting(perturbations, actions=(0.0, 0.0, 0.0), steps=1):
    """The picture of an arm in `POSTURE` after some steps with these actions."""
    env = MMCReachEnv(render_mode="rgb_array", perturbations=perturbations)
    env.reset(seed=0, options={"joint_angles": [0.5] * 3, "target": FAR})
    for _ in range(steps):
        env.step(np.float32(actions))
    return env.render().astype(float)


FAILING = [name for name, family in FAMILIES.items() if family.group == "motors"]


@pytest.mark.parametrize("name", FAILING)
def test_a_joint_whose_motor_fails_has_a_cross(name):
    pair = acting([], steps=0), acting([name], steps=0)
    shows = [differ(*pair, tuple(node), 3) for node in NODES[:3]]
    assert shows == [name != "stuck-motor", True, name != "stuck-motor"]


def test_a_cross_is_on_the_joint_that_is_named_and_only_once_its_motor_fails():
    for steps, shows in ((2, [False, False, False]), (3, [False, False, True])):
        pair = acting([], steps=steps), acting(["motor-gain-0.4-of-3-at-0.06"], steps=steps)
        assert [differ(*pair, tuple(node), 3) for node in NODES[:3]] == shows


def test_arcs_show_the_action_that_was_commanded_and_what_of_it_arrived():
    def on_arc(radius, share, joint=0):  # the point of an arc of an action
        turn, away = POSTURE[joint] + share * math.pi / 2, radius / View(3.0).scale
        x, y = NODES[joint]
        return x + away * math.cos(turn), y + away * math.sin(turn)

    reversed_, still = acting(["motor-gain--1"], (0.4, 0, 0)), acting(["motor-gain--1"])
    assert differ(reversed_, still, on_arc(42, 0.35), 1)
    assert not differ(reversed_, still, on_arc(42, -0.35), 1)
    assert differ(reversed_, still, on_arc(33, -0.35), 1)
    assert not differ(reversed_, still, on_arc(33, 0.35), 1)
    stuck = acting(["stuck-motor-1"], (0.4, 0, 0))
    assert differ(stuck, still, on_arc(42, 0.35), 1)
    assert not differ(stuck, still, on_arc(33, 0.3), 1)
    assert not differ(stuck, still, on_arc(33, -0.3), 1)


def test_arrows_turn_as_the_field_bends():
    """Upside down, a field's arrows are the opposite field's."""
    fields = [setup_of(perturbations=[name]) for name in ("force-field-9", "force-field--9")]
    # An arm that is the same upside down; the caption is above.
    image, opposite = (picture([0.0] * 3, FAR, setup)[60:-60] for setup in fields)
    assert np.abs(image - opposite).max() > 30
    assert np.abs(image - opposite[::-1]).mean() < 0.5 * np.abs(image - opposite).mean()


def test_a_cursor_is_where_the_rotation_puts_it_and_reaches_the_target():
    setup = setup_of(perturbations=["rotation-90"])
    assert differ(picture([0.0] * 3, FAR, setup), picture([0.0] * 3), (0.0, 3.0))
    # Within the success distance a second ring is painted, of the cursor and not of the hand.
    near = (0.0, 2.97), (0.0, 2.9), (2.97, 0.0)
    dark = [(gray(picture([0.0] * 3, place, setup), place, 16) < 150).sum() for place in near]
    assert dark[0] > dark[1] + 20


# A picture shows the world, not what agents see of it.
SHOWN = tuple(name for name in FAMILIES if not name.endswith(("-feedback", "vision-delay")))


@pytest.mark.parametrize(
    "names", [("longer", "obstacles", "delay"), pytest.param(SHOWN, marks=pytest.mark.slow)]
)
def test_every_perturbation_can_be_seen(names):
    pictures = []
    for name in ((), *names):
        env = MMCReachEnv(render_mode="rgb_array", task="centre-out", perturbations=name)
        env.reset(seed=0, options={"trial": 0})
        for step in range(12):  # actions grow: what repeats a constant action changes nothing
            env.step(np.full(3, 0.04 * step, np.float32))
        pictures.append(env.render()[40:].astype(int))  # below the caption
    assert all(np.abs(image - pictures[0]).max() > 30 for image in pictures[1:])


def test_what_is_drawn_as_sensed_is_what_the_agent_observes(monkeypatch):
    """Also while a delay has not begun."""
    env, scenes = MMCReachEnv(perturbations=["delay-100-at-0.1"], render_mode="rgb_array"), []
    monkeypatch.setattr(Renderer, "draw", lambda _, scene: scenes.append(scene))
    env.reset(seed=0)
    for _ in range(12):
        observation, *_ = env.step(np.full(3, 0.5, np.float32))
        env.render()
        np.testing.assert_array_equal(scenes[-1].observation, observation)


def test_a_window_shows_every_step_at_the_control_rate(monkeypatch):
    clock = Mock()
    monkeypatch.setattr(pygame.time, "Clock", lambda: clock)
    env, array = make("human"), make()
    for shown in (env, array):
        shown.reset(seed=0)
        for _ in range(3):
            shown.step(np.zeros(3, np.float32))
    assert clock.tick.call_args_list == [call(50)] * 4
    window = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    np.testing.assert_array_equal(window, array.render())
    env.close()
    env.close()
    assert not pygame.display.get_init()


def test_an_environment_outlives_the_window_that_its_user_closes():
    env = make("human").unwrapped
    env.reset(seed=0)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    with pytest.warns(UserWarning, match="window was closed"):
        env.step(np.zeros(3, np.float32))
    assert not pygame.display.get_init()
    env.step(np.zeros(3, np.float32))
    env.reset()
    env.close()
    assert not pygame.display.get_init()
    env.render()  # a closed environment that is shown again opens a window again
    assert pygame.display.get_init()
    env.close()


def test_a_window_leaves_keys_to_others_and_its_queue_empty_of_motion():
    window = Window(1000)
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_a))
    pygame.event.post(pygame.event.Event(pygame.MOUSEMOTION, pos=(1, 1), rel=(0, 0)))
    window.show(pygame.Surface((640, 640)))
    assert pygame.event.peek(pygame.KEYDOWN)
    assert not pygame.event.peek(pygame.MOUSEMOTION)


def test_gymnasium_approves_of_windows_where_sdl_has_no_screen():
    """As it does of CartPole: SDL opens its offscreen window."""
    code = "import gymnasium as gym, mmc_gym; from gymnasium.utils.env_checker import check_env\n"
    code += "check_env(gym.make('MMCReach-v0').unwrapped)"
    names = ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY")
    environment = {name: value for name, value in os.environ.items() if name not in names}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)


def test_a_window_that_sdl_refuses_is_explained(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "nowhere")
    message = "a window needs a display, and there is none: nowhere not available.*mmc-gym record"
    with pytest.raises(UserError, match=message):
        make("human").reset(seed=0)


@pytest.mark.parametrize(
    "perturbations",
    [
        ["longer--30..35", "rotation--60..60"],
        "joint-noise",
        ["motor-gain--1..1-of-2", "action-delay-0..60"],
    ],
)
def test_a_vector_draws_what_its_arms_would_draw(perturbations):
    made = {"perturbations": perturbations, "max_episode_steps": 4, "render_mode": "rgb_array"}
    made |= {"num_envs": 3, "width": 96, "height": 96}
    native = gym.make_vec("MMCReachViaPoints-v0", **made)
    sync = gym.make_vec("MMCReachViaPoints-v0", vectorization_mode="sync", **made)
    for envs in (native, sync):
        envs.reset(seed=3)
    for action in np.random.default_rng(0).uniform(-1, 1, (7, 3, 3)).astype(np.float32):
        np.testing.assert_array_equal(native.render(), sync.render())
        native.step(action)
        sync.step(action)


@pytest.mark.slow
def test_gymnasium_films_a_native_vector(tmp_path):
    envs = gym.make_vec("MMCReach-v0", num_envs=4, render_mode="rgb_array", max_episode_steps=10)
    films = RecordVideo(envs, str(tmp_path / "films"), episode_trigger=lambda episode: episode == 0)
    films.reset(seed=0)
    for _ in range(12):
        films.step(films.action_space.sample())
    films.close()
    assert [path.suffix for path in tmp_path.glob("films/*") if path.stat().st_size > 1000] == [
        ".mp4"
    ]
