"""The registry of measures, all of them at once, and those of users in all that shows any."""

import json
import math

import numpy as np
import pandas as pd
import pytest

from mmc_gym import UserError
from mmc_gym._files import import_modules
from mmc_gym._identity import identity
from mmc_gym.benchmark.compare import compare
from mmc_gym.benchmark.store import read_episodes, read_manifest
from mmc_gym.measures import MEASURES, catalogue, leave_out_failures, measure, measure_all
from mmc_gym.network.time_base import minimum_jerk
from mmc_gym.report import write_report
from tests.processes import run_python

pytestmark = pytest.mark.usefixtures("forget_what_is_registered")


def register_half_way_time():
    @measure(label="half-way time", unit="s", best="low", decimals=2, successes_only=True)
    def half_way_time(episode):
        halfway = episode.distances[0] / 2
        return int((episode.distances <= halfway).argmax()) * episode.control_step

    return half_way_time


def test_a_measure_of_your_own_is_one_decorated_function(make_episode):
    function = register_half_way_time()
    episode = make_episode([[0, 0], [0.4, 0], [0.6, 0], [1, 0]], [1, 0])
    assert measure_all(episode)["half_way_time"] == function(episode) == 0.04
    half_way = MEASURES["half_way_time"]
    assert (half_way.label, half_way.unit) == ("half-way time", "s")
    assert (half_way.best, half_way.statistic) == ("low", "median")
    assert list(MEASURES)[-1] == "half_way_time" and catalogue.own_measures() == (half_way,)
    register_half_way_time()  # as a notebook does that runs a cell twice
    assert len(catalogue.own_measures()) == 1


@pytest.mark.parametrize(
    ("name", "facts", "message"),
    [
        ("success", {}, "got 'success': mmc_gym.measures.reaching.success has it"),
        ("target_x", {}, "got 'target_x': a column of the data has it"),
        ("new", {"best": "highest"}, r"best of 'new' must be one of \(.*got 'high"),
        ("new", {"statistic": "mode"}, r"statistic of 'new' must .* got 'mode'"),
    ],
)
def test_names_that_are_taken_and_unknown_facts_are_refused(name, facts, message):
    function = type(name, (), {})  # anything that has a name
    with pytest.raises(ValueError, match=message):
        measure(label="x", **facts)(function)


@pytest.mark.parametrize("value", [[0.1, 0.2], "far", 1j])
def test_a_measure_that_returns_no_number_is_named(value, make_episode):
    measure(label="x")(of_my_own := lambda episode: value)
    with pytest.raises(UserError, match="what measure '<lambda>' returns must be a number, got"):
        measure_all(make_episode([[0, 0], [1, 0]], [1, 0]))
    assert MEASURES["<lambda>"].of is of_my_own


@pytest.mark.parametrize("wrong", [(len,), ()], ids=["no brackets", "no label"])
def test_a_decorator_that_is_used_wrongly_says_how_it_is_used(wrong):
    with pytest.raises(UserError, match=r"used as @measure\(.*label=.*, got"):
        measure(*wrong)


def test_a_store_knows_measures_whose_functions_are_not_here():
    register_half_way_time()
    (half_way,) = catalogue.own_measures()
    facts = json.loads(json.dumps(half_way.facts))
    del MEASURES[half_way.name]
    known = catalogue.measures_of({half_way.name: facts, "success": "fraction"})
    assert (known[half_way.name], list(known)) == (half_way, [*MEASURES, half_way.name])
    with pytest.raises(RuntimeError, match="its function is not loaded"):
        known[half_way.name].of(None)


