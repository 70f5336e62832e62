"""Films of an agent at work."""

import sys
from types import SimpleNamespace
from unittest.mock import Mock

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image, ImageSequence

from mmc_gym import UserError
from mmc_gym.cli import main
from mmc_gym.measures import episode_seeds
from mmc_gym.record import record

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
    film = [np.frombuffer(one, np.uint8).reshape(640, 640, 3) for one in frames]
    assert len(film) == 21 + 50
    for number in (0, 12):
        assert np.abs(film[number].astype(int) - pictures[number]).mean() < 4.0


def test_several_agents_are_side_by_side_under_their_names(tmp_path, pictures):
    agents = {"one": TURNER, "two": TURNER}
    path = record(tmp_path / "film.gif", agents, seed=3, env_kwargs=STEPS, every=4)
    with Image.open(path) as film:
        assert film.size == (640, 352) and film.info["duration"] == 80  # ms
        frames = [np.asarray(one.convert("RGB"), int) for one in ImageSequence.Iterator(film)]
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
    assert [one.read_bytes() for one in tmp_path.iterdir()] == [b"the old one"]


def test_the_command_names_the_file_and_a_missing_extra(tmp_path, monkeypatch, capsys):
    steps = ["--env-kwargs", "max_episode_steps=5"]
    main(["record", "--agents", "ik-dls", *steps, "--out", str(tmp_path / "film.gif")])
    assert capsys.readouterr() == (f"wrote {tmp_path / 'film.gif'}\n", "")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UserError, match=r'pip install "mmc-gym\[video\]"'):
        record("film.mp4")
