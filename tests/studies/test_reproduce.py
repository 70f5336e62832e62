"""The command `reproduce`: what it writes is whole, and its table has all that was published."""

import html
import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from studies.paper import networks, run
from studies.paper.__main__ import main
from studies.paper.experiment import Captioned, Result, Row, Settings, write_result
from studies.paper.published import POINTS
from studies.paper.run import EXPERIMENTS, Experiment, print_report, reproduce

pytestmark = pytest.mark.slow


def make_figure():
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([0, 1], [1, 0])
    return figure


def run_first(settings):
    settings.on_progress(1, 2)
    return Result(
        rows=(Row("distance", 0.025, "2.0 ± 0.1", 7.123456, "m", "a|b <i>"), Row("nothing")),
        figures={"bell": Captioned(make_figure(), "A bell.")},
        points={1: "at iteration 30"},
    )


def run_second(settings):
    return Result(rows=(Row("seed", ours=settings.seed),), points={1: "not at all", 7: "as named"})


@pytest.fixture
def two_experiments(monkeypatch):
    experiments = {
        "first": Experiment("one figure", run_first),
        "second": Experiment("no figure", run_second),
    }
    monkeypatch.setattr(run, "EXPERIMENTS", experiments)
    return experiments


def cells(page):
    return [html.unescape(cell) for cell in re.findall(r"<td>(.*?)</td>", page, re.DOTALL)]


def test_the_report_has_every_number_unit_note_and_figure(two_experiments, tmp_path, capsys):
    reproduce(folder=str(tmp_path))
    written = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")}
    assert written == {
        *("table.md", "table.html", "first/bell.png", "first/bell.svg"),
        *("first/result.json", "second/result.json"),
    }
    printed = capsys.readouterr().out
    for text in ("distance [m]", "7.123", "seed"):
        assert text in printed
    markdown = (tmp_path / "table.md").read_text("utf-8")
    assert "| distance [m] | 0.025 | 2.0 ± 0.1 | 7.123 | a\\|b <i> |" in markdown
    assert "| nothing | – | – | – |  |" in markdown
    assert "![A bell.](first/bell.png)" in markdown
    page = (tmp_path / "table.html").read_text("utf-8")
    assert cells(page)[:5] == ["distance [m]", "0.025", "2.0 ± 0.1", "7.123", "a|b <i>"]
    # It needs no other file.
    (image,) = re.findall(r'<img src="(.*?)"', page)
    assert image.startswith("data:image/png;base64,")
    assert not re.search(r"<(link|script|a)\b", page)


def test_all_seven_points_stand_in_the_table_with_what_was_measured(two_experiments, tmp_path):
    reproduce(folder=tmp_path)
    points = cells((tmp_path / "table.html").read_text("utf-8"))[-5 * len(POINTS) :]
    rows = [points[start : start + 5] for start in range(0, len(points), 5)]
    assert [row[0] for row in rows] == ["1", "2", "3", "4", "5", "6", "7"]
    for row, point in zip(rows, POINTS.values(), strict=True):
        assert row[1:4] == [point.subject, point.paper, point.data]
    ours = [row[4] for row in rows]
    assert (ours[0], ours[6]) == ("at iteration 30; not at all", "as named")
    assert set(ours[1:6]) == {"not measured in this run"}


def test_experiments_run_one_by_one_add_to_the_table(two_experiments, tmp_path):
    assert list(reproduce(["second"], tmp_path)) == ["second"]
    assert list(reproduce(["first"], tmp_path)) == ["first", "second"]
    # What was made with another seed is of another table.
    assert list(reproduce(["second"], tmp_path, seed=1)) == ["second"]


def test_an_interrupted_experiment_is_not_in_the_table(two_experiments, tmp_path):
    reproduce(folder=tmp_path)

    def interrupt(settings):
        raise KeyboardInterrupt

    two_experiments["first"] = Experiment("one figure", interrupt)
    with pytest.raises(KeyboardInterrupt):
        reproduce(["first"], tmp_path)
    assert list(reproduce(["second"], tmp_path)) == ["second"]


def edit(**changes):
    """Change entries of a result file, or drop those that are None."""

    def change(path):
        content = {**json.loads(path.read_text("utf-8")), **changes}
        path.write_text(json.dumps({key: value for key, value in content.items() if value}))

    return change


