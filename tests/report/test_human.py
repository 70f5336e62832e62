"""Whether learning is as human-like: only what the data can tell is said."""

from __future__ import annotations

import numpy as np
import pytest

from mmc_gym.benchmark.statistics import Estimate
from mmc_gym.measures.episode import moving_part
from mmc_gym.measures.speed import (
    MINIMUM_JERK_SPAN,
    correlation_with_minimum_jerk,
    spectral_arc_length,
)
from mmc_gym.report import sentences as human
from mmc_gym.report.results import read_results
from mmc_gym.report.scores import Estimates


@pytest.fixture(scope="module")
def estimates(benchmark_store):
    return Estimates(read_results(*benchmark_store), resamples=200)


def test_learning_that_is_more_human_like_is_said_to_be(estimates):
    sentence = human.human_likeness(estimates)[0]
    assert "(ppo-smooth) is more human-like than mmc by" in sentence
    assert "ppo-smooth: 2 training seeds" in sentence
    assert f"{len(human.HUMAN)} measures" in sentence


@pytest.mark.parametrize(
    ("findings", "said"),
    [
        (["same", "same"], "is as human-like as mmc: the same within the margin by 2 measures"),
        (["more", "same"], "is more human-like than mmc by 1 of 2 measures, the same within the"),
        (["less", "unclear"], "is less human-like than mmc by 1 of 2 measures, not to be told"),
        (["more", "less"], "by 1 of 2 measures and less by 1"),
        (["same", "unclear"], "and mmc cannot be told apart by 1 of 2 measures, and are the same"),
    ],
)
def test_the_verdict_follows_from_the_findings(findings, said):
    assert said in human.verdict(findings, "ppo-smooth", "mmc")


def test_only_an_interval_within_the_margin_makes_two_agents_the_same():
    measure = next(measure for measure in human.HUMAN if measure.name == "sparc")
    margin = human.MARGINS["sparc"]

    def found(low, high):
        difference = Estimate((low + high) / 2, low * margin, high * margin, (3, 0), 30, 1)
        return human.find(difference, measure)

    assert found(-0.9, 0.9) == "same"
    assert found(0.1, 0.9) == "same"  # a difference, but a small one
    assert found(-0.1, 1.1) == "unclear"
    assert found(0.1, 1.1) == "more"
    assert found(-1.1, -0.1) == "less"


def test_the_margins_are_what_lies_between_minimum_jerk_and_minimum_acceleration():
    step, steps = 0.02, 40
    phases = np.linspace(0, 1, steps + 1)
    jerk = np.diff(phases**3 * (10 - 15 * phases + 6 * phases**2)) / step
    acceleration = np.diff(phases**2 * (3 - 2 * phases)) / step
    jerk, acceleration = (one[moving_part(one)] for one in (jerk, acceleration))
    correlation = correlation_with_minimum_jerk(acceleration, MINIMUM_JERK_SPAN)
    assert 1 - correlation == pytest.approx(human.MARGINS["minimum_jerk_correlation"], abs=0.002)
    smoothness = spectral_arc_length(jerk, step) - spectral_arc_length(acceleration, step)
    assert smoothness == pytest.approx(human.MARGINS["sparc"], abs=0.02)
