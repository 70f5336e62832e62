"""Play: what mouse and keys do to target and arm."""

import math
import os
import re
import subprocess
import sys
from itertools import islice

import numpy as np
import pygame
import pytest

import mmc_gym
from mmc_gym.agents import make_agent
from mmc_gym.envs.render import SIZE, View
from mmc_gym.record import frames, play


class Recorder:
    """An agent that does nothing but note what it is asked."""

    def __init__(self):
        self.calls = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.calls.append((state, bool(episode_start[0])))
        return np.full(3, 0.25, np.float32), 1 if state is None else state + 1


@pytest.fixture
def env(request):
    name = getattr(request, "param", "random")
    env = mmc_gym.make(name, render_mode="human", max_episode_steps=-1)
    env.metadata = {**env.metadata, "render_fps": 1000}
    yield env
    env.close()
    pygame.display.quit()


@pytest.fixture
def point_at(monkeypatch):
    def point(*pixel):
        monkeypatch.setattr(pygame.mouse, "get_focused", lambda: True)
        monkeypatch.setattr(pygame.mouse, "get_pos", lambda: pixel)

    return point


@pytest.mark.parametrize("env", ["random", "obstacles", "rotation-45", "longer-50"], indirect=True)
def test_the_mouse_points_at_what_the_picture_shows_and_the_hand_can_reach(env, point_at):
    game = frames(env, Recorder(), seed=0)
    next(game)
    setup = env.unwrapped.setup
    view = View(setup.limits.farthest)
    point_at(*view.pixel((-0.5, 1.5)))
    assert tuple(next(game)["target"]) == pytest.approx((-0.5, 1.5))
    if setup.first.body.obstacles:
        point_at(*view.pixel((1.5, 1.0)))  # in the middle of one
        assert tuple(next(game)["target"]) == pytest.approx((-0.5, 1.5))
    for corner in ((0, 0), (SIZE - 1, 5), (10, SIZE - 60)):
        point_at(*corner)
        target = next(game)["target"].tolist()
        assert setup.first.workspace.contains(target)
        assert math.atan2(*target) == pytest.approx(math.atan2(*view.point(corner)))


def test_an_agent_follows_the_mouse_without_a_time_limit(env, point_at):
    point_at(450, 200)
    *_, info = islice(frames(env, make_agent("mmc", env), seed=0), 251)
    assert info["distance"] < 0.05


def press(key):
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))


@pytest.mark.parametrize("end", [pygame.K_q, pygame.K_ESCAPE])
def test_r_draws_a_new_posture_and_keeps_the_target_until_a_key_ends_it(end, env, point_at):
    agent = Recorder()
    game = frames(env, agent, seed=0)
    start = next(game)["end_effector"]
    point_at(250, 180)
    before = next(game)
    press(pygame.K_r)
    after = next(game)
    np.testing.assert_array_equal(before["target"], after["target"])
    assert math.dist(before["end_effector"], after["end_effector"]) > 0.1
    assert agent.calls[-1] == (None, True)
    press(end)
    assert list(game) == []
    again, other = (next(frames(env, agent, seed))["end_effector"] for seed in (0, 1))
    assert again.tolist() == start.tolist() != other.tolist()


@pytest.mark.parametrize(
    ("agent", "env_id"), [("mmc", "MMCReach-v0"), ("ppo-torque", "MMCReachGoal-v0")]
)
@pytest.mark.filterwarnings("ignore:.*the window was closed")
def test_a_window_that_its_user_closes_is_closed(agent, env_id):
    pygame.display.init()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    play(agent, env_id, seed=0)
    assert not pygame.display.get_init()


def test_without_a_display_it_says_so_at_once_and_offers_a_film():
    names = ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY")
    given = {name: value for name, value in os.environ.items() if name not in names}
    code = "import sys; sys.modules['mmc_gym.record'] = None\n"  # nothing slow is loaded
    code += "from mmc_gym.cli import main; main(['play'])"
    done = subprocess.run([sys.executable, "-c", code], env=given, capture_output=True, text=True)
    assert done.returncode != 0
    assert re.search("needs a display, .*no screen.*`mmc-gym record", done.stderr)
