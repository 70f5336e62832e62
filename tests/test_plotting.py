from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit

from mmc_gym._plotting import paths_and_profiles, save_figure
from mmc_gym.measures.rollout import run_episodes


@pytest.fixture
def episodes(env, oracle, frozen):
    return {
        "oracle": run_episodes(oracle, env, [1, 2, 3]),
        "frozen": run_episodes(frozen, env, [1, 2, 3]),
    }


def test_the_figure_has_paths_above_profiles_and_a_column_for_each_agent(episodes):
    figure = paths_and_profiles(episodes, 3.0)
    above, below = figure.axes[:2], figure.axes[2:]
    assert [axes.get_title() for axes in above] == ["oracle", "frozen"]
    assert all(axes.get_aspect() == 1 for axes in above)
    assert above[0].get_ylabel() == "y [segment lengths]"
    assert "segment lengths/s" in below[0].get_ylabel()
    assert all(axes.get_xlabel() == "time [s]" for axes in below)


def test_paths_are_told_apart_without_colour(episodes):
    axes = paths_and_profiles(episodes, 3.0).axes[0]
    paths = [line for line in axes.lines if len(line.get_xdata()) > 1]
    assert len({line.get_linestyle() for line in paths}) == 3
    assert [text.get_text() for text in axes.texts] == ["1", "2", "3"]
    assert np.array_equal(paths[0].get_xydata(), episodes["oracle"][0].hands)


def test_the_profile_is_the_median_speed_in_the_middle_of_the_steps(episodes):
    axes = paths_and_profiles(episodes, 3.0).axes[2]
    (line,) = axes.lines
    hands = np.array([episode.hands for episode in episodes["oracle"]])
    speeds = np.linalg.norm(np.diff(hands, axis=1), axis=-1) / 0.02
    assert line.get_xdata() == pytest.approx(0.01 + 0.02 * np.arange(100))
    assert line.get_ydata() == pytest.approx(np.median(speeds, axis=0))


def test_episodes_may_differ_in_length(env, oracle):
    short = run_episodes(oracle, TimeLimit(env.unwrapped, 40), [1])
    figure = paths_and_profiles({"oracle": (*run_episodes(oracle, env, [2]), *short)}, 3.0)
    (line,) = figure.axes[1].lines
    assert np.isfinite(line.get_ydata()).all() and len(line.get_ydata()) == 100


def test_both_files_are_complete_and_the_same_figure_gives_the_same_file(episodes, tmp_path):
    figure = paths_and_profiles(episodes, 3.0)
    png, svg = save_figure(figure, tmp_path / "a")
    assert png.read_bytes().startswith(b"\x89PNG") and b"IEND" in png.read_bytes()[-12:]
    assert ElementTree.parse(svg).getroot().tag.endswith("svg")
    again = save_figure(paths_and_profiles(episodes, 3.0), tmp_path / "b")[1]
    assert again.read_text() == svg.read_text()


def test_the_global_settings_of_matplotlib_stay_as_they_were(episodes, tmp_path):
    import matplotlib

    before = dict(matplotlib.rcParams)
    save_figure(paths_and_profiles(episodes, 3.0), tmp_path / "a")
    assert dict(matplotlib.rcParams) == before
