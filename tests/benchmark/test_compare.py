"""Comparisons: equal episodes, the ideal hand, tables, figures and files."""

import io
import json
import math
from functools import partial

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from rich.console import Console

import mmc_gym
from mmc_gym import UserError
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.compare import compare
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.suite import minimum_jerk_episodes
from mmc_gym.measures import episode_seeds, measure_all, run_episodes
from mmc_gym.measures.catalogue import MEASURES, shown_measures
from mmc_gym.network.time_base import minimum_jerk
from mmc_gym.record import record

FIGURES = {"paths_and_profiles.png", "paths_and_profiles.svg"}
FILES = {"episodes.csv", "summary.csv", "summary.json", *FIGURES}


def console(width=120, encoding="utf-8", terminal=False):
    """A console that writes to `console.file.buffer`."""
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding, write_through=True)
    return Console(file=file, width=width, force_terminal=terminal, color_system=None)


def printed(target):
    return target.file.buffer.getvalue().decode(target.encoding)


def test_all_agents_and_an_ideal_hand_have_the_same_starts_and_targets(frozen):
    comparison = compare({"frozen": frozen, "random": "random"}, episodes=5, console=console())
    assert list(comparison.recorded) == ["frozen", "random", REFERENCE]
    assert comparison.episodes.groupby("agent")["success"].mean()[REFERENCE] == 1.0
    assert comparison.training_steps[REFERENCE] == 0
    explained = console()
    comparison.print(explained, explain=True)
    text = " ".join(printed(explained).split())
    assert "without an arm" in text and "without an arm" not in str(comparison)
    columns = ["episode", "seed", "start_x", "start_y", "target_x", "target_y"]
    first, *others = (rows[columns].to_numpy() for _, rows in comparison.episodes.groupby("agent"))
    assert len(np.unique(first[:, -1])) == 5
    for other in others:
        np.testing.assert_array_equal(first, other)
    via = compare({"frozen": frozen}, "MMCReachViaPoints-v0", 2, console=console())
    assert list(via.recorded) == ["frozen"]
    assert "without an arm" not in via.explanation


@pytest.mark.parametrize("agent", ["mmc", "tqc-her"])
def test_agents_that_play_all_at_once_act_as_one_by_one(agent, monkeypatch):
    monkeypatch.setattr("mmc_gym.benchmark.suite.TOGETHER", 8)
    together = compare([agent], episodes=12, seed=3).recorded[agent]
    env = gym.make("MMCReach-v0")
    alone = run_episodes(mmc_gym.make_agent(agent, env), env, episode_seeds(3, 12))
    for episode, other in zip(together, alone, strict=True):
        # A network alone sums in another order than in a batch, so its last bits may differ.
        np.testing.assert_allclose(episode.joint_angles, other.joint_angles, rtol=0, atol=1e-12)
        np.testing.assert_allclose(episode.rewards, other.rewards, rtol=0, atol=1e-12)


def test_a_scenario_is_played_by_its_name():
    by_name = compare(["mmc"], "rotation-30", 3)
    assert by_name.env == "rotation-30"
    other = compare(["mmc"], episodes=3, env_kwargs={"perturbations": ["rotation-30"]})
    for first, second in zip(by_name.recorded["mmc"], other.recorded["mmc"], strict=True):
        np.testing.assert_array_equal(first.hands, second.hands)


def test_the_files_hold_what_was_found_and_are_the_same_for_the_same_seed(tmp_path, frozen):
    agents = {"frozen": frozen, "random": "random"}
    first, second = folders = tmp_path / "a/für Ξ", tmp_path / "b/new"
    for folder in folders:
        narrow = console(width=64, encoding="ascii")
        comparison = compare(agents, episodes=4, seed=5, out=folder, console=narrow)
        assert {path.name for path in folder.iterdir()} == FILES
        assert ("f?r ?" in printed(narrow)) == (folder == first)
    (episodes, again), (summary, other) = (
        [pd.read_csv(folder / f"{name}.csv") for folder in folders]
        for name in ("episodes", "summary")
    )
    same = partial(pd.testing.assert_frame_equal, check_exact=True, check_dtype=False)
    same(again, comparison.episodes)
    assert list(episodes.columns[-len(MEASURES) :]) == list(MEASURES)
    assert len(summary) == 3 * len(MEASURES)
    same(episodes, again)
    same(summary, other)
    for name in ("paths_and_profiles.svg", "summary.json"):
        assert (first / name).read_text() == (second / name).read_text()
    settings = json.loads((second / "summary.json").read_text())
    assert (settings["episodes"], settings["trainings"]) == (4, {"frozen": 1, "random": 1})
    assert settings["training_steps"] == {"frozen": None, "random": 0}