OTHERS = {"quick": False, "seed": 0, "version": "0.0.1"}
STALE = {
    "cut short": (lambda path: path.write_text(path.read_text("utf-8")[:60]), "is damaged"),
    "no text": (lambda path: path.write_bytes(b"\xff\xfe\x00"), "is damaged"),
    "no object": (lambda path: path.write_text("[]"), "is damaged"),
    "without rows": (edit(rows=None), "is damaged"),
    "rows of another form": (edit(rows=[{"amount": 3}]), "is damaged"),
    "points by name": (edit(points={"first": "at iteration 30"}), "is damaged"),
    "another version": (edit(settings=OTHERS), "was made by version 0.0.1"),
    "no version": (edit(settings={"quick": False, "seed": 0}), "was made by version unknown"),
    "a figure missing": (lambda path: (path.parent / "bell.png").unlink(), "bell.png is missing"),
}


@pytest.mark.parametrize(("change", "reason"), STALE.values(), ids=STALE)
def test_a_stale_result_is_named_and_made_anew(change, reason, two_experiments, tmp_path, capsys):
    whole = reproduce(folder=tmp_path)
    change(tmp_path / "first" / "result.json")
    capsys.readouterr()
    assert reproduce(["second"], tmp_path) == whole
    first, *_ = capsys.readouterr().err.splitlines()
    assert first.startswith(str(tmp_path / "first"))
    assert first.endswith(f"{reason} and is made anew")
    assert reproduce(["second"], tmp_path) == whole
    assert "anew" not in capsys.readouterr().err


def test_a_quick_run_says_so_and_prints_where_the_encoding_is_poor(
    two_experiments, tmp_path, capsys
):
    sections = reproduce(folder=tmp_path, quick=True)
    with open(tmp_path / "ascii.txt", "w", encoding="ascii") as file:
        print_report(Console(file=file, width=120), sections, quick=True)
    plain = (tmp_path / "ascii.txt").read_text("ascii")
    assert "2.0 +- 0.1" in plain
    for text in (capsys.readouterr().out, (tmp_path / "table.md").read_text("utf-8"), plain):
        assert "quick run" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["normalisation"],
            "'normalisation' is not accepted; did you mean 'normalization'",
        ),
        (["normalization", "kinetic"], "experiment 'kinetic' is not accepted"),
        (["--seed", "-1"], "seed must be 0 or more, got -1"),
        (["--jobs", "0"], "jobs must be 1 or more, got 0"),
    ],
)
def test_mistakes_end_with_one_line_before_anything_is_written(
    arguments, message, tmp_path, capsys
):
    with pytest.raises(SystemExit) as stop:
        main([*arguments, "--out", str(tmp_path / "out")])
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_result_is_written_as_pictures_and_data_the_same_each_time(tmp_path):
    frame = pd.DataFrame({"iteration": [1, 2], "distance": [0.5, 0.25]})
    angles, units = np.linspace(0, 1, 5), np.array(["4", "8, 8"])
    names = ["arrays.npz", "picture.png", "picture.svg", "table.csv"]
    for folder in (tmp_path / "one", tmp_path / "two"):
        result = Result(
            figures={"picture": Captioned(make_figure(), "")},
            data={"table": frame, "arrays": {"angles": angles, "units": units}},
        )
        assert sorted(path.name for path in write_result(result, folder)) == names
        assert sorted(path.name for path in folder.iterdir()) == names  # nothing besides
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    with np.load(tmp_path / "one" / "arrays.npz") as arrays:
        np.testing.assert_array_equal(arrays["angles"], angles)
        assert arrays["units"].tolist() == units.tolist()
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "one" / "table.csv"), frame)


def test_every_experiment_is_described_in_a_line():
    for experiment in EXPERIMENTS.values():
        assert len(experiment.description.splitlines()) == 1


def test_the_command_runs_named_experiments_end_to_end(tmp_path, capsys, monkeypatch):
    recipe = replace(networks.QUICK_RECIPE, samples=400, epochs=3)
    monkeypatch.setattr(networks, "QUICK_RECIPE", recipe)
    arguments = ["population", "normalization", "--quick", "--seed", "3", "--jobs", "1"]
    main([*arguments, "--out", str(tmp_path)])
    assert "[16]: validation MSE" in capsys.readouterr().out
    for name in ("normalization", "population"):
        content = json.loads((tmp_path / name / "result.json").read_text("utf-8"))
        assert content["settings"] == {"quick": True, "seed": 3, "version": Settings.version}
        assert content["rows"]
        for stem in content["captions"]:
            assert (tmp_path / name / f"{stem}.png").stat().st_size > 5000
            assert (tmp_path / name / f"{stem}.svg").exists()
    # One more than the architectures: the population's [8, 8] with weight decay.
    trained = len(networks.QUICK_ARCHITECTURES) + 1
    assert len(list((tmp_path / "networks").iterdir())) == trained
    assert EXPERIMENTS["population"].description in (tmp_path / "table.md").read_text("utf-8")
