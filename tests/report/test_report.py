"""The report: one file that needs nothing beside it, whose words follow from its figures."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from mmc_gym._errors import UserError
from mmc_gym.cli import main
from mmc_gym.report import write_report
from mmc_gym.report.replay import replay

HOSTILE = "<script>alert(1)</script>"
VOID = {"meta", "link", "input", "br", "img", "hr"}


class Page(HTMLParser):
    """What a test asks of an HTML page; its tags must be closed in order."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.open = [], []
        self.ids = re.findall(r'<[^<>]* id="([^"]+)"', text)
        self.pictures = re.findall("<img[^>]*>", text)
        self.captions = re.findall("<(?:fig)?caption>(.*?)</(?:fig)?caption>", text, re.DOTALL)
        self.data = re.search('id="replay-data">(.*?)</script>', text)[1]
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, self.getpos()


@pytest.fixture(scope="module")
def text(report_file):
    return report_file.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(text):
    return Page(text)


def test_the_file_needs_nothing_beside_it(text):
    assert not re.search(r'<[^<>]* (src|href)="(?!#|data:)', text)
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest", text)
    assert len(text) < 5_000_000


def test_the_page_is_well_formed_and_its_ids_are_unique(page, text):
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    references = set(re.findall(r'href="#([^"]+)', text))
    assert references <= set(page.ids)


def test_every_picture_says_what_it_shows_and_every_caption_counts_seeds_and_instances(page):
    assert len(page.pictures) > 5
    assert all(re.search('alt="[^"]', picture) for picture in page.pictures)
    assert len(page.captions) > 10
    for caption in page.captions:
        assert "nstances" in caption
        assert re.search("[Tt]raining seeds|[Nn]ot trained", caption), caption


def test_the_report_states_how_many_resamples_its_intervals_have(text):
    said = " ".join(text.split())
    assert "intervals of 200 resamples (ranking) and 200 (all measures)" in said


def test_names_of_agents_are_text_not_markup(page, text):
    assert HOSTILE not in text
    assert "&lt;script&gt;alert(1)" in text
    assert page.tags.count("script") == 2
    assert "<b>no</b>" not in text


def test_the_replay_is_small_and_ends_at_the_hand(page, results):
    assert len(page.data) < 1_500_000
    movement = json.loads(page.data)["scenes"]["random"][0]["agents"]["ik-dls"]
    paths = results.paths
    rows = paths[(paths["agent"] == "ik-dls") & (paths["environment"] == "random")]
    last = rows[rows["instance"] == 0].iloc[-1]
    end = [sum(series) / 1000 for series in movement["hand"]]
    np.testing.assert_allclose(end, [last["hand_x"], last["hand_y"]], atol=6e-4)
    assert "cursor" not in movement


def replayed(results, paths):
    """Return the movement of mmc in the first instance, from other paths."""
    scenes = replay(replace(results, paths=paths))["scenes"]
    return scenes["random"][0]["agents"]["mmc"]


def test_where_a_cursor_stands_for_the_hand_the_replay_has_both(results):
    target = results.paths[["target_x", "target_y"]].to_numpy()
    paths = results.paths.assign(cursor_x=target[:, 0], cursor_y=target[:, 1] - 0.02)
    movement = replayed(results, paths)
    assert sum(movement["distance"]) / 10_000 == pytest.approx(0.02)
    end = [sum(series) / 1000 for series in movement["cursor"]]
    last = paths[(paths["agent"] == "mmc") & (paths["instance"] == 0)].iloc[-1]
    np.testing.assert_allclose(end, [last["cursor_x"], last["cursor_y"]], atol=6e-4)


def test_the_arm_of_the_replay_leads_to_the_hand(results):
    names = [f"joint_angle_{joint}" for joint in (1, 2, 3)]
    longer, angles = results.paths.copy(), results.paths[names].to_numpy().cumsum(axis=1)
    longer["hand_x"] += 0.5 * np.cos(angles[:, 2])  # of the last segment, unknown to all agents
    longer["hand_y"] += 0.5 * np.sin(angles[:, 2])
    np.testing.assert_allclose(replayed(results, longer)["lengths"], [1, 1, 1.5], atol=0.01)


def test_the_command_writes_the_report_and_refuses_a_folder_without_a_store(
    make_store, tmp_path, capsys
):
    make_store(tmp_path / "store", ["mmc"], ("random",), instances=5)
    elsewhere = tmp_path / "deep" / "new" / "report.html"
    for file, options in (
        (tmp_path / "store" / "report.html", []),
        (elsewhere, ["--out", str(elsewhere)]),
    ):
        main(["report", str(tmp_path / "store"), *options])
        assert file.read_text(encoding="utf-8").startswith("<!doctype html>")
        assert str(file) in capsys.readouterr().out
    with pytest.raises(UserError, match="out must be a file"):
        write_report(tmp_path / "store", tmp_path)
    with pytest.raises(SystemExit, match="2"):
        main(["report", str(tmp_path), "--out", str(tmp_path / "report.html")])
    assert "store" in capsys.readouterr().err
