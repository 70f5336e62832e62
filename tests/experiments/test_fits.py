"""Fits of models of learning: they find what simulated learners are, and tell them apart."""

import numpy as np
import pandas as pd
import pytest

from mmc_gym import UserError
from mmc_gym.benchmark.statistics import TAILS, expanded_tails
from mmc_gym.experiments.fits import (
    PARAMETERS,
    choose_states,
    fit,
    fit_curve,
    fit_exponential,
    fit_gaussian,
    generalization_width,
)
from studies.adaptation.recovery import TwoStates, simulate_learners

LEARNER = TwoStates(A_f=0.6, A_s=0.99, B_f=0.2, B_s=0.02)
ONE_STATE = TwoStates(A_f=0.0, A_s=0.97, B_f=0.0, B_s=0.1)
TURN, NONE, UNKNOWN = np.full(120, 30.0), np.zeros(60), np.full(60, np.nan)
ROUND = np.arange(0, 360, 45.0)
NEVER = np.full(240, np.nan)
SCHEDULES = {
    "washout": (np.r_[NONE, TURN, NONE], NEVER),
    "unseen": (np.r_[NONE, TURN, UNKNOWN], NEVER),
    "clamped": (np.r_[NONE, TURN, NONE], np.r_[NEVER[60:], NONE]),
    "counter": (np.r_[NONE, TURN, -TURN[:20], NONE], np.r_[np.full(200, np.nan), NONE]),
}
COUNTER = SCHEDULES["counter"]
MOVED_BY_COUNTER = dict(zip(("perturbation", "clamp"), COUNTER))


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("driven_by", ["model", "seen"])
@pytest.mark.parametrize("learner", [LEARNER, TwoStates(0.9, 0.999, 0.05, 0.01)])
def test_two_states_are_found_again(schedule, learner, driven_by):
    perturbation, clamp = SCHEDULES[schedule]
    adaptation, errors = (arrays[0] for arrays in simulate_learners(learner, perturbation, clamp))
    error = errors if driven_by == "seen" else None
    result = fit_curve(adaptation, perturbation=perturbation, clamp=clamp, error=error)
    assert [*result.parameters.values()] == pytest.approx(list(learner), abs=2e-3)
    assert result.r_squared == pytest.approx(1.0) and result.trials == len(adaptation)
    assert result.predicted == pytest.approx(adaptation, abs=0.02)


def test_the_errors_that_were_seen_hold_the_noise_of_each_movement():
    y, errors = (arrays[0] for arrays in simulate_learners(LEARNER, *COUNTER, noise=6.0))
    by_model, by_errors = (fit_curve(y, error=seen, **MOVED_BY_COUNTER) for seen in (None, errors))
    assert by_errors.mean_square < by_model.mean_square


