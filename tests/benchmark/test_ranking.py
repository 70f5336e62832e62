"""Agents are ranked by success, each environment weighing the same; copies tie."""

import io

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.ranking import RANKING, print_ranking, rank_agents
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.store import CellKey, NotPlayed, update_manifest
from mmc_gym.measures.words import control_note, other_controls


def rows_of(agent, environment, times, training_seed=None):
    """Episodes of 2 s with these times to target, NaN for those without success."""
    times = np.array(times, dtype=np.float64)
    values = {"agent": agent, "environment": environment, "instance": range(len(times))}
    values["training_seed"] = pd.array([training_seed] * len(times), "Int64")
    success = (~np.isnan(times)).astype(float)
    return pd.DataFrame({**values, "duration": 2.0, "success": success, "time_to_target": times})


def summary(*frames, **arguments):
    return rank_agents(pd.concat(frames), resamples=200, **arguments).set_index("agent")


NAN = float("nan")


def test_environments_weigh_the_same():
    ranking = summary(
        rows_of("mmc", "large", [0.5] * 20),
        rows_of("mmc", "small", [NAN, NAN]),
        rows_of("other", "large", [0.5] * 12 + [NAN] * 8),
        rows_of("other", "small", [0.5] * 2),
    )
    assert ranking.index.tolist() == ["other", "mmc"]
    assert ranking["success"].tolist() == pytest.approx([0.8, 0.5])
    columns = ["rank", "environments", "instances"]
    assert ranking[columns].to_numpy().tolist() == [[1, 2, 22], [2, 2, 22]]


def test_agents_of_another_control_mode_are_ranked_below_by_themselves():
    times = {"mmc": [0.4, NAN], "ppo": [0.5, NAN], "torque": [0.3, 0.3], "ideal torque": [0.2, 0.2]}
    controls = dict.fromkeys(times, "joint_torque") | dict.fromkeys(["mmc", "ppo"], "joint_delta")
    reflex = rows_of("reflex", "one", [0.1, 0.1])
    frames = [rows_of(agent, "one", of) for agent, of in times.items()]
    ranking = summary(*frames, reflex, controls={**controls, "reflex": "joint_delta"})
    assert ranking["rank"].to_dict() == {
        **{"reflex": 1, "mmc": 2, "ppo": 3},
        **{"ideal torque": 1, "torque": 2},
    }


def test_what_did_not_act_is_ranked_last_of_those_that_did():
    """However many did not: they have no control mode."""
    controls = {"mmc": "joint_delta", "ppo": "joint_delta", "her": "", "other": "", "third": ""}
    frames = (rows_of("mmc", "one", [0.4, 0.4]), rows_of("ppo", "one", [NAN, 0.4]))
    lost = [CellKey(agent, None, "one") for agent in ("her", "other", "third")]
    ranking = summary(*frames, not_played=lost, controls=controls)
    assert ranking["rank"].tolist() == [1, 2, 3, 3, 3]
    assert ranking.index.tolist()[:2] == ["mmc", "ppo"]
    assert other_controls(controls) == {}
    assert control_note({"her": "", **controls}) == "All act by joint_delta."


def test_a_copy_ties_with_itself():
    times = [0.4, 0.8, NAN, 1.2]
    ranking = summary(
        *(rows_of(agent, "one", times) for agent in ("mmc", "twin")),
        rows_of("slower", "one", [0.6, 0.9, NAN, 1.4]),
    )
    assert ranking["rank"].to_dict() == {"mmc": 1, "twin": 1, "slower": 3}
    assert ranking.loc["twin", "improvement"] == 0.5
    numbers = ranking.drop(columns="rank")
    pd.testing.assert_series_equal(numbers.loc["twin"], numbers.loc["mmc"], check_names=False)
    assert ranking.loc["slower", "improvement"] == 0.125  # loses three, and ties at one failure
    assert ranking["training_seeds"].tolist() == [0, 0, 0]


def test_times_that_an_environment_does_not_report_are_left_out():
    timed = [rows_of(agent, "timed", [0.5, NAN, 0.7]) for agent in ("mmc", "other")]
    untold = [rows_of(agent, "untold", [NAN] * 3) for agent in ("mmc", "other")]
    untold[0]["success"] = 1.0
    alone, both = summary(*untold), summary(*timed, *untold)
    assert alone[["settled", "settled_low", "improvement", "time_to_target"]].isna().all(axis=None)
    expected = summary(*timed)[["settled", "settled_low", "improvement"]]
    pd.testing.assert_frame_equal(both[expected.columns], expected.loc[both.index])


def test_what_was_not_played_has_no_success():
    frames = [rows_of("mmc", name, [0.5, NAN, NAN, NAN]) for name in ("one", "two")]
    broken = [CellKey("broken", None, name) for name in ("one", "two")]
    half = rows_of("half", "one", [0.5] * 4)
    ranking = summary(*frames, half, not_played=[*broken, CellKey("half", None, "two")])
    assert ranking["rank"].to_dict() == {"half": 1, "mmc": 2, "broken": 3}
    assert ranking["success"].to_dict() == {"half": 0.5, "mmc": 0.25, "broken": 0.0}
    assert ranking["not_played"].to_dict() == {"half": 1, "mmc": 0, "broken": 2}
    alone = summary(*frames, not_played=broken)
    assert alone.loc["broken", "improvement"] == 0.375
    with pytest.raises(ValueError, match="no scenario that all agents have attempted"):
        summary(rows_of("mmc", "one", [0.5]), rows_of("other", "two", [0.5]))


def test_training_seeds_are_replicates():
    frames = [rows_of("ppo", "one", [0.5 + 0.1 * seed] * 4, seed) for seed in range(3)]
    ranking = summary(rows_of("mmc", "one", [0.65] * 4), *frames)
    assert ranking["training_seeds"].to_dict() == {"mmc": 0, "ppo": 3}
    assert ranking.loc["ppo", "improvement"] == pytest.approx(2 / 3)
    assert ranking.loc["ppo", "settled_low"] < ranking.loc["ppo", "settled_high"]


def test_the_ideal_hand_is_not_ranked_and_no_baseline_is_no_comparison():
    ranking = summary(rows_of("other", "one", [0.5]), rows_of(REFERENCE, "one", [0.4]))
    assert ranking.index.tolist() == ["other"]
    assert np.isnan(ranking.loc["other", "improvement"])
    assert ranking.loc["other", "settled"] == 0.75  # from 0.5 s to the end, at 2 s


def test_a_ranking_fits_80_columns_with_names_and_intervals_whole(tmp_path):
    console = Console(file=io.StringIO(), width=80)
    manifest = benchmark(["mmc", "mmc-classical"], tmp_path, ["random"], episodes=2, jobs=1)
    key = CellKey("mmc", None, "pursuit")
    lost = [NotPlayed(**key._asdict(), status="failed", reason="died")]
    update_manifest(tmp_path, lambda _: manifest.model_copy(update={"not_played": lost}))
    print_ranking(console, tmp_path)
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    (row,) = [line for line in lines if " mmc-classical " in line]
    assert lines[lines.index(row) + 1].count("]") == 3
    assert "failed: mmc in pursuit: died" in lines[-1]
    assert set(pd.read_csv(tmp_path / RANKING)["agent"]) == {"mmc", "mmc-classical"}
