"""The contract of the experiments: what a result holds is written whole, and the same each time."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from mmc_gym.paper.experiment import Result, Settings, write_result
from mmc_gym.paper.published import POINTS
from mmc_gym.paper.run import EXPERIMENTS


def make_result():
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([0, 1], [1, 0])
    frame = pd.DataFrame({"iteration": [1, 2], "distance": [0.5, 0.25]})
    arrays = {"angles": np.linspace(0, 1, 5), "units": np.array(["4", "8, 8"])}
    return Result(figures={"picture": figure}, data={"table": frame, "arrays": arrays})


def test_a_result_is_written_as_pictures_and_data(tmp_path):
    written = write_result(make_result(), tmp_path / "new")
    names = ["arrays.npz", "picture.png", "picture.svg", "table.csv"]
    assert sorted(path.name for path in written) == names
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == names  # nothing besides
    with np.load(tmp_path / "new" / "arrays.npz") as arrays:
        np.testing.assert_array_equal(arrays["angles"], np.linspace(0, 1, 5))
        assert arrays["units"].tolist() == ["4", "8, 8"]
    frame = pd.read_csv(tmp_path / "new" / "table.csv")
    pd.testing.assert_frame_equal(frame, make_result().data["table"])


def test_the_same_result_gives_the_same_bytes(tmp_path):
    for name in ("one", "two"):
        write_result(make_result(), tmp_path / name)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes(), path.name


@pytest.mark.parametrize(("name", "value"), [("seed", -1), ("jobs", 0)])
def test_settings_that_cannot_be_say_so(name, value):
    with pytest.raises(ValueError, match=f"{name} must be . or more, got {value}"):
        Settings(**{name: value})


def test_every_experiment_is_listed_by_its_name_and_described_in_a_line():
    for name, experiment in EXPERIMENTS.items():
        assert experiment.name == name
        assert experiment.description
        assert "\n" not in experiment.description


def test_the_seven_points_are_numbered():
    assert list(POINTS) == [1, 2, 3, 4, 5, 6, 7]
