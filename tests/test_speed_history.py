"""Facts about the history of `make speed`: what counts as a loss of speed."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

FILE = Path(__file__).parents[1] / "benchmarks" / "history.py"


@pytest.fixture(scope="module")
def history():
    spec = importlib.util.spec_from_file_location("history", FILE)
    module = importlib.util.module_from_spec(spec)
    sys.modules["history"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules["history"]


@pytest.fixture
def runs(history):
    """A run for each ratio."""

    def make(*ratios, **facts):
        row = history.Row("arms", True, 1e-6, "peer", 1.0, 1.0, 1.0)
        return [
            history.Run(
                f"2026-01-{day:02d}T03:00:00+00:00",
                "machine",
                (replace(row, ratio=ratio, **facts),),
            )
            for day, ratio in enumerate(ratios, start=1)
        ]

    return make


def test_a_loss_of_a_quarter_is_found_and_named(history, runs):
    (line,) = history.losses(runs(4.0, 4.1, 3.9, 4.0, 3.0))
    assert line == "arms: 3 times as fast as peer, usually 4: a loss of 25%"


def test_noise_of_ten_percent_is_no_loss(history, runs):
    random = np.random.default_rng(0)
    for _ in range(50):
        assert not history.losses(runs(*random.uniform(0.9, 1.1, 8)))


def test_one_run_that_was_lucky_or_slow_does_not_move_what_is_usual(history, runs):
    assert not history.losses(runs(4.0, 9.0, 4.0, 4.0, 3.9))
    assert history.losses(runs(4.0, 1.0, 4.0, 4.0, 3.0))


def test_what_is_slow_for_a_week_is_usual(history, runs):
    assert not history.losses(runs(*[4.0] * 20, *[3.0] * 8))


@pytest.mark.parametrize("facts", [{"ours": False}, {}], ids=["a peer", "too few runs"])
def test_a_loss_of_what_cannot_be_compared_is_none(history, runs, facts):
    count = 2 if not facts else 9
    assert not history.losses(runs(*[4.0] * count, 1.0, **facts))


def test_a_ratio_to_another_peer_is_not_compared(history, runs):
    assert not history.losses([*runs(4.0, 4.0, 4.0, 4.0, peer="former"), *runs(1.0)])


def test_runs_are_read_as_they_were_written(history, runs, tmp_path):
    made = runs(4.0, 3.0)
    for run in reversed(made):
        history.write_run(run, tmp_path)
    assert history.read_runs(tmp_path) == made
    written = history.draw_history(made, tmp_path / "history")
    assert all(file.stat().st_size for file in written)
