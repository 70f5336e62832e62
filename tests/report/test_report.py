"""The report: one file that needs nothing beside it, whose words follow from its figures."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from inspect import signature

import numpy as np
import pytest

from mmc_gym.benchmark.statistics import RESAMPLES
from mmc_gym.cli import main
from mmc_gym.report import write_report
from mmc_gym.report.replay import replay
from mmc_gym.report.results import read_results

HOSTILE = "<script>alert(1)</script>"
VOID = {"meta", "link", "input", "br", "img", "hr"}


class Page(HTMLParser):
    """Ids, links, scripts, captions and the tags left open of an HTML page."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.loaded, self.tags, self.open = [], [], [], []
        self.unlabelled, self.captions, self.data = 0, [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append(tag)
        self.ids += [attrs["id"]] if "id" in attrs else []
        for name in ("src", "href", "xlink:href"):
            if name in attrs and not attrs[name].startswith(("#", "data:")):
                self.loaded.append(attrs[name])
        if tag == "img" and not attrs.get("alt"):
            self.unlabelled += 1
        if tag in ("caption", "figcaption"):
            self.captions.append("")
        if tag not in VOID:
            self.open.append((tag, attrs))

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open[-1][0] == tag, (tag, self.getpos())
        self.open.pop()

    def handle_data(self, data):
        if any(tag in ("caption", "figcaption") for tag, _ in self.open):
            self.captions[-1] += data
        if self.open and self.open[-1][1].get("id") == "replay-data":
            self.data += data


@pytest.fixture(scope="module")
def text(report_file):
    return report_file.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(text):
    return Page(text)


def test_the_file_needs_nothing_beside_it(page, text):
    assert page.loaded == []
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest", text)
    assert len(text) < 5_000_000


def test_the_page_is_well_formed_and_its_ids_are_unique(page, text):
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    references = set(re.findall(r'href="#([^"]+)', text))
    assert references <= set(page.ids)


def test_every_picture_says_what_it_shows(page):
    assert page.tags.count("img") > 5
    assert page.unlabelled == 0


def test_every_caption_counts_seeds_and_instances(page):
    assert len(page.captions) > 10
    for caption in page.captions:
        assert "nstances" in caption
        assert re.search("[Tt]raining seeds|[Nn]ot trained", caption), caption


def test_the_page_says_how_many_resamples_were_drawn(text):
    assert "bootstrap intervals of 200 resamples (ranking) and 200 (all measures)" in text
    assert signature(write_report).parameters["resamples"].default == RESAMPLES


def test_names_of_agents_are_text_not_markup(page, text):
    assert HOSTILE not in text
    assert "&lt;script&gt;alert(1)" in text
    assert page.tags.count("script") == 2
    assert "<b>no</b>" not in text


def test_the_replay_is_small_and_ends_at_the_hand(page, benchmark_store):
    assert len(page.data) < 1_500_000
    movement = json.loads(page.data)["scenes"]["random"][0]["agents"]["ik-dls"]
    paths = read_results(benchmark_store).paths
    rows = paths[(paths["agent"] == "ik-dls") & (paths["environment"] == "random")]
    last = rows[rows["instance"] == 0].iloc[-1]
    end = [sum(series) / 1000 for series in movement["hand"]]
    np.testing.assert_allclose(end, [last["hand_x"], last["hand_y"]], atol=6e-4)
    assert "cursor" not in movement


def replayed(results, paths):
    """Return the movement of mmc in the first instance, from other paths."""
    scenes = replay(replace(results, paths=paths))["scenes"]
    return scenes["random"][0]["agents"]["mmc"]


def test_where_a_cursor_stands_for_the_hand_the_replay_has_both(benchmark_store):
    results = read_results(benchmark_store, resamples=20)
    target = results.paths[["target_x", "target_y"]].to_numpy()
    paths = results.paths.assign(cursor_x=target[:, 0], cursor_y=target[:, 1] - 0.02)
    movement = replayed(results, paths)
    assert sum(movement["distance"]) / 10_000 == pytest.approx(0.02)
    end = [sum(series) / 1000 for series in movement["cursor"]]
    last = paths[(paths["agent"] == "mmc") & (paths["instance"] == 0)].iloc[-1]
    np.testing.assert_allclose(end, [last["cursor_x"], last["cursor_y"]], atol=6e-4)


def test_the_arm_of_the_replay_leads_to_the_hand(benchmark_store):
    results = read_results(benchmark_store, resamples=20)
    names = [f"joint_angle_{joint}" for joint in (1, 2, 3)]
    longer, angles = results.paths.copy(), results.paths[names].to_numpy().cumsum(axis=1)
    longer["hand_x"] += 0.5 * np.cos(angles[:, 2])  # of the last segment, unknown to all agents
    longer["hand_y"] += 0.5 * np.sin(angles[:, 2])
    np.testing.assert_allclose(replayed(results, longer)["lengths"], [1, 1, 1.5], atol=0.01)


@pytest.mark.parametrize("out", ["", "deep/new/folder"], ids=["into the store", "elsewhere"])
def test_the_command_writes_the_report(make_store, out, tmp_path, capsys):
    make_store(tmp_path, ["mmc"], ("random",), instances=5)
    file = tmp_path / out / "report.html"
    main(["report", "--store", str(tmp_path), *(["--out", str(file)] if out else [])])
    assert file.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert str(file) in capsys.readouterr().out


def test_a_folder_without_a_store_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["report", "--store", str(tmp_path), "--out", str(tmp_path / "report.html")])
    assert "store" in capsys.readouterr().err
