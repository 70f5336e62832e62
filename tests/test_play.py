"""Play: what mouse and keys do to target, agent and time."""

import math
import os
import re
import subprocess
import sys
from unittest.mock import Mock

import numpy as np
import pygame
import pytest

import mmc_gym
from mmc_gym._errors import UserError
from mmc_gym.agents import AGENTS
from mmc_gym.envs.render import SIZE, View
from mmc_gym.play import Game, play


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
    env = mmc_gym.make(name, render_mode="rgb_array", max_episode_steps=-1)
    yield env
    env.close()
    pygame.display.quit()


@pytest.fixture
def agents():
    return {"first": Recorder(), "second": Recorder()}


@pytest.fixture
def game(env, agents):
    makers = {name: Mock(return_value=agent) for name, agent in agents.items()}
    lost = Mock(side_effect=ValueError("weights must exist\nsecond line"))
    return Game(env, {**makers, "lost": lost}, "first", seed=0)


def press(*keys):
    for key in keys:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))


def point_at(x, y):
    pygame.event.post(pygame.event.Event(pygame.MOUSEMOTION, pos=(x, y)))


@pytest.mark.parametrize("env", ["random", "obstacles", "rotation-45", "longer-50"], indirect=True)
def test_the_mouse_points_at_what_the_picture_shows_and_the_hand_can_reach(env, game):
    view = View(env.unwrapped.setup.farthest)
    point_at(*view.pixel((-0.5, 1.5)))
    game.frame()
    *_, info = env.step(np.zeros(3, np.float32))
    assert tuple(info["target"]) == tuple(game.target) == pytest.approx((-0.5, 1.5))
    if env.unwrapped.setup.body.obstacles:
        point_at(*view.pixel((1.5, 1.0)))  # in the middle of one
        game.frame()
        assert game.target == pytest.approx((-0.5, 1.5))
    for corner in ((0, 0), (SIZE - 1, 5), (10, SIZE + 60)):
        point_at(*corner)
        game.frame()
        assert env.unwrapped.setup.workspace.contains(game.target)
        assert math.atan2(*game.target) == pytest.approx(math.atan2(*view.point(corner)))


@pytest.mark.parametrize("env", ["rotation-45", "pursuit"], indirect=True)
def test_the_distance_is_that_of_the_cursor_and_to_a_target_that_moves(env, game, monkeypatch):
    step, returned = env.step, []
    monkeypatch.setattr(env, "step", lambda action: returned.append(step(action)) or returned[-1])
    for _ in range(20):
        game.frame()
    *_, info = returned[-1]
    assert f"first    distance {info['distance']:.2f}    hand speed " in game._measures()


def test_there_is_no_time_limit(game, agents):
    for _ in range(250):
        game._step()
    assert agents["first"].calls == [(None, True)] + [(step, False) for step in range(1, 250)]


@pytest.mark.parametrize("key", [pygame.K_2, pygame.K_TAB])
def test_keys_hand_the_arm_to_another_agent(game, agents, key):
    for _ in range(3):
        game.frame()
    press(key)
    game.frame()
    assert game.agent == "second"
    assert agents["second"].calls == [(None, True)]
    assert len(agents["first"].calls) == 3
    press(pygame.K_1)
    game.frame()
    assert agents["first"].calls[-1] == (None, True)  # it starts anew, from the present posture


def test_keys_of_no_agent_or_of_one_that_cannot_be_made_leave_it(game):
    for keys, agent, message in (
        ((pygame.K_9, pygame.K_0, pygame.K_x), "first", ""),
        ((pygame.K_3,), "first", "lost: weights must exist"),
        ((pygame.K_2,), "second", ""),
    ):
        press(*keys)
        game.frame()
        assert (game.agent, game.message, game.running) == (agent, message, True)


def test_space_stops_time_but_not_the_target(game, agents):
    game.frame()
    press(pygame.K_SPACE)
    game.frame()
    before = pygame.surfarray.array3d(pygame.display.get_surface())
    point_at(400, 200)
    game.frame()
    assert len(agents["first"].calls) == 1
    assert game.target == pytest.approx(View(3.0).point((400, 200)))
    assert (pygame.surfarray.array3d(pygame.display.get_surface()) != before).any()
    press(pygame.K_SPACE)
    game.frame()
    assert len(agents["first"].calls) == 2


def test_r_draws_a_new_posture_and_keeps_the_target(game, agents):
    point_at(250, 180)
    game.frame()
    target, hand = game.target, game._hand
    press(pygame.K_r)
    game.frame()
    assert game.target == target
    assert math.dist(hand, game._hand) > 0.1
    assert agents["first"].calls[-1] == (None, True)


def test_the_seed_gives_the_posture(env):
    hands = [Game(env, {"only": Recorder}, "only", seed)._hand.tolist() for seed in (1, 1, 2)]
    assert hands[0] == hands[1] != hands[2]


@pytest.mark.parametrize("key", [pygame.K_q, pygame.K_ESCAPE])
def test_it_ends_when_asked_to(game, key):
    press(key)
    game.run()
    assert not game.running


@pytest.mark.parametrize(
    ("agent", "env_id"), [("mmc", "MMCReach-v0"), ("ppo-torque", "MMCReachGoal-v0")]
)
def test_a_window_that_its_user_closes_is_closed(agent, env_id):
    pygame.display.init()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    play(agent, env_id, seed=0)
    assert not pygame.display.get_init()


def test_an_agent_follows_the_mouse(env):
    game = Game(env, {"mmc": lambda: AGENTS["mmc"].make(env)}, "mmc", seed=0)
    point_at(450, 200)
    for _ in range(60):
        game.frame()
    assert math.dist(game._hand, game.target) < 0.05


def test_without_a_display_it_says_so_at_once_and_offers_a_film():
    names = ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY")
    given = {name: value for name, value in os.environ.items() if name not in names}
    code = "import sys; sys.modules['mmc_gym.play'] = None\n"  # nothing slow is loaded
    code += "from mmc_gym.cli import main; main(['play'])"
    done = subprocess.run([sys.executable, "-c", code], env=given, capture_output=True, text=True)
    assert done.returncode != 0
    assert re.search("needs a display, .*no screen.*`mmc-gym record", done.stderr)


def test_what_cannot_be_played_is_refused():
    for arguments in (("nobody",), ("mmc", "Pendulum-v1"), ("mmc", "MMCReachNowhere-v0")):
        with pytest.raises(UserError, match=r"'nobody' is not accepted|env must be a reaching"):
            play(*arguments)
    assert not pygame.display.get_init()


def test_the_names_of_all_agents_fit_into_the_window(env):
    game = Game(env, dict.fromkeys(AGENTS, Recorder), next(iter(AGENTS)), seed=0)
    width, height = pygame.display.get_surface().get_size()
    for game.agent in AGENTS:
        names = game._agents_line()
        assert names.get_width() <= width
        assert SIZE + names.get_height() <= game._text_top < height
