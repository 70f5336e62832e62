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
from mmc_gym._errors import UserError
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.compare import compare
from mmc_gym.benchmark.suite import minimum_jerk_episodes
from mmc_gym.measures import episode_seeds, measure_all, run_episodes
from mmc_gym.measures.catalogue import MEASURES, shown_measures
from mmc_gym.network.time_base import minimum_jerk

FIGURES = {"paths_and_profiles.png", "paths_and_profiles.svg"}
FILES = {"episodes.csv", "summary.csv", "summary.json", *FIGURES}


def console(width=120, encoding="utf-8", terminal=False):
    """A console that writes to `console.file.buffer`."""
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding, write_through=True)
    return Console(file=file, width=width, force_terminal=terminal, color_system=None)


def printed(target):
    return target.file.buffer.getvalue().decode(target.encoding)


def test_all_agents_and_an_ideal_hand_have_the_same_starts_and_targets(frozen):
    found = compare({"frozen": frozen, "random": "random"}, episodes=5, console=console())
    assert list(found.recorded) == ["frozen", "random", REFERENCE]
    assert found.episodes.groupby("agent")["success"].mean()[REFERENCE] == 1.0
    assert found.training_steps[REFERENCE] == 0
    assert "without an arm" in found.explanation and len(found.note) <= 3 * 80
    explained = console()
    found.print(explained, explain=True)
    text = " ".join(printed(explained).split())
    assert "without an arm" in text and "without an arm" not in str(found)
    given = ["episode", "seed", "start_x", "start_y", "target_x", "target_y"]
    first, *others = (one[given].to_numpy() for _, one in found.episodes.groupby("agent"))
    assert len(np.unique(first[:, -1])) == 5
    for other in others:
        np.testing.assert_array_equal(first, other)
    via = compare({"frozen": frozen}, "MMCReachViaPoints-v0", 2, console=console())
    assert list(via.recorded) == ["frozen"]
    assert "without an arm" not in via.explanation


@pytest.mark.parametrize("agent", ["mmc", "tqc-her"])
def test_agents_that_play_all_at_once_act_as_one_by_one(agent, monkeypatch):
    monkeypatch.setattr("mmc_gym.benchmark.suite.TOGETHER", 8)
    found = compare([agent], episodes=12, seed=3).recorded[agent]
    made = gym.make("MMCReach-v0")
    alone = run_episodes(mmc_gym.make_agent(agent, made), made, episode_seeds(3, 12))
    for one, other in zip(found, alone, strict=True):
        # A network alone sums in another order than in a batch, so its last bits may differ.
        np.testing.assert_allclose(one.joint_angles, other.joint_angles, rtol=0, atol=1e-12)
        np.testing.assert_allclose(one.rewards, other.rewards, rtol=0, atol=1e-12)


def test_a_scenario_is_played_by_its_name():
    found = compare(["mmc"], "rotation-30", 3)
    assert found.env == "rotation-30"
    other = compare(["mmc"], episodes=3, env_kwargs={"perturbations": ["rotation-30"]})
    for one, two in zip(found.recorded["mmc"], other.recorded["mmc"], strict=True):
        np.testing.assert_array_equal(one.hands, two.hands)
    with pytest.raises(UserError, match="did you mean 'rotation"):
        compare(["mmc"], "rotaton-30", 3)


def test_the_files_hold_what_was_found_and_are_the_same_for_the_same_seed(tmp_path, frozen):
    agents = {"frozen": frozen, "random": "random"}
    for folder in ("a/new", "b/new"):
        counts = {"episodes": np.int64(4), "seed": np.int64(5)}
        found = compare(agents, **counts, out=tmp_path / folder, console=console())
        assert {path.name for path in (tmp_path / folder).iterdir()} == FILES
    (episodes, again), (summary, other) = (
        [pd.read_csv(tmp_path / folder / "new" / f"{name}.csv") for folder in "ab"]
        for name in ("episodes", "summary")
    )
    same = partial(pd.testing.assert_frame_equal, check_exact=True, check_dtype=False)
    same(again, found.episodes)
    assert list(episodes.columns[-len(MEASURES) :]) == list(MEASURES)
    assert len(summary) == 3 * len(MEASURES)
    same(episodes, again)
    same(summary, other)
    for name in ("paths_and_profiles.svg", "summary.json"):
        first, second = (tmp_path / folder / "new" / name for folder in "ab")
        assert first.read_text() == second.read_text()
    settings = json.loads(second.read_text())
    assert (settings["episodes"], settings["trainings"]) == (4, {"frozen": 1, "random": 1})
    assert settings["training_steps"] == {"frozen": None, "random": 0}


