"""The report: one file, complete in itself, whose words follow from its figures."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from mmc_gym import UserError
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.store import read_episodes
from mmc_gym.cli import main
from mmc_gym.experiments.experiment import Block, Experiment
from mmc_gym.experiments.trials import run_experiment
from mmc_gym.report import replay, write_report
from mmc_gym.report.results import read_results
from tests.report.conftest import AGENTS, HOSTILE, write_store

VOID = {"meta", "link", "input", "br", "img", "hr"}


class Page(HTMLParser):
    """The ids of an HTML page; its tags must be closed in order."""

    def __init__(self, text):
        super().__init__()
        self.open = []
        self.ids = re.findall(r'<[^<>]* id="([^"]+)"', text)
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, self.getpos()


@pytest.fixture(scope="module")
def text(report_file):
    return report_file.read_text(encoding="utf-8")


def test_the_file_is_well_formed_and_complete_in_itself(text):
    page = Page(text)
    assert not re.search(r'<[^<>]* (src|href)="(?!#|data:)', text)
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest", text)
    assert len(text) < 5_000_000
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert set(re.findall(r'href="#([^"]+)', text)) <= set(page.ids)
    # Empty sections are left out: here there is no card of the own agent.
    assert set(page.ids) >= {"good", "scenarios", "fails", "replay-section", "given", "measures"}
    assert "learning" not in page.ids and "<img" not in text
    captions = re.findall("<figcaption>(.*?)</figcaption>", text, re.DOTALL)
    assert len(captions) >= 3 and all(captions)


def test_the_report_is_about_the_users_own_agent_from_its_first_line(text):
    body = text[text.index("<body>") :]
    shown = re.sub(r"\s+", " ", re.sub("<[^>]*>", " ", body))
    name = HOSTILE.replace("<", "&lt;").replace(">", "&gt;")
    assert shown.startswith(f" {name} {name} ends at the target in ")
    assert f"Success of {name} in each scenario" in text
    assert f"<title>{name}: benchmark" in text
    assert HOSTILE not in text and "<b>no</b>" not in text  # names are text, not markup
    assert text.count("<script") == 2


def test_an_agent_in_focus_with_a_learning_curve_has_a_figure(tmp_path):
    write_store(tmp_path, ["mmc", "ppo"], ("random",))
    page = write_report(tmp_path, tmp_path / "a.html", 20, focus="ppo").read_text()
    assert page.count("<img") == page.count('alt="Success during training') == 1


def test_markdown_has_the_tables_and_no_markup_of_the_user(benchmark_store, tmp_path):
    file = write_report(benchmark_store, tmp_path / "report.md", 20, format="md")
    lines = file.read_text().splitlines()
    assert lines[0] == "# &lt;script&gt;alert(1)&lt;/script&gt;"
    start = next(i for i, line in enumerate(lines) if line.startswith("| scenario |"))
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines[start : start + 10]]
    assert {len(row) for row in rows} == {7}  # the agent, and five others
    assert [row[0].strip() for row in rows[2:4]] == ["all scenarios", "random"]
    assert "success at the end, %" in file.read_text()


def test_a_report_in_which_no_agent_succeeds(tmp_path):
    lost = {name: AGENTS["mmc"]._replace(lost=0, duration=900, source="mmc") for name in "ab"}
    write_store(tmp_path, lost, ("random",))
    for file in tmp_path.glob("*/minimum*"):
        file.unlink()
    assert read_episodes(tmp_path)["success"].eq(0).all()
    text = write_report(tmp_path, tmp_path / "report.html", 20).read_text()
    assert "14 of 14" in text and "time to target" in text


@pytest.mark.parametrize("segments", [2, 4])
def test_arms_of_other_numbers_of_segments_are_replayed(segments, tmp_path):
    lengths = [1, 0.5, 0.7, 0.2][:segments]
    arguments = {"segment_lengths": lengths, "success_distance": 3.0}
    benchmark(["random"], tmp_path, ["random"], 2, jobs=1, env_kwargs=arguments)
    data = replay(read_results(tmp_path, 20))
    movement = data["scenes"]["random"][0]["agents"]["random"]
    assert movement["lengths"] == lengths and len(movement["angles"]) == segments
    assert data["worlds"]["random"] == {"step": 0.02, "lengths": lengths, "near": 3.0}
    text = write_report(tmp_path, tmp_path / "report.html", 20).read_text()
    assert "random ends at the target in 100.0 %" in text and "0.05" not in text


def test_the_replay_shows_cursors_and_arms_that_lead_to_the_hand(results):
    names = [f"joint_angle_{joint}" for joint in (1, 2, 3)]
    paths, angles = results.paths.copy(), results.paths[names].to_numpy().cumsum(axis=1)
    paths["hand_x"] += 0.5 * np.cos(angles[:, 2])  # of the last segment, unknown to all agents
    paths["hand_y"] += 0.5 * np.sin(angles[:, 2])
    paths["cursor_x"], paths["cursor_y"] = paths["target_x"], paths["target_y"] - 0.02
    changed = replace(results)
    changed.__dict__["paths"] = paths
    (scene,) = [scene for scene in replay(changed)["scenes"]["random"] if scene["instance"] == 1]
    movement = scene["agents"]["mmc"]
    np.testing.assert_allclose(movement["lengths"], [1, 1, 1.5], atol=0.01)
    assert sum(movement["distance"]) / 10_000 == pytest.approx(0.02)
    rows = paths.query("agent == 'mmc' and environment == 'random' and instance == 0")
    end = [sum(series) / 1000 for series in movement["cursor"]]
    np.testing.assert_allclose(end, rows[["cursor_x", "cursor_y"]].iloc[-1], atol=6e-4)


def test_the_command_writes_the_report(tmp_path, capsys):
    write_store(tmp_path, ["mmc"], ("random",), instances=5)
    main(["report", str(tmp_path)])
    assert str(tmp_path / "report.html") in capsys.readouterr().out
    out = tmp_path / "deep" / "new" / "report.html"
    main(["report", str(tmp_path), "--out", str(out), "--focus", "mmc"])
    assert out.read_text("utf-8").startswith("<!doctype html>")
    assert out.read_bytes() == (tmp_path / "report.html").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"out": "."}, "out must be a file"),
        ({"out": "a\0b"}, r"out must be a path, got 'a\\x00b'"),
        ({"focus": print}, "focus must be a name, or several"),
        ({"focus": ["mcm"]}, "focus 'mcm' is not accepted; did you mean 'mmc'"),
        ({"format": "pdf"}, "format 'pdf' is not accepted"),
    ],
)
def test_what_is_no_report_is_refused(arguments, message, benchmark_store, tmp_path):
    with pytest.raises(UserError, match=message):
        write_report(benchmark_store, **{"out": tmp_path / "report.html", **arguments})


@pytest.fixture(scope="module")
def experiments(tmp_path_factory):
    store = tmp_path_factory.mktemp("experiments")
    blocks = (Block("baseline", 8), Block("learning", 8, "clamp-20"))
    clamped = Experiment("clamp-20", blocks, trial_seconds=0.4, family="clamp")
    for agents, subjects in ((["ik-dls"], 1), ({"ik-dls": "ik-dls", HOSTILE: "mmc"}, 2)):
        run_experiment(clamped, agents, subjects, out=store, jobs=1)
    return store


def test_a_store_of_experiments_has_a_report_of_them(experiments, tmp_path):
    file = tmp_path / "report.html"
    main(["report", str(experiments), "--out", str(file), "--focus", "ik-dls"])
    text = file.read_text(encoding="utf-8")
    assert re.findall("<h2>(.*?)</h2>", text) == ["Learning over trials", "Method"]
    people, mine, _ = re.findall(r"<tr.*?</tr>", text.partition("<tbody>")[2], re.DOTALL)
    assert ">people<" in people and ">18<" in people and "Tsay et al. 2020" in people
    assert ">ik-dls<" in mine and 'class="focus"' in mine
    assert "Of the mean over 2 subjects" in text
    assert HOSTILE not in text and "<script" not in text
    assert text.count("data:image/svg+xml") == 1
    markdown = write_report(experiments, tmp_path / "report.md", format="md").read_text("utf-8")
    assert "## Learning in clamp-20" in markdown and "| people | 18 Tsay et al. 2020 |" in markdown
    for focus in ("ik-dsl", ["ik-dsl"]):
        with pytest.raises(UserError, match="'ik-dsl' is not accepted; did you mean 'ik-dls'"):
            write_report(experiments, file, focus=focus)


def test_a_report_has_benchmark_and_experiments_of_a_store(experiments, tmp_path):
    write_store(tmp_path, ["mmc"], ("random",), instances=5)
    (tmp_path / "trials").symlink_to(experiments / "trials")
    text = write_report(tmp_path, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>mmc</h1>" in text and 'id="good"' in text and 'id="experiments"' in text