@pytest.mark.parametrize(
    ("learner", "best"),
    [
        (LEARNER, "two-state"),
        (ONE_STATE, "one-state"),
        (LEARNER._replace(B_f=0.0, B_s=0.0), "nothing"),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_the_criterion_tells_which_learner_it_is(learner, best, noise):
    for seed in range(3):
        curves, _ = simulate_learners(learner, *COUNTER, subjects=12, noise=noise, seed=seed)
        y = curves.mean(axis=0)
        fits = {kind: fit_curve(y, kind, **MOVED_BY_COUNTER) for kind in [*PARAMETERS][:4]}
        assert min(fits, key=lambda kind: fits[kind].bic) == best
        of_one, of_two = np.split(choose_states(y, *COUNTER), [2])
        assert np.isnan(of_one).all() == (best != "one-state")
        assert np.isnan(of_two).all() == (best != "two-state")
        if best == "one-state":
            assert of_one == pytest.approx([0.97, 0.1], abs=0.03)


def test_a_hand_that_corrects_within_the_movement_has_learned_nothing():
    perturbation, clamp = COUNTER
    curve = 0.4 * np.where(np.isnan(clamp), perturbation, clamp)
    curve += np.random.default_rng(0).normal(0.0, 1.0, len(curve))
    gain = fit_curve(curve, "correction", **MOVED_BY_COUNTER).parameters["gain"]
    assert gain == pytest.approx(0.4, abs=0.02)
    assert np.isnan(choose_states(curve, perturbations=perturbation, clamps=clamp)).all()
    assert np.isnan(fit_curve(curve, "correction").bic)  # nothing moved it


def test_resamples_are_fitted_as_curves_are_alone():
    curves, _ = simulate_learners(LEARNER, *COUNTER, subjects=6, noise=2.0)
    together = choose_states(curves, *COUNTER)
    alone = [choose_states(curve, *COUNTER) for curve in curves]
    assert together.shape == (6, 6)
    assert together == pytest.approx(np.array(alone), abs=1e-4, nan_ok=True)


def test_a_table_has_a_fit_for_each_subject_and_model_or_of_the_mean():
    y, errors = simulate_learners(LEARNER, *COUNTER, subjects=3, noise=1.0)
    subjects, trials = y.shape
    table = pd.DataFrame(
        {
            "who": np.repeat([*"abc"], trials),
            "trial": np.tile(np.arange(trials), subjects),
            "hand": y.ravel(),
            "turn": np.tile(COUNTER[0], subjects),
            "clamp": np.tile(COUNTER[1], subjects),
            "error": errors.ravel(),
        }
    )
    columns = {"y": "hand", "perturbation": "turn", "clamp": "clamp"}
    fits = fit(table, by="who", **columns)
    assert [*fits["who"]] == [*"aabbcc"] and [*fits["model"]] == ["one-state", "two-state"] * 3
    assert fits.loc[fits["best"], "model"].eq("two-state").all()
    (of_mean,) = fit(table, "two-state", **columns).to_dict("records")
    expected = fit_curve(y.mean(axis=0), **MOVED_BY_COUNTER).parameters["B_f"]
    assert of_mean["B_f"] == pytest.approx(expected, abs=1e-6)
    seen = fit(table, "two-state", by=["who"], error="error", **columns)
    alone = fit_curve(y[1], error=errors[1], **MOVED_BY_COUNTER)
    assert seen["A_s"][1] == alone.parameters["A_s"]
    with pytest.raises(UserError, match=r"column 'turned', got \['who', 'trial'"):
        fit(table, y="hand", perturbation="turned")
    with pytest.raises(UserError, match=r"model 'two-stat' .* 'two-state'"):
        fit(table, "two-stat", **columns)


@pytest.fixture
def table():
    """Three subjects of one state in order of their trials."""
    perturbation = np.r_[NONE[:20], TURN[:60]]
    rows = {"trial": np.arange(80), "perturbation": perturbation}
    tables = []
    for subject, rate in enumerate((0.08, 0.1, 0.12)):
        curves, _ = simulate_learners(ONE_STATE._replace(B_s=rate), perturbation)
        tables.append(pd.DataFrame({"subject": subject, "adaptation": curves[0], **rows}))
    return pd.concat(tables, ignore_index=True)


@pytest.mark.parametrize("by", ["subject", None])
def test_the_order_of_rows_changes_no_fit(table, by):
    shuffled = table.sample(frac=1, random_state=0)
    fits, expected = (fit(rows, "one-state", by=by) for rows in (shuffled, table))
    assert fits["r_squared"].min() > 0.999
    if by:
        fits = fits.sort_values("subject", ignore_index=True)
    pd.testing.assert_frame_equal(fits, expected)


def test_probes_of_one_direction_may_stand_more_than_once_in_a_gaussian():
    x = np.repeat(np.arange(-90.0, 91, 22.5), 2)
    rows = {"trial": x, "adaptation": 20 * np.exp(-(x**2) / (2 * 38**2)), "subject": 0}
    (width,) = fit(pd.DataFrame(rows), "gaussian", by="subject")["width"]
    assert width == pytest.approx(38, rel=1e-3)


def test_rows_without_a_subject_are_a_curve_of_their_own(table):
    table["subject"] = table["subject"].where(table["subject"] != 1)
    assert fit(table, "one-state", by="subject")["trials"].tolist() == [80, 80, 80]


@pytest.mark.parametrize(
    ("column", "change", "said"),
    [
        ("adaptation", np.negative, "y seems to have the other sign"),
        ("perturbation", np.negative, "y seems to have the other sign"),
        ("adaptation", np.radians, "y seems to be in radians"),
        ("perturbation", np.radians, "y seems to be in degrees"),
    ],
)
def test_another_sign_or_unit_is_said_in_one_line(table, column, change, said):
    table[column] = change(table[column])
    with pytest.warns(UserWarning, match=said) as warned:
        fit(table, by="subject")
    assert len(warned) == 1 and warned[0].filename == __file__
    with pytest.warns(UserWarning, match=said):
        fit_curve(table["adaptation"][:80], perturbation=table["perturbation"][:80])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: pd.concat([rows, rows[:2]]), r"once in subject 0; .*, got \[0.0, 1.0\]"),
        (lambda rows: rows.replace({"trial": {3: np.nan}}), r"trial must be .* \[nan"),
        (lambda rows: rows[:0], "rows of the table must be at least one, got 0"),
        (lambda rows: rows.assign(adaptation="far"), "adaptation must be numbers: .* 'far'"),
    ],
)
@pytest.mark.parametrize("by", ["subject", None])
def test_a_table_that_has_no_curves_is_refused(table, change, message, by):
    if by is None and "once in subject" in message:
        pytest.skip("trials of all subjects are averaged")
    with pytest.raises(UserError, match=message):
        fit(change(table), by=by)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"y": []}, r"y must be a curve of shape \(trials,\), got \(0,\)"),
        ({"y": 3.0}, r"y must be a curve of shape \(trials,\), got \(\)"),
        ({"y": ["far", "near"]}, "y must be numbers: .* 'far'"),
        ({"y": [1.0, [2.0, 3.0]]}, "y must be numbers: "),
        (
            {"perturbation": TURN},
            r"perturbation must be a number, or of shape \(3,\) as y, got \(120",
        ),
        ({"model": "gaussian", "x": [1, 2]}, r"x must be a number, or of shape"),
    ],
)
def test_what_is_no_curve_is_refused(arguments, message):
    with pytest.raises(UserError, match=message):
        fit_curve(**{"y": [1.0, 2.0, 3.0], **arguments})


