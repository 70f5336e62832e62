"""The laws of human movement, beside what people do."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd
import pytest

from mmc_gym.measures import SET_MEASURES
from mmc_gym.report.results import read_results
from mmc_gym.report.tables import LAWS, law_table


@pytest.fixture
def results(benchmark_store):
    return read_results(*benchmark_store)


def test_each_law_is_a_measure_that_the_benchmark_takes():
    names = set(SET_MEASURES)
    assert {name for law in LAWS for name in (law.measure, law.explained) if name} <= names


def test_without_the_movements_there_is_no_table(results):
    assert law_table(results) is None


def test_agents_stand_beside_people(results):
    rows = [
        ("mmc", math.nan, "speed_curvature_exponent", 0.25),
        ("mmc", math.nan, "speed_curvature_r_squared", 0.9),
        ("mmc", math.nan, "fitts_slope", math.nan),
        ("ppo", 0.0, "speed_curvature_exponent", 0.2),
        ("ppo", 1.0, "speed_curvature_exponent", 0.4),
    ]
    columns = ["agent", "training_seed", "measure", "value"]
    table = law_table(replace(results, sets=pd.DataFrame(rows, columns=columns)))
    assert table.headings == (("speed-curvature exponent", ""),)
    assert table.people == (("0.333", "Lacquaniti et al. 1983"),)
    cells = {agent: row[0] for agent, _, row in table.rows}
    assert cells == {"mmc": ("0.250", "R² 0.90"), "ppo": ("0.300", "0.200 to 0.400")}