@pytest.mark.parametrize("columns", [64, 80, 120])
def test_the_table_is_ascii_and_fits_where_there_is_no_terminal(columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    agents = ["mmc", "mmc-classical", "mmc-neural", "ik-dls", "random"]
    comparison = compare(agents, episodes=3)
    assert capsys.readouterr().out == ""
    print(comparison)
    out = capsys.readouterr().out
    assert out.isascii() and max(map(len, out.splitlines())) <= columns
    assert " ".join(out.split()).startswith(comparison.headline)
    headers = [line.split() for line in out.splitlines() if line.split()[:1] == ["best"]]
    assert [name for line in headers for name in line if name in agents] == agents
    assert "sum of rewards" in out and "[mass len2/s2]" in out
    assert "NOT over trainings" in " ".join(out.split())


def test_it_is_a_table_its_frame_has_a_row_for_each_agent_and_its_figure_a_column(oracle, frozen):
    still = "50 % <b>_still"
    comparison = compare({"oracle": oracle, still: frozen}, episodes=4)
    assert comparison.headline == f"success at the end: oracle 100.0 %, {still} 0.0 %"
    html = comparison._repr_html_()
    assert html.count('<th scope="row">') > len(shown_measures())
    assert "50 % &lt;b&gt;_still" in html and "<b>_still" not in html
    frame = comparison.to_frame()
    assert list(frame.index) == ["oracle", still, REFERENCE]
    assert list(frame.columns) == list(MEASURES)
    means = comparison.episodes.groupby("agent")["success"].mean()
    assert frame["success"].to_dict() == means.to_dict()
    assert (comparison.to_frame("low") <= comparison.to_frame("high")).loc["oracle", "path_ratio"]
    assert comparison.to_frame("missing").loc[still, "path_ratio"] == 4
    with pytest.raises(UserError, match="value 'mean' is not accepted"):
        comparison.to_frame("mean")
    figure = Figure(figsize=(9, 5))
    assert comparison.plot(figure) is figure
    titles = [axes.get_title().replace("\n", " ") for axes in figure.axes[:3]]
    assert titles == list(frame.index)


def test_your_own_agents_come_first_and_are_compared_with_each_other_one(oracle, frozen):
    terminal = console(width=300, terminal=True)
    comparison = compare(["mmc", oracle, "random"], episodes=20, console=terminal)
    assert comparison.focus == ("Oracle",) and comparison.agents == ["Oracle", "mmc", "random"]
    headline, success, time, *_ = printed(terminal).splitlines()
    assert headline.startswith("success at the end: Oracle 100.0 %, mmc")
    assert success == (
        "Oracle, success at the end: equal to mmc [−16.1, 16.1]; "
        "100.0 points higher than random [83.9, 100.0]"
    )
    ours, theirs = (
        np.median([*map(MEASURES["time_to_target"].of, comparison.recorded[agent])])
        for agent in ("Oracle", "mmc")
    )
    word = "slower" if ours > theirs else "faster"
    assert time.startswith(f"Oracle, time to target: {abs(ours - theirs):.2f} s {word} than mmc [")
    assert "random" not in time  # it never ends there
    assert "[mass len²/s²]" in printed(terminal)  # a terminal gets all signs


def test_any_agents_can_be_in_focus_and_the_first_is_without_your_own():
    agents = ["mmc", "random", "ik-dls"]
    assert compare(agents, episodes=3).focus == ("mmc",)
    comparison = compare(agents, episodes=3, focus=["ik-dls", "random"])
    assert comparison.agents == ["ik-dls", "random", "mmc"]
    first, *_, last = comparison.differences.splitlines()
    assert first.startswith("ik-dls, success at the end: ") and "mmc" in first and "random" in first
    assert last == "random, success at the end: 100.0 points lower than mmc [43.9, 100.0]"
    with pytest.raises(UserError, match="focus must be a name, or several, got <function"):
        compare(["mmc"], episodes=1, focus=lambda: "mmc")


@pytest.mark.parametrize(
    "function",
    [
        compare,
        partial(benchmark, out="never"),
        partial(record, "film.gif"),
        partial(mmc_gym.run_experiment, "rotation-30", out="never"),
    ],
    ids=["compare", "benchmark", "record", "run_experiment"],
)
@pytest.mark.parametrize("wrong", [0.5, 0, "", float, [("a", 1)], {1: 2}])
def test_arguments_of_environments_are_by_name(function, wrong, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="env_kwargs must be a mapping of names to values, got"):
        function(agents=["mmc"], env_kwargs=wrong)
    assert not list(tmp_path.iterdir())


def test_the_hand_goes_straight_to_the_target_by_minimum_jerk_and_rests(make_episode):
    asked = [make_episode(np.zeros((steps, 2)), [1.2, 1.6]) for steps in (101, 31)]
    ideal, short = minimum_jerk_episodes(asked)
    steps = (0.2 + 2.0 / 4) / 0.02
    expected = minimum_jerk(np.arange(101) / steps)[:, None] * [1.2, 1.6]
    assert ideal.hands == pytest.approx(expected, abs=1e-9)
    assert np.array_equal(ideal.hands[:31], short.hands)
    values = measure_all(ideal)
    assert values["success"] == values["success_1_percent"] == values["velocity_peaks"] == 1
    assert values["path_ratio"] == pytest.approx(1)
    assert values["peak_speed"] == pytest.approx(15 / 8 * 2.0 / 0.7, rel=1e-2)
    assert values["minimum_jerk_correlation"] > 0.999
    assert math.isnan(values["joint_effort"]) and math.isnan(values["joint_work"])


def test_it_follows_a_target_that_jumps_whatever_agents_do(frozen, oracle):
    env = gym.make("MMCReachDoubleStep200-v0")
    frozen_ideals, oracle_ideals = (
        minimum_jerk_episodes(run_episodes(agent, env, episode_seeds(1, 5)))
        for agent in (frozen, oracle)
    )
    for ideal, same in zip(frozen_ideals, oracle_ideals, strict=True):
        assert np.array_equal(ideal.hands, same.hands)
        assert ideal.distances[-1] == pytest.approx(0, abs=1e-9)
        turn = np.linalg.norm(np.diff(ideal.hands, 2, axis=0), axis=-1)
        assert turn.max() < 0.1  # no corner: the velocity changes little in a step
    assert minimum_jerk_episodes([]) == ()