def test_another_function_or_another_unit_is_another_measure(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    code = "from mmc_gym.measures import measure\n@measure(label='x', unit='{}')\n"
    code += "def x(episode): return {}\n"
    identities = []
    for number, facts in enumerate([("s", 0.0), ("s", 1.0), ("rad", 1.0)]):
        (tmp_path / f"measures_{number}.py").write_text(code.format(*facts))
        import_modules([f"measures_{number}"])
        measure_x = MEASURES.pop("x")
        identities.append(identity(measure_x.facts, measure_x.of))
    assert len(set(identities)) == 3 and identities[2] == identity(measure_x.facts, measure_x.of)
    with pytest.raises(ValueError, match="module 'nobody' cannot be imported"):
        import_modules(["nobody"])


@pytest.mark.parametrize(
    ("name", "value", "number", "unit"),
    [
        ("success", 0.975, "97.5", " %"),
        ("success", 0.0001, "<0.1", " %"),
        ("final_distance", 0.01234, "0.012", " lengths"),
        ("sparc", -1.414, "−1.41", ""),
        ("episode_return", -0.1, "0", ""),
        ("time_to_target", math.nan, "–", ""),
    ],
)
def test_a_value_is_written_with_the_unit_and_decimals_of_its_measure(name, value, number, unit):
    measure = MEASURES[name]
    assert (measure.number(value), measure.quantity(value)) == (number, number + unit)
    interval = "" if math.isnan(value) else f"[{number}, {number}]"
    assert measure.interval(value, value) == interval
    assert all(len(measure.label) <= 20 for measure in catalogue.shown_measures())


def test_every_measure_of_a_hand_that_moves_one_length_in_two_steps_and_stays(make_episode):
    hands = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.0]])
    episode = make_episode(
        hands,
        [1.0, 0.0],
        0.1,
        joint_angles=[[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [3.0, 4.0]],
        rewards=np.array([-0.5, 0.0, 0.25]),
        action_times=np.array([1e-5, 2e-5, 9e-5]),
        servo_impulses=np.array([[1.0, 2.0], [1.0, 0.0], [0.0, 0.0]]),
        servo_work=np.array([[2.0, 2.0], [1.0, 0.0], [0.0, 0.0]]),
        reach=2.0,
    )
    expected = {
        "success": 1.0,
        "success_1_percent": 0.0,  # not there for the two steps of the dwell
        "final_distance": 0.0,
        "time_to_target": 0.2,
        "overshoot": 0.0,
        "jitter": math.nan,  # nor for the half second of rest
        "path_ratio": 1.0,
        "maximal_deviation": 0.0,
        "peak_speed": 5.0,
        "peak_to_mean": 1.0,
        "time_to_peak": 0.25,
        "velocity_peaks": 1.0,
        "minimum_jerk_correlation": math.nan,  # of two equal speeds
        "sparc": pytest.approx(-1.45, abs=0.1),
        "joint_effort": 4.0,
        "joint_work": 5.0,
        "episode_return": -0.25,
    }
    values = measure_all(episode)
    assert values == pytest.approx(expected, nan_ok=True)
    assert list(values) == list(expected)  # the columns of data, and the rows of tables
    assert MEASURES["sparc"].full_label == "smoothness (SPARC)"


def test_rest_after_a_movement_does_not_change_its_shape(make_episode):
    s = np.linspace(0, 1, 36)[:, None]
    s = np.pad(s, ((0, 60), (0, 0)), mode="edge")
    hands = np.concatenate([minimum_jerk(s), 0.2 * np.sin(2 * s)], axis=-1)
    joints = np.concatenate([s, s**2, s**3], axis=-1)
    values, other_values = (
        measure_all(make_episode(hands[:steps], hands[-1], joint_angles=joints[:steps]))
        for steps in (36, None)
    )
    names = list(values)
    shapes = names[names.index("maximal_deviation") : names.index("joint_effort")]
    for name in shapes:
        assert values[name] == pytest.approx(other_values[name])


def test_what_an_episode_does_not_have_is_not_measured(make_episode):
    def missing(hands, target, **arrays):
        values = measure_all(make_episode(hands, target, **arrays))
        return {name for name, value in values.items() if math.isnan(value)}

    tremor, still = 0.01 * np.random.default_rng(0).normal(size=(101, 2)), np.zeros((6, 2))
    assert missing(tremor, [1, 1]) >= {"sparc", "time_to_peak", "minimum_jerk_correlation"}
    untold, effort = np.full((5, 3), np.nan), {"joint_effort", "joint_work"}
    assert missing(still, [1, 1], joint_angles=np.zeros((6, 0))) >= effort
    assert missing(still, [1, 1], servo_impulses=untold, servo_work=untold) >= effort
    shares = {"success", "success_1_percent"}  # none of a hand that is not seen
    unseen = make_episode(np.full((11, 2), math.nan), np.zeros((11, 2)))
    assert {measure_all(unseen)[name] for name in shares} == {0.0}
    assert missing(unseen.hands, [0, 0]) == {*MEASURES} - shares - effort - {"episode_return"}


def test_a_hand_that_never_arrives_has_no_measure_of_how_it_moves(make_episode):
    line = np.linspace([0.0, 0.0], [1.0, 0.0], 51)
    stays = np.zeros((51, 2))
    episodes = {"arrives": make_episode(line, line[-1]), "stays": make_episode(stays, line[-1])}
    frame = pd.DataFrame([measure_all(episode) for episode in episodes.values()], index=episodes)
    assert frame.loc["stays", "path_ratio"] == 0  # the data keep it
    seen = leave_out_failures(frame)
    of_all = [name for name, measure in MEASURES.items() if not measure.successes_only]
    assert seen.drop(columns=of_all).loc["stays"].isna().all()
    pd.testing.assert_frame_equal(seen[of_all], frame[of_all])
    pd.testing.assert_series_equal(seen.loc["arrives"], frame.loc["arrives"])
    assert {"success", "final_distance", "episode_return"} < set(of_all)


MODULE = """
from mmc_gym.measures import measure

@measure(label="steps to move", shown=True)
def steps_to_move(episode):
    return float((episode.speeds > 0).argmax())
"""

SCRIPT = """
import sys
from pathlib import Path
import my_measures
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.measures import measure

@measure(label="half-way time", unit="s", best="low", shown=True, successes_only=True)
def half_way_time(episode):
    return int((episode.distances <= episode.distances[0] / 2).argmax()) * episode.control_step

if __name__ == "__main__":
    cluster = sys.argv[2] if len(sys.argv) > 2 else None
    benchmark(["mmc", "ik-dls"], Path(sys.argv[1]), ["random"], 3, jobs=2, cluster=cluster)
"""


def test_a_comparison_has_a_column_and_a_row_for_it(tmp_path, capsys):
    @measure(label="kinetic energy", unit="J", best="low", shown=True)
    def energy(episode):
        return float((episode.speeds**2).sum())

    print(compare(["random"], episodes=2, out=tmp_path))
    assert pd.read_csv(tmp_path / "episodes.csv")["energy"].gt(0).all()
    assert set(pd.read_csv(tmp_path / "summary.csv").query("measure == 'energy'")["unit"]) == {"J"}
    assert "kinetic energy" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("cluster", [None, "ray"])
def test_workers_take_the_measures_of_modules_and_scripts(tmp_path, monkeypatch, cluster):
    if cluster == "ray":
        pytest.importorskip("ray")
    monkeypatch.setenv("RAY_ADDRESS", "local")
    monkeypatch.setenv("RAY_TMPDIR", "/tmp")  # short enough for the names of sockets
    monkeypatch.setenv("GRPC_ENABLE_FORK_SUPPORT", "0")
    (tmp_path / "my_measures.py").write_text(MODULE)
    (tmp_path / "script.py").write_text(SCRIPT)
    store = tmp_path / "store"
    command = [tmp_path / "script.py", store, *filter(None, [cluster])]
    run_python(*command)
    episodes = read_episodes(store)
    assert episodes["steps_to_move"].notna().all() and episodes["half_way_time"].gt(0).all()
    assert read_manifest(store).measures["half_way_time"]["unit"] == "s"
    # A report needs the store alone, not the code of the measures.
    page = write_report(store, store / "report.html", resamples=50).read_text()
    assert "half-way time" in page and "steps to move" in page
    if cluster is None:
        changed = MODULE.replace("float((episode.speeds > 0).argmax())", "-1.0")
        (tmp_path / "my_measures.py").write_text(changed)
        run_python(*command)
        assert read_episodes(store)["steps_to_move"].eq(-1).all()  # it is taken anew
