"""Measures of learning, their table and figure, of movements and learners that are known."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from mmc_gym import UserError
from mmc_gym.agents.body_model.parts import LEARNED
from mmc_gym.experiments.adaptation import QUANTITIES, Learning, learning_of, measure_learning
from mmc_gym.experiments.experiment import Block, Experiment, Probe
from mmc_gym.experiments.fits import TWO_STATES
from mmc_gym.experiments.learning import (
    correction_gain,
    correction_latency,
    describe_movements,
    initial_direction,
    lateral_deviation,
)
from mmc_gym.experiments.results import (
    ExperimentResult,
    check_people,
    learning_figure,
    learning_table,
    print_learning,
)
from mmc_gym.measures import MEASURES
from mmc_gym.measures.catalogue import PEOPLE, people
from mmc_gym.network.time_base import minimum_jerk
from studies.adaptation.recovery import TwoStates, simulate_learners
from studies.laws import LAWS

STEP = 0.02
BELL = minimum_jerk(np.linspace(0, 1, 52))[:, None]
LEARNER = TwoStates(A_f=0.6, A_s=0.99, B_f=0.2, B_s=0.02)
TURN, NONE = np.full(120, 30.0), np.zeros(60)


@pytest.mark.parametrize("turn", [-150.0, -30.0, 0.0, 30.0, 150.0])
@pytest.mark.parametrize("start", [(0.0, 0.0), (2.0, -1.0)])
def test_direction_and_deviation_are_positive_to_the_left(turn, start):
    angle = np.radians(70.0 + turn)
    path = np.array(start) + 0.5 * BELL * [np.cos(angle), np.sin(angle)]
    target = np.array(start) + 3.0 * np.array([np.cos(np.radians(70)), np.sin(np.radians(70))])
    assert initial_direction(path, target) == pytest.approx(turn)
    at_peak = 0.5 * BELL[26, 0]
    assert lateral_deviation(path, target) == pytest.approx(at_peak * np.sin(np.radians(turn)))


@pytest.mark.parametrize("go_step", [0, 10])
def test_a_movement_that_is_known_is_described(go_step):
    wait = np.zeros((go_step + 4, 1))
    along = np.r_[wait, 0.6 * BELL, np.full((10, 1), 0.6)]
    turned = [np.cos(np.radians(100)), np.sin(np.radians(100))]
    bulge = 0.05 * np.sin(np.pi * along / 0.6) * [-1.0, 0.0]
    hands = along * [0.0, 1.0] + bulge
    targets = np.tile([0.0, 0.6], (len(along), 1))
    settings = {"go_steps": go_step, "control_step": STEP, "early": 0.1, "tolerance": 0.05}
    movement = describe_movements(hands, along * turned, targets, **settings)
    assert movement["hand_angle"] == pytest.approx(np.degrees(np.arctan2(0.05, 0.3)), abs=0.5)
    assert movement["cursor_error"] == pytest.approx(10.0)
    assert movement["largest_deviation"] == pytest.approx(0.05, rel=1e-2)
    assert movement["reaction_time"] == pytest.approx(4 * STEP, abs=3.1 * STEP)
    assert movement["movement_time"] == pytest.approx(51 * STEP, rel=0.15)
    assert movement["peak_speed"] == pytest.approx(0.6 * 1.875 / (51 * STEP), rel=0.05)
    assert movement["end_error"] == pytest.approx(2 * 0.6 * np.sin(np.radians(5)))
    assert not movement["success"]
    still = describe_movements(0 * hands, 0 * hands, targets, **settings)
    assert np.isnan([still[name] for name in [*movement][:7]]).all() and still["end_error"] == 0.6


@pytest.mark.parametrize("late", [3, 6, 12])
def test_a_direction_is_not_changed_by_what_follows_it(late):
    """Neither before feedback nor, without a time, at the peak of speed."""
    path = BELL * [1.0, 0.0]
    onset = int(np.argmax(np.diff(BELL[:, 0]) >= 0.05 * np.diff(BELL[:, 0]).max()))
    bends = [np.clip(np.arange(52) - begin, 0, None)[:, None] for begin in (onset + late, 30)]
    paths = path + np.stack(bends) * [0.0, 0.01]
    early, later = (initial_direction(paths[0], [1.0, 0.0], steps=late + k) for k in (0, 1))
    assert early == pytest.approx(0.0) and later > 1.0
    assert initial_direction(np.stack([path, paths[1]]), [1.0, 0.0]) == pytest.approx([0.0, 0.0])
    assert np.isnan(initial_direction(np.ones((3, 51, 2)), np.zeros(2))).all()  # it never moves


@pytest.mark.parametrize("latency", [0.06, 0.12, 0.2])
@pytest.mark.parametrize("gain", [0.3, 1.0])
def test_a_late_and_partial_correction_of_a_jump(latency, gain):
    times = np.arange(101) * STEP
    response = gain * 0.1 * minimum_jerk(np.clip((times - 0.2 - latency) / 0.4, 0, 1))
    assert correction_gain(response, 0.1) == pytest.approx(gain)
    assert correction_latency(response, 0.1, 0.2, STEP) == pytest.approx(latency, abs=STEP)
    assert np.isnan(correction_latency(0 * response, 0.1, 0.2, STEP))


ALONG = np.clip(np.arange(60) * STEP - 0.3, 0, None)
UNKNOWN = np.full(60, np.nan)


@pytest.mark.parametrize(
    ("measured", "arguments"),
    [
        (correction_latency, (UNKNOWN, 0.1, 0.2, STEP)),
        (correction_latency, (-ALONG, 0.1, 0.2, STEP)),  # the other way
        (correction_latency, (ALONG, 0.1, 5.0, STEP)),  # ended before the jump
        (correction_latency, (ALONG, 0.1, np.nan, STEP)),
        (correction_latency, (ALONG, 0.0, 0.2, STEP)),
        (correction_latency, ([], 0.1, 0.2, STEP)),
        (correction_latency, ([0.0, 1.0], 0.1, 0.0, STEP)),
        (correction_gain, (ALONG, 0.0)),
        (correction_gain, ([], 0.1)),
        (initial_direction, (BELL * [1, 0], [0, 0])),  # a target at the start
        (lateral_deviation, (BELL * [1, 0], [0, 0])),
        (initial_direction, ([[0, 0]], [1, 0])),
        (lateral_deviation, (UNKNOWN.reshape(30, 2), [1, 0])),
    ],
)
def test_where_there_is_nothing_to_see_there_is_no_number(measured, arguments):
    assert np.isnan(measured(*arguments)).all()


def learning_in(schedule, learner, kinds="plain", rest=0):
    perturbations, clamps = schedule
    adaptation, errors = simulate_learners(learner, perturbations, clamps)
    changes = np.diff(np.nan_to_num(perturbations), prepend=0) != 0
    return Learning(
        adaptation=adaptation,
        errors=errors,
        perturbations=perturbations,
        clamps=np.broadcast_to(clamps, perturbations.shape),
        kinds=np.broadcast_to(kinds, perturbations.shape),
        offsets=np.zeros(len(perturbations)),
        blocks=np.cumsum(changes),
        rests=np.where(np.arange(len(perturbations)) == rest, 60.0, 0.0),
    )


def measures_of(learning):
    return {name: float(value[0]) for name, value in measure_learning(learning).items()}


def test_measures_of_an_experiment():
    schedule = np.r_[NONE, TURN, NONE, TURN, NONE]
    learning = learning_in((schedule, np.nan), LEARNER, rest=180)
    measures = measures_of(learning)
    curve = learning.adaptation[0]
    assert [len(exposure) for exposure in learning.exposures] == [120, 120]
    assert measures["final_adaptation"] == pytest.approx(curve[170:180].mean())
    assert measures["after_effect"] == pytest.approx(curve[180:184].mean())
    assert measures["retention"] == pytest.approx(curve[180:184].mean() / curve[170:180].mean())
    assert measures["savings"] > 1.0  # the slow state is still there
    assert [measures[name] for name in TWO_STATES] == pytest.approx(list(LEARNER), abs=2e-3)
    assert np.isnan([measures[name] for name in ("width", "clamp_asymptote", "A", "B")]).all()


def test_a_learner_of_one_state_has_parameters_of_one_state():
    one_state = TwoStates(A_f=0.0, A_s=0.97, B_f=0.0, B_s=0.1)
    measures = measure_learning(learning_in((np.r_[NONE, TURN, NONE], np.nan), one_state))
    assert [measures["A"], measures["B"]] == pytest.approx([0.97, 0.1], abs=1e-4)
    assert np.isnan([measures[name] for name in TWO_STATES]).all()


@pytest.mark.parametrize("after", [1, 3])
def test_what_is_retained_after_a_rest_is_of_its_block_however_short(after):
    schedule = np.r_[NONE, TURN, np.full(after, -30.0), NONE]
    learning = learning_in((schedule, np.nan), LEARNER, rest=180)
    curve = learning.adaptation[0]
    expected = curve[180 : 180 + after].mean() / curve[170:180].mean()
    assert measure_learning(learning)["retention"] == pytest.approx(expected)
    # Who turns with the perturbation has no rate of learning.
    wrong = replace(learning, adaptation=-learning.adaptation)
    rate, of_wrong = (measure_learning(curves)["rate"] for curves in (learning, wrong))
    assert np.isfinite(rate) and np.isnan(of_wrong)


def test_measures_of_a_clamp():
    schedule = np.zeros(180), np.r_[NONE * np.nan, np.full(120, 15.0)]
    kinds = np.where(np.arange(180) < 60, "plain", "clamp")
    learning = learning_in(schedule, LEARNER, kinds)
    measures = measures_of(learning)
    assert measures["clamp_asymptote"] == pytest.approx(learning.adaptation[0, -10:].mean())
    assert measures["clamp_asymptote"] > 15.0  # nothing stops at the error that never goes
    assert np.isnan([measures["rate"], measures["savings"], measures["after_effect"]]).all()


def test_figures_of_people_have_a_source_and_belong_to_a_measure():
    known = {*MEASURES, *LAWS, *(quantity.name for quantity in QUANTITIES)}
    for family in ("", "cursor-jump", "generalisation", "savings", "clamp"):
        assert people(family)
        for name, figures in people(family).items():
            assert name in known and figures.source and figures.task and figures.differs
            assert not np.isnan([figures.low, figures.high]).all()


def simulated_result(turn, subjects=6, family="rotation", known_as=""):
    """Return a result of straight movements of `LEARNER`s, with a cursor turned by `turn`."""
    name = (f"{family}-{turn:g}",)
    blocks = (
        Block("baseline", 16),
        Block("learning", 48, name, probes=(Probe("catch", 8),)),
        Block("washout", 24),
        Block("learning again", 24, name, rest=30.0),
    )
    experiment = Experiment("own", blocks, family=known_as)
    schedule = experiment.schedule
    strengths = np.array([trial.strength for trial in schedule])
    compensated, _ = simulate_learners(LEARNER, strengths, subjects=subjects, noise=1.0)
    angles = np.stack([experiment.targets_of(seed) for seed in range(subjects)])

    def paths(degrees):
        way = np.stack([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], axis=-1)
        return (BELL * way.reshape(-1, 1, 2)).astype(np.float32)

    trials = pd.DataFrame(
        {
            "agent": "known",
            "subject": np.repeat(np.arange(subjects), len(schedule)),
            "trial": list(range(len(schedule))) * subjects,
            "target_angle": angles.ravel(),
            "keeps_all": False,
            "run": "",
            "channel_force": np.nan,
            **dict.fromkeys(LEARNED, ""),
        }
    )
    return ExperimentResult(
        experiment=experiment,
        trials=trials,
        hands=paths(angles - compensated),
        cursors=paths(angles - compensated + strengths),
        targets=np.repeat(paths(angles)[:, -1:], len(BELL), axis=1),
        control_step=0.02,
    )


@pytest.mark.parametrize("turn", [30.0, -30.0])
def test_learners_are_found_again_in_their_paths(turn):
    result = simulated_result(turn)
    learning = learning_of(result.movements_of("known"))
    visible = learning.perturbations - learning.adaptation
    assert learning.errors == pytest.approx(visible, abs=1e-3)
    table = learning_table(result, 50).set_index("measure")
    for name, true in LEARNER._asdict().items():
        assert table.loc[name, "estimate"] == pytest.approx(true, rel=0.2), name
        assert table.loc[name, "low"] <= table.loc[name, "estimate"] <= table.loc[name, "high"]
    end = simulate_learners(LEARNER, learning.perturbations * 1.0)[0][0, 54:64].mean()
    assert table.loc["final_adaptation", "estimate"] == pytest.approx(end, abs=1.5)
    assert 0 < table.loc["after_effect", "estimate"] < table.loc["final_adaptation", "estimate"]
    assert "width" not in table.index  # nothing was probed


def test_the_table_is_printed_and_the_figure_has_the_timeline_and_a_curve_per_agent():
    console = Console(record=True, width=120)
    result = simulated_result(30.0)
    print_learning(learning_table(result, 20), console)
    text = console.export_text()
    assert "after-effect" in text and "known" in text
    above, below = learning_figure(result, resamples=20).axes
    assert above.get_ylabel().startswith("perturbation")
    assert [line.get_label() for line in below.lines].count("known") == 1
    curves = [line.get_ydata() for line in below.lines if len(line.get_xdata()) > 2]
    assert np.nanmax(np.concatenate(curves)) == 30.0


def test_people_are_shown_in_an_experiment_that_they_did_and_a_single_subject_has_no_interval():
    known, alone, unpublished = (
        simulated_result(15.0, subjects, family="clamp", known_as=name)
        for subjects, name in ((6, "clamp"), (1, "clamp"), (1, ""))
    )
    table, of_alone = learning_table(known, 20), learning_table(alone, 20)
    row = table[table["agent"] == PEOPLE].set_index("measure").loc["clamp_asymptote"]
    assert (row["low"], row["high"], row["source"]) == (18.0, 18.0, "Tsay et al. 2020")
    figure = learning_figure(known, table, resamples=20)
    assert figure.axes[2].get_xlabel() == "people: 18\nTsay et al. 2020"
    assert PEOPLE not in set(learning_table(unpublished, 20)["agent"])
    assert of_alone.loc[of_alone["agent"] != PEOPLE, ["low", "high"]].isna().all(axis=None)
    assert not learning_figure(alone, of_alone, resamples=20).axes[1].collections  # no band


def test_your_own_data_of_people_are_drawn_with_agents_if_they_fit():
    result = simulated_result(30.0)
    trials = np.arange(len(result.experiment.schedule))
    table = pd.DataFrame({"trial": np.tile(trials, 2), "adaptation": np.r_[trials, trials + 2.0]})
    checked = check_people(table, result.experiment)
    figure = learning_figure(replace(result, people=checked), resamples=20)
    drawn = {line.get_label(): line for line in figure.axes[1].lines}[PEOPLE]
    assert drawn.get_ydata() == pytest.approx(trials + 1.0)
    for wrong, message in (
        (table.rename(columns={"trial": "n"}), r"column 'trial', got \['n', 'adaptation'\]"),
        (table.assign(trial=table["trial"] + 1), "trial must be from 0 to 111, as in own, got 112"),
        (table.assign(adaptation="much"), "adaptation must be numbers, got 'much'"),
    ):
        with pytest.raises(UserError, match=message):
            check_people(wrong, result.experiment)
