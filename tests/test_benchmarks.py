"""The benchmarks: losses of speed, and solvers on few problems."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.history import Run, SpeedRow, losses, read_runs, write_run
from tests.processes import run_python


def runs(*ratios, **facts):
    """Make a run for each ratio."""
    row = replace(SpeedRow("arms", True, 1e-6, "peer", 1.0, 1.0, 1.0), **facts)
    return [
        Run(f"2026-01-{day:02d}T03:00:00+00:00", "machine", (replace(row, ratio=ratio),))
        for day, ratio in enumerate(ratios, start=1)
    ]


@pytest.mark.parametrize(
    ("ratios", "is_lost"),
    [
        ((4.0, 9.0, 4.0, 4.0, 3.9), False),  # one lucky run does not move the median
        ((4.0, 1.0, 4.0, 4.0, 3.0), True),  # nor does a slow one
        ((*[4.0] * 20, *[3.0] * 8), False),  # slow for a week is usual
        ((4.0, 4.0, 1.0), False),  # too few runs
        ((0.9, 1.1, 1.0, 1.1, 0.9), False),  # noise
    ],
)
def test_the_median_of_the_runs_before_is_the_yardstick(ratios, is_lost):
    assert bool(losses(runs(*ratios))) == is_lost


def test_a_loss_is_named_and_a_peer_s_or_a_ratio_to_another_peer_is_none():
    (line,) = losses(runs(4.0, 4.1, 3.9, 4.0, 3.0))
    assert line == "arms: 3 times as fast as peer, usually 4: a loss of 25%"
    assert not losses(runs(*[4.0] * 9, 1.0, ours=False))
    assert not losses([*runs(4.0, 4.0, 4.0, 4.0, peer="former"), *runs(1.0)])


def test_runs_are_read_as_they_were_written(tmp_path):
    written_runs = runs(4.0, 3.0)
    for run in reversed(written_runs):
        write_run(run, tmp_path)
    assert read_runs(tmp_path) == written_runs


@pytest.mark.slow
def test_the_network_reaches_what_the_arm_can_reach_as_given_and_changed(tmp_path):
    pytest.importorskip("pinocchio", reason="needs the extra inverse-kinematics")
    tables = ("reach", "locked", "longer", "outside", "elbow")
    script = Path(__file__).parents[1] / "benchmarks" / "inverse_kinematics.py"
    options = ("--robots", "iiwa", "--out", tmp_path, "--problems", "5", "--tables", *tables)
    run_python(script, *options, folder=tmp_path)
    rows = {name: json.loads((tmp_path / f"{name}-iiwa-1.json").read_text()) for name in tables}
    for table in ("reach", "locked", "longer", "elbow"):
        our_rows = [row for row in rows[table] if row["solver"] == "mmc-gym"]
        assert our_rows
        assert all(row["late"] == 100 for row in our_rows), table

    our_row = next(row for row in rows["outside"] if row["solver"] == "mmc-gym")
    assert our_row["none"] == 0 and 0 <= our_row["mm"] < 50  # it stays near a target out of reach
    solving = {row["solver"] for row in rows["reach"] if row["late"] > 0}
    assert solving == {row["solver"] for row in rows["reach"]} > {"damped least squares"}
