"""The report in a real browser: nothing goes wrong, the replay moves, it fits on a phone."""

import base64
import os
import re
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.store import read_episodes
from mmc_gym.report import write_report
from tests.conftest import assert_quiet, resize, wait_until
from tests.report.conftest import HOSTILE

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("browser")]


@pytest.fixture(scope="module")
def rotated(tmp_path_factory):
    """A benchmark that was played, with a cursor in place of the hand, and its report."""
    store = tmp_path_factory.mktemp("rotated")
    benchmark(["mmc", "mmc-body"], store, ["random", "rotation-30"], episodes=3, jobs=1)
    return store, write_report(store, store / "report.html", resamples=20)


@pytest.fixture
def page(browser, report_file):
    """The report, freshly loaded in a desktop window."""
    load(browser, report_file)
    return browser


def load(browser, report):
    resize(browser, 1200, 900)
    browser.get(report.as_uri())
    # A new page may be given its size late, and its canvases theirs later still.
    settled = (
        "const one = document.querySelector('#replay canvas');"
        "return innerWidth === 1200 && devicePixelRatio === 1 && one.width === one.clientWidth"
    )
    wait_until(browser, lambda: browser.execute_script(settled))


def pictures(browser):
    """What the canvases of the replay show."""
    return browser.execute_script(
        "return [...document.querySelectorAll('#replay canvas')].map(one => one.toDataURL())"
    )


def seek(browser, step):
    browser.execute_script(
        "const slider = document.getElementById('replay-time'); slider.value = arguments[0];"
        "slider.dispatchEvent(new Event('input'))",
        step,
    )


def choose(browser, name, value):
    Select(browser.find_element(By.ID, f"replay-{name}")).select_by_value(value)


def keep(name, content):
    """Write base64 content of the browser into the folder MMC_GYM_ARTEFACTS, if that is set."""
    if folder := os.environ.get("MMC_GYM_ARTEFACTS"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        (Path(folder) / name).write_bytes(base64.b64decode(content))


def screenshot(browser, name):
    """Keep a picture of the whole page."""
    shot = browser.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True})
    keep(name, shot["data"])
    assert len(shot["data"]) > 50_000


def test_nothing_is_logged_and_nothing_loaded_from_a_network(page):
    assert_quiet(page)
    # A name that is a script does not run.
    assert HOSTILE in page.execute_script("return document.body.innerText")
    screenshot(page, "report.png")


def test_slider_and_keys_move_the_replay_and_it_plays_and_pauses(page):
    seek(page, 0)
    begin = pictures(page)
    seek(page, 12)
    assert len(begin) >= 4  # an arm and a speed of two agents at least
    assert all(before != after for before, after in zip(begin, pictures(page), strict=True))
    stage = page.find_element(By.ID, "replay-stage")
    for key, clock in ((Keys.HOME, "0.00 s"), (Keys.ARROW_RIGHT, "0.02 s")):
        stage.send_keys(key)
        assert page.find_element(By.ID, "replay-clock").text == clock
    seek(page, 0)
    # A frame that began before the click is no way back.
    press = "const now = performance.now.bind(performance); performance.now = () => now() + 50;"
    press += "const play = document.getElementById('replay-play'); play.click();"
    assert "Pause" in page.execute_script(f"{press} return play.textContent")
    wait_until(page, lambda: pictures(page) != begin)
    seek(page, 0)  # pauses, too
    assert pictures(page) == begin
    assert "Play" in page.execute_script(f"{press} play.click(); return play.textContent")


def test_the_replay_ends_at_the_distance_that_was_measured(browser, rotated):
    store, report = rotated
    episodes = read_episodes(store).set_index(["environment", "instance", "agent"])
    load(browser, report)
    apart = []
    for environment in ("random", "rotation-30"):
        choose(browser, "environment", environment)
        for instance in range(3):
            choose(browser, "instance", str(instance + 1))
            for view in browser.find_elements(By.CLASS_NAME, "view"):
                name = view.find_element(By.TAG_NAME, "figcaption").text
                said = view.find_element(By.CLASS_NAME, "readout").text
                row = episodes.loc[(environment, instance, name)]
                shown = float(re.search(r"\d+\.\d+", said)[0])
                assert shown == pytest.approx(row["final_distance"], abs=6e-4)
                assert ("there" in said) == bool(row["success"])
                assert ("cursor" in said) == (environment != "random")
                apart.append(row["success"])
    screenshot(browser, "replay-rotation.png")
    assert len(apart) == 12
    assert 0 < sum(apart) < 12  # the cursor of one is there where that of the other is not


def test_environment_instance_and_agents_can_be_chosen(page):
    first = pictures(page)
    choose(page, "instance", "2")
    second = pictures(page)
    choose(page, "environment", "rotation-60")
    third = pictures(page)
    assert first != second != third
    boxes = page.find_elements(By.CSS_SELECTOR, "#replay-agents input")
    shown = sum(box.is_selected() for box in boxes)
    assert len(pictures(page)) == 2 * shown
    box = next(box for box in boxes if box.is_selected())
    page.execute_script("arguments[0].click()", box)  # it may lie outside the window
    assert len(pictures(page)) == 2 * (shown - 1)


def test_a_failure_in_the_table_is_shown_by_the_replay(page):
    first = pictures(page)
    link = page.find_elements(By.CSS_SELECTOR, "button.show")[-1]
    page.execute_script("arguments[0].click()", link)
    for select, name in (("environment", "scenario"), ("instance", "instance")):
        option = Select(page.find_element(By.ID, f"replay-{select}")).first_selected_option
        assert option.get_attribute("value") == link.get_attribute(f"data-{name}")
    assert "failed" in option.text
    assert pictures(page) != first


@pytest.mark.parametrize("width", [320, 375, 768])
def test_the_page_fits_the_width_of_a_small_screen(page, width):
    resize(page, width, 812, scale=2)
    sizes = page.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert sizes[0] <= sizes[1] == width
    if width == 375:
        wait_until(page, lambda: page.find_elements(By.CSS_SELECTOR, ".scroll.scrolls"))
        screenshot(page, "report-phone.png")


@pytest.mark.parametrize(("scheme", "darkest"), [("light", "text"), ("dark", "ground")])
def test_text_is_readable_on_a_light_and_on_a_dark_ground(page, scheme, darkest):
    feature = {"name": "prefers-color-scheme", "value": scheme}
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    look = "const look = getComputedStyle(document.querySelector(arguments[0]));"
    look += "return [look.color, look.backgroundColor].map(one => one.match(/\\d+/g).map(Number))"
    for part in ("body", "tbody th", "select", "#replay-play"):
        text, ground = (np.mean(colour[:3]) for colour in page.execute_script(look, part))
        assert abs(text - ground) > 120, part
        if part == "body":
            assert (text < ground) == (darkest == "text")
    screenshot(page, f"report-{scheme}.png")
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_on_paper_all_tables_are_open(page):
    printed = page.execute_cdp_cmd(
        "Page.printToPDF", {"printBackground": True, "preferCSSPageSize": True}
    )
    keep("report.pdf", printed["data"])
    assert base64.b64decode(printed["data"]).startswith(b"%PDF")
    page.execute_script("dispatchEvent(new Event('beforeprint'))")
    closed = "return document.querySelectorAll('details:not([open])').length"
    assert page.execute_script(closed) == 0
    page.execute_script("dispatchEvent(new Event('afterprint'))")
    assert page.execute_script(closed) > 0