def test_an_exponential_is_found_again_and_noise_has_none():
    rates = np.array([0.01, 0.1, 0.7])
    curves = 20 - 15 * np.exp(-rates[:, None] * np.arange(100))
    curves[:, 7] = np.nan
    asymptotes, fitted_rates, starts = fit_exponential(curves).T
    assert asymptotes == pytest.approx([20.0] * 3, rel=1e-4)
    assert starts == pytest.approx([5.0] * 3, rel=1e-4)
    assert fitted_rates == pytest.approx(rates, rel=1e-4)
    assert fit_curve(curves[1], "exponential").mean_square == pytest.approx(0.0, abs=1e-6)
    later = pd.DataFrame({"trial": np.arange(60, 160), "adaptation": curves[1]})
    assert fit(later, "exponential")["r_squared"].item() == pytest.approx(1.0)
    noise = np.random.default_rng(0).normal(size=(20, 100))
    assert np.isnan(fit_exponential(noise)).all()
    assert np.isnan(fit_exponential(np.zeros(100))).all()


@pytest.mark.parametrize("width", [15.0, 38.0, 90.0])
def test_the_width_of_a_gaussian(width):
    offsets = np.array([-135.0, -90, -45, -22.5, 0, 22.5, 45, 90, 135, 180])
    adaptation = 20 * np.exp(-((offsets - 5) ** 2) / (2 * width**2))
    assert generalization_width(adaptation, offsets) == pytest.approx(width, rel=1e-3)
    assert np.isnan(generalization_width(adaptation[:3], offsets[:3]))
    unseen = np.where(offsets == 45, np.nan, adaptation)
    assert generalization_width(unseen, offsets) == pytest.approx(width, rel=1e-3)
    assert generalization_width(np.full(len(offsets), 20.0), offsets) == pytest.approx(180)
    parameters = fit_curve(adaptation + 4, "gaussian", x=offsets).parameters
    expected = {"offset": 4.0, "height": 20.0, "centre": 5.0, "width": width}
    assert parameters == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize(
    ("fitted", "arguments"),
    [
        (fit_exponential, (UNKNOWN,)),
        (fit_exponential, (np.r_[1.0, 2, 3, UNKNOWN, np.inf],)),
        (choose_states, (np.ones(60), UNKNOWN, np.nan)),  # no error is seen
        (choose_states, (-np.arange(60.0), np.full(60, 30.0), np.nan)),  # away from what would help
        (choose_states, (UNKNOWN, np.ones(60), np.nan)),
        (generalization_width, (UNKNOWN[:8], ROUND)),
        (generalization_width, (np.full(8, np.inf), ROUND)),
        (generalization_width, (np.r_[1.0, 2, 1, UNKNOWN[:5]], ROUND)),
        (fit_gaussian, (np.ones(8), ROUND)),
        (fit_gaussian, (np.r_[1.0, 2, 1, 3, UNKNOWN[:4]], ROUND)),
    ],
)
def test_where_there_is_too_little_to_fit_there_is_no_number(fitted, arguments):
    assert np.isnan(fitted(*arguments)).all()


def test_intervals_of_few_subjects_are_wider():
    tails = [expanded_tails(count)[0] for count in (1, 5, 12, 10_000)]
    assert tails[0] == TAILS[0] and tails[1] < tails[2] < tails[3]
    assert tails[3] == pytest.approx(TAILS[0], rel=1e-3)