def test_the_table_is_ascii_and_fits_where_there_is_no_terminal(capsys, monkeypatch):
    agents = ["mmc", "mmc-classical", "mmc-neural", "ik-dls", "random"]
    comparison = compare(agents, episodes=5)
    assert capsys.readouterr().out == ""
    for columns in (120, 80):
        print(comparison)
        out = capsys.readouterr().out
        assert out.isascii()
        assert max(map(len, out.splitlines())) <= columns
        assert " ".join(out.split()).startswith(comparison.headline)
        header = next(line for line in out.splitlines() if line.split()[:1] == ["best"])
        assert header.split()[1:3] == agents[:2]
        assert all(agent in out for agent in agents)
        assert "sum of rewards" in out and "[mass len2/s2]" in out
        assert "NOT over trainings" in " ".join(out.split())
        monkeypatch.setenv("COLUMNS", "80")


def test_it_is_a_table_its_frame_has_a_row_for_each_agent_and_its_figure_a_column(oracle, frozen):
    still = "50 % <b>_still"
    found = compare({"oracle": oracle, still: frozen}, episodes=4)
    assert found.headline == f"success at the end: oracle 100.0 %, {still} 0.0 %"
    html = found._repr_html_()
    assert html.count('<th scope="row">') > len(shown_measures())
    assert "50 % &lt;b&gt;_still" in html and "<b>_still" not in html
    assert 'success at the end<div class="note">[fraction]</div>' in html and "\\n" not in html
    frame = found.to_frame()
    assert list(frame.index) == ["oracle", still, REFERENCE]
    assert list(frame.columns) == list(MEASURES)
    means = found.episodes.groupby("agent")["success"].mean()
    assert frame["success"].to_dict() == means.to_dict()
    assert (found.to_frame("low") <= found.to_frame("high")).loc["oracle", "path_ratio"]
    assert found.to_frame("missing").loc[still, "path_ratio"] == 4
    with pytest.raises(UserError, match="value 'mean' is not accepted"):
        found.to_frame("mean")
    titles = [axes.get_title() for axes in found.plot().axes[:3]]
    assert [title.replace("\n", " ") for title in titles] == list(frame.index)
    given = Figure(figsize=(9, 5))
    assert found.plot(given) is given
    assert [axes.get_title() for axes in given.axes[:3]] == titles


def test_your_own_agents_come_first_and_are_compared_with_each_other_one(oracle, frozen):
    terminal = console(width=300, terminal=True)
    found = compare(["mmc", oracle, "random"], episodes=20, console=terminal)
    assert found.focus == ("Oracle",) and found.agents == ["Oracle", "mmc", "random"]
    headline, success, time, *_ = printed(terminal).splitlines()
    assert headline.startswith("success at the end: Oracle 100.0 %, mmc")
    assert success == (
        "Oracle, success at the end: equal to mmc [−16.1, 16.1]; "
        "100.0 points higher than random [83.9, 100.0]"
    )
    ours, theirs = (
        np.median([MEASURES["time_to_target"].of(one) for one in found.recorded[agent]])
        for agent in ("Oracle", "mmc")
    )
    word = "slower" if ours > theirs else "faster"
    assert time.startswith(f"Oracle, time to target: {abs(ours - theirs):.2f} s {word} than mmc [")
    assert "random" not in time  # it never ends there
    assert "[mass len²/s²]" in printed(terminal)  # a terminal gets all signs


