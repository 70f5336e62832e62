"""The benchmark of inverse kinematics, with few problems."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pinocchio", reason="needs the extra inverse-kinematics")
FOLDER = Path(__file__).parents[1] / "benchmarks"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    tables = ("reach", "locked", "longer", "outside", "elbow")
    command = [sys.executable, FOLDER / "inverse_kinematics.py", "--robots", "iiwa", "--out", out]
    subprocess.run([*command, "--problems", "5", "--tables", *tables], check=True, cwd=out)
    return {name: json.loads((out / f"{name}-iiwa-1.json").read_text()) for name in tables}


def test_the_network_reaches_what_the_arm_can_reach_as_given_and_changed(rows):
    for table in ("reach", "locked", "longer", "elbow"):
        own = [row for row in rows[table] if row["solver"] == "mmc-gym"]
        assert own
        assert all(row["late"] == 100 for row in own), table


def test_every_solver_meets_the_judge(rows):
    best = {}
    for row in rows["reach"]:
        best[row["solver"]] = max(best.get(row["solver"], 0), row["late"])
    assert {"mmc-gym", "damped least squares"} <= best.keys()
    assert min(best.values()) > 0


def test_the_networks_hand_stays_near_a_target_out_of_reach(rows):
    own = next(row for row in rows["outside"] if row["solver"] == "mmc-gym")
    assert own["none"] == 0
    assert 0 <= own["mm"] < 50
