"""Films of an agent at work, and what mouse and keys do to target and arm in its window."""

import math
import os
import re
import subprocess
import sys
from itertools import islice
from types import SimpleNamespace
from unittest.mock import Mock

import gymnasium as gym
import numpy as np
import pygame
import pytest
from PIL import Image, ImageSequence

import mmc_gym
from mmc_gym import UserError, make_agent
from mmc_gym.cli import main
from mmc_gym.envs.render import SIZE, View
from mmc_gym.measures import episode_seeds
from mmc_gym.record import frames, play, record

ACTION = np.array([0.3, 0, 0], np.float32)  # turns the first joint
TURNER = SimpleNamespace(predict=lambda *_, **__: (ACTION, None))
STEPS = {"max_episode_steps": 20}


@pytest.fixture(scope="module")
def pictures():
    """Pictures of the first two episodes that `compare` plays."""
    env = gym.make("MMCReach-v0", render_mode="rgb_array", **STEPS)
    shown = []
    for seed in episode_seeds(3, 2):
        env.reset(seed=seed)
        shown.append(env.render())
        for _ in range(20):
            env.step(ACTION)
            shown.append(env.render())
    return shown


def test_a_gif_shows_every_step_of_the_episodes_of_compare(tmp_path, pictures):
    path = record(tmp_path / "film.gif", TURNER, episodes=2, seed=3, env_kwargs=STEPS)
    frames, ends = [], []
    with Image.open(path) as film:
        assert film.info["loop"] == 0  # for ever
        for frame in ImageSequence.Iterator(film):  # alike ones are one, shown for longer
            frames.append(np.asarray(frame.convert("RGB"), int))
            ends.append((ends or [0])[-1] + frame.info["duration"])
    assert ends[-1] == 20 * len(pictures) + 2 * 1000  # each end is held for a second
    for number, held in ((0, 0), (12, 0), (21, 1000), (41, 1000)):
        shown = frames[np.searchsorted(ends, 20 * number + held, side="right")]
        assert np.abs(shown - pictures[number]).mean() < 1.0  # of 256; it has but 256 colours


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # of ffmpeg's pipes, by imageio
def test_an_mp4_has_the_rate_of_the_environment(tmp_path, pictures):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = record(tmp_path / "film.mp4", TURNER, seed=3, env_kwargs=STEPS)
    frames = ffmpeg.read_frames(str(path))
    facts = next(frames)
    assert (facts["fps"], facts["size"], facts["codec"]) == (50, (640, 640), "h264")
    film = [np.frombuffer(frame, np.uint8).reshape(640, 640, 3) for frame in frames]
    assert len(film) == 21 + 50
    for number in (0, 12):
        assert np.abs(film[number].astype(int) - pictures[number]).mean() < 4.0


def test_several_agents_are_side_by_side_under_their_names(tmp_path, pictures):
    agents = {"one": TURNER, "two": TURNER}
    path = record(tmp_path / "film.gif", agents, seed=3, env_kwargs=STEPS, every=4)
    with Image.open(path) as film:
        assert film.size == (640, 352) and film.info["duration"] == 80  # ms
        frames = [np.asarray(frame.convert("RGB"), int) for frame in ImageSequence.Iterator(film)]
    left, right = np.split(frames[-1], 2, axis=1)
    alone = np.asarray(Image.fromarray(pictures[20]).reduce(2), int)[12:]  # without its caption
    for half in (left, right):
        assert np.abs(half[-len(alone) :] - alone).mean() < 1.0
    assert (left[:40] != right[:40]).any()  # their names


def test_a_film_that_fails_leaves_the_old_one(tmp_path):
    fails = Mock(predict=Mock(side_effect=[(ACTION, None)] * 2 + [RuntimeError("lost")]))
    path = tmp_path / "film.gif"
    path.write_bytes(b"the old one")
    with pytest.raises(RuntimeError, match="lost"):
        record(path, fails)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"the old one"]


def test_the_command_names_the_file_and_a_missing_extra(tmp_path, monkeypatch, capsys):
    steps = ["--env-kwargs", "max_episode_steps=5"]
    main(["record", "--agents", "ik-dls", *steps, "--out", str(tmp_path / "film.gif")])
    assert capsys.readouterr() == (f"wrote {tmp_path / 'film.gif'}\n", "")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UserError, match=r'pip install "mmc-gym\[video\]"'):
        record("film.mp4")


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
    environment = {name: value for name, value in os.environ.items() if name not in names}
    code = "import sys; sys.modules['mmc_gym.record'] = None\n"  # nothing slow is loaded
    code += "from mmc_gym.cli import main; main(['play'])"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode != 0
    assert re.search("needs a display, .*no screen.*`mmc-gym record", done.stderr)