def test_any_agents_can_be_in_focus_and_the_first_is_without_your_own():
    found = compare(["mmc", "random", "ik-dls"], episodes=3)
    assert found.focus == ("mmc",)
    found = compare(["mmc", "random", "ik-dls"], episodes=3, focus=["ik-dls", "random"])
    assert found.agents == ["ik-dls", "random", "mmc"]
    first, *_, last = found.differences.splitlines()
    assert first.startswith("ik-dls, success at the end: ") and "mmc" in first and "random" in first
    assert last == "random, success at the end: 100.0 points lower than mmc [43.9, 100.0]"
    with pytest.raises(UserError, match="did you mean 'ik-dls'"):
        compare(["mmc", "ik-dls"], focus="ik-dsl")


def test_agents_that_do_not_fit_and_names_that_the_encoding_lacks_are_no_loss(tmp_path, frozen):
    narrow, out = console(width=64, encoding="ascii"), tmp_path / "für Ξ"
    agents = {f"agent {number}": frozen for number in range(4)}
    compare(agents, episodes=2, out=out, console=narrow)
    assert {path.name for path in out.iterdir()} == FILES
    assert "f?r ?" in printed(narrow)
    lines = [line for line in printed(narrow).splitlines() if not line.startswith("wrote")]
    assert sum("success at the end " in line for line in lines) > 1
    for agent in agents:
        assert sum(line.startswith(" ") and agent in line for line in lines) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"agents": ["mmc", "nobody"]}, "'nobody' is not accepted"),
        ({"agents": ["mmc"], "out": __file__}, "out must be a folder"),
        ({"agents": ["mmc"], "env": "NoSuchEnv-v0"}, "env must be .*'NoSuchEnv-v0'"),
        ({"agents": ["mmc"], "env": "CartPole-v1"}, "env must be .*, got CartPole-v1"),
        ({"agents": {"mine": len}, "env": "CartPole-v1"}, r"info\['end_effector'\]"),
    ],
)
def test_mistakes_are_refused_before_anything_runs(arguments, message, monkeypatch):
    monkeypatch.setattr("mmc_gym.benchmark.compare.play_episodes", None)
    with pytest.raises(ValueError, match=message):
        compare(**arguments)


def test_the_hand_goes_straight_to_the_target_by_minimum_jerk_and_rests(make_episode):
    (ideal,) = minimum_jerk_episodes([make_episode(np.zeros((101, 2)), [1.2, 1.6])])
    steps = (0.2 + 2.0 / 4) / 0.02
    expected = minimum_jerk(np.arange(101) / steps)[:, None] * [1.2, 1.6]
    assert ideal.hands == pytest.approx(expected, abs=1e-9)
    found = measure_all(ideal)
    assert found["success"] == found["success_1_percent"] == found["velocity_peaks"] == 1
    assert found["path_ratio"] == pytest.approx(1)
    assert found["peak_speed"] == pytest.approx(15 / 8 * 2.0 / 0.7, rel=1e-2)
    assert found["minimum_jerk_correlation"] > 0.999
    for name in ("joint_effort", "joint_work"):
        assert math.isnan(found[name])


def test_the_ideal_hand_does_not_depend_on_what_agents_do(env, oracle, frozen):
    seeds = episode_seeds(0, 5)
    one = minimum_jerk_episodes(run_episodes(oracle, env, seeds))
    other = minimum_jerk_episodes(run_episodes(frozen, env, seeds))
    for first, second in zip(one, other, strict=True):
        assert np.array_equal(first.hands, second.hands)


def test_it_follows_a_target_that_jumps_in_episodes_of_any_length(frozen, make_episode):
    env = gym.make("MMCReachDoubleStep200-v0")
    for ideal in minimum_jerk_episodes(run_episodes(frozen, env, episode_seeds(1, 5))):
        assert ideal.distances[-1] == pytest.approx(0, abs=1e-9)
        turn = np.linalg.norm(np.diff(ideal.hands, 2, axis=0), axis=-1)
        assert turn.max() < 0.1  # no corner: the velocity changes little in a step
    asked = [make_episode(np.zeros((steps, 2)), [2.0, 0.0]) for steps in (101, 31)]
    long, short = minimum_jerk_episodes(asked)
    assert np.array_equal(long.hands[:31], short.hands)
    assert minimum_jerk_episodes([]) == ()
