"""Tables and figures of learning, from trials of learners that are known."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from mmc_gym._errors import UserError
from mmc_gym.agents.body_model.parts import LEARNED
from mmc_gym.benchmark.statistics import resampled_means
from mmc_gym.experiments.adaptation import learning_of
from mmc_gym.experiments.experiment import Block, Experiment, Probe
from mmc_gym.experiments.results import (
    ExperimentResult,
    check_people,
    learning_figure,
    learning_table,
    print_learning,
)
from mmc_gym.measures.catalogue import PEOPLE
from mmc_gym.network.time_base import minimum_jerk
from studies.adaptation.recovery import TwoStates, simulate_learners

LEARNER = TwoStates(A_f=0.6, A_s=0.99, B_f=0.2, B_s=0.02)
BELL = minimum_jerk(np.linspace(0, 1, 21))[:, None]


def played(turn, subjects=6, family="rotation", known_as=""):
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
    strengths = np.array([one.strength for one in schedule])
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
        targets=np.repeat(paths(angles)[:, -1:], 21, axis=1),
        control_step=0.02,
    )


@pytest.mark.parametrize("turn", [30.0, -30.0])
def test_learners_are_found_again_in_their_paths(turn):
    result = played(turn)
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
    result = played(30.0)
    print_learning(learning_table(result, 20), console)
    text = console.export_text()
    assert "after-effect" in text and "known" in text
    above, below = learning_figure(result, resamples=20).axes
    assert above.get_ylabel().startswith("perturbation")
    assert [line.get_label() for line in below.lines].count("known") == 1
    curves = [line.get_ydata() for line in below.lines if len(line.get_xdata()) > 2]
    assert np.nanmax(np.concatenate(curves)) == 30.0


def test_people_are_shown_in_an_experiment_that_they_did_and_a_single_subject_has_no_interval():
    known, alone, own = (
        played(15.0, subjects, family="clamp", known_as=name)
        for subjects, name in ((6, "clamp"), (1, "clamp"), (1, ""))
    )
    table, of_alone = learning_table(known, 20), learning_table(alone, 20)
    row = table[table["agent"] == PEOPLE].set_index("measure").loc["clamp_asymptote"]
    assert (row["low"], row["high"], row["source"]) == (18.0, 18.0, "Tsay et al. 2020")
    figure = learning_figure(known, table, resamples=20)
    assert figure.axes[2].get_xlabel() == "people: 18\nTsay et al. 2020"
    assert PEOPLE not in set(learning_table(own, 20)["agent"])
    assert of_alone.loc[of_alone["agent"] != PEOPLE, ["low", "high"]].isna().all(axis=None)
    assert not learning_figure(alone, of_alone, resamples=20).axes[1].collections  # no band


def test_means_of_resamples_begin_with_the_mean():
    samples = np.array([[1.0, 2.0], [3.0, np.nan], [5.0, 4.0]])
    means = resampled_means(samples, 200)
    assert means.shape == (201, 2)
    assert means[0] == pytest.approx([3.0, 3.0])
    assert np.nanmin(means) >= 1.0 and np.nanmax(means) <= 5.0
    assert means[1:, 0].std() == pytest.approx(np.sqrt(8 / 3 / 3), rel=0.2)


def test_your_own_data_of_people_are_drawn_with_agents_if_they_fit():
    result = played(30.0)
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
