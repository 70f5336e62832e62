"""The playground does what the package does, and works by mouse, touch and keyboard."""

import json
import math
import runpy
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.common.action_chains import ActionBuilder, ActionChains
from selenium.webdriver.common.actions.pointer_input import PointerInput
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

from tests.conftest import assert_quiet, resize, wait_until

FOLDER = Path(__file__).parents[1] / "docs" / "playground"
STALE = "run python docs/playground/write_data.py"
SIZES = {1400: (1400, 900, 1), 375: (375, 812, 2)}

GOLDEN = """
const golden = arguments[0], { data, exact, leaveLine, learned, observe, wrap } = playground;
const { Body, Network, Policy } = playground;
const apart = (a, b) => Array.isArray(a)
  ? a.length === b.length ? Math.max(0, ...a.map((part, i) => apart(part, b[i]))) : Infinity
  : Math.abs(a - b);
const most = (cases, difference) => Math.max(...cases.map(difference));
const normalizers = { exact };
for (const name in data.normalizers) normalizers[name] = learned(data.normalizers[name]);
const policy = new Policy(data.policy);
return {
  network: most(golden.network, (one) => {
    const normalize = normalizers[one.normalizer];
    const network = new Network({ ...one, ...data.network, normalize });
    const run = (locks) => {
      let state = network.atRest(one.angles);
      for (let k = 0; k < one.iterations; k++) state = network.iterate(state, one.target, locks);
      return state;
    };
    const free = run(one.locks.map(() => null)), rigid = run(one.locks);
    return Math.max(apart(free.vectors, one.free), apart(rigid.vectors, one.rigid),
      apart(network.jointAngles(free), one.jointAngles));
  }),
  straight: most(golden.straight, (one) =>
    apart(leaveLine(one.angles, one.target, one.lengths), one.bent)),
  observation: most(golden.policy, (one) =>
    apart(observe({ ...one, near: data.near }), one.observation)),
  policy: most(golden.policy, (one) => apart(policy.act(one.observation), one.action)),
  body: most(golden.body, ({ lengths, start, goals, steps, postures }) => {
    const body = new Body({ lengths, angles: start, physics: data.physics });
    return Math.max(...goals.map((goal, i) => {
      for (let k = 0; k < steps; k++) body.follow(goal, goal.map(() => false));
      return apart(body.angles.map(wrap), postures[i].map(wrap));
    }));
  }),
};
"""


@pytest.fixture
def page(browser):
    """The playground, freshly loaded from its file, at a desk."""
    load(browser, 1400)
    return browser


def load(browser, width, *, runs=False):
    """Load the page and touch it; unless it runs, only `settle` moves the arm."""
    resize(browser, *SIZES[width])
    browser.get("about:blank")  # the page that is touched is the new one
    browser.get((FOLDER / "index.html").as_uri())
    ready = "return Boolean(window.playground?.scene)"
    wait_until(browser, lambda: browser.execute_script(ready))
    browser.execute_script("document.dispatchEvent(new Event('pointerdown'))")
    if not runs:
        browser.execute_script("document.getElementById('run').click()")


def ask(page, expression):
    return page.execute_script(f"const {{ scene, view }} = playground; return {expression}")


def wait_until_there(page):
    there = "scene.hasSettled && scene.distance(scene.bodies.mmc) < 0.01"
    wait_until(page, lambda: ask(page, there))


def settle(page):
    """Let the same happen, without waiting for the clock."""
    ask(page, "scene.settle(), playground.show()")
    assert ask(page, "scene.distance(scene.bodies.mmc)") < 0.01


def on_screen(page, point):
    """Return where a point of the scene is in the window, after bringing the stage there."""
    return page.execute_script(
        "const { view } = playground, [x, y] = view.place(arguments[0]);"
        "view.stage.scrollIntoView({ block: 'center', behavior: 'instant' });"
        "const box = view.stage.getBoundingClientRect();"
        "return [box.left + box.width / 2 + x, box.top + box.height / 2 + y]",
        point,
    )


def drag(page, start, end, kind):
    """Press at a place in the window and let go at another."""
    builder = ActionBuilder(page, mouse=PointerInput(kind, kind), duration=20)
    pointer = builder.pointer_action
    pointer.move_to_location(*map(round, start)).pointer_down()
    for part in (0.3, 0.6, 1.0):
        pointer.move_to_location(*(round(a + part * (b - a)) for a, b in zip(start, end)))
    pointer.pointer_up()
    builder.perform()


def press(page, selector, *keys):
    """Give an element the focus, and press keys."""
    page.execute_script("document.querySelector(arguments[0]).focus()", selector)
    ActionChains(page, duration=0).send_keys(*keys).perform()


def test_the_written_data_are_what_the_package_gives_today():
    written = runpy.run_path(str(FOLDER / "write_data.py"))
    assert (FOLDER / "data.js").read_text() == written["data_text"](), STALE
    golden, now = json.loads((FOLDER / "golden.json").read_text()), written["golden"]()
    assert golden.keys() == now.keys()
    for name, tolerance in {"network": 1e-12, "straight": 0, "policy": 1e-6, "body": 1e-4}.items():
        for before, after in zip(golden[name], now[name], strict=True):
            assert before.keys() == after.keys()
            for key, value in before.items():
                assert after[key] == value or np.allclose(after[key], value, 0, tolerance), STALE


def marked(test):
    """Mark a test that needs the browser."""
    return pytest.mark.slow(pytest.mark.xdist_group("browser")(test))


@marked
def test_the_page_computes_what_the_package_computes(page):
    golden = json.loads((FOLDER / "golden.json").read_text())
    apart = page.execute_script(GOLDEN, golden)
    assert max(apart["network"], apart["straight"]) < 1e-12
    assert max(apart["observation"], apart["policy"]) < 1e-6
    assert apart["body"] < 0.01  # radians; a sketch of pymunk's arm, and much nearer than this
    assert {len(network["lengths"]) for network in golden["network"]} == set(range(2, 9))


@marked
def test_nothing_is_logged_and_nothing_asked_of_a_network(page):
    assert ask(page, "scene.count") == 3
    assert_quiet(page)


@marked
@pytest.mark.parametrize("width", SIZES)
def test_the_hand_follows_a_target_that_is_dragged(browser, width):
    load(browser, width, runs=True)
    wait_until_there(browser)
    start = on_screen(browser, ask(browser, "scene.target"))
    kind = "mouse" if width == 1400 else "touch"
    drag(browser, start, on_screen(browser, [1.2, -1.4]), kind)
    assert ask(browser, "scene.target") == pytest.approx([1.2, -1.4], abs=0.05)
    wait_until_there(browser)
    sizes = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert sizes[0] <= sizes[1] == width


@marked
def test_the_ring_is_what_a_lock_leaves(page):
    assert ask(page, "scene.ring") == {"centre": [0, 0], "outer": 3, "inner": 0}
    ask(page, "scene.setLocked(1, true)")
    bent = ask(page, "scene.bodies.mmc.angles[1]")
    link = 2 * math.cos(bent / 2)  # of the first two segments
    ring = ask(page, "scene.ring")
    assert (ring["outer"], ring["inner"]) == pytest.approx((link + 1, link - 1))
    ask(page, "scene.setLocked(0, true)")
    assert ask(page, "scene.ring.outer") == pytest.approx(1)
    assert math.hypot(*ask(page, "scene.ring.centre")) == pytest.approx(link)
    ask(page, "Math.random = () => 0.3, scene.drawTarget()")
    settle(page)  # the hand arrives at targets that are drawn from it


@marked
@pytest.mark.parametrize("width", SIZES)
def test_the_hand_arrives_with_a_joint_locked_and_a_segment_longer(browser, width):
    load(browser, width)
    settle(browser)
    press(browser, "[data-node='1']", " ")
    handle = browser.find_element(By.CSS_SELECTOR, "[data-node='1']")
    assert handle.get_attribute("aria-valuetext") == "length 1.00, joint locked"
    locked = ask(browser, "scene.bodies.mmc.angles[1]")
    press(browser, ".target", *[Keys.ARROW_RIGHT] * 5)
    assert ask(browser, "scene.target") == pytest.approx([-0.5, 1.5])
    settle(browser)
    on_screen(browser, [0, 0])
    grip = browser.execute_script(
        "const box = document.querySelector(\"[data-node='3']\").getBoundingClientRect();"
        "return [box.left + box.width / 2, box.top + box.height / 2]"
    )
    x, y = on_screen(browser, ask(browser, "scene.bodies.mmc.hand"))
    away = 1 + 40 / math.hypot(grip[0] - x, grip[1] - y)
    drag(browser, grip, [x + away * (grip[0] - x), y + away * (grip[1] - y)], "touch")
    *others, longer = ask(browser, "scene.lengths")
    assert others == [1, 1] and longer > 1.15
    settle(browser)
    assert ask(browser, "scene.bodies.mmc.angles[1]") == locked
    press(browser, "[data-node='1']", Keys.ENTER)
    assert ask(browser, "scene.locked") == [False, False, False]


@marked
@pytest.mark.parametrize(("count", "key", "width"), [(2, Keys.HOME, 1400), (8, Keys.END, 375)])
def test_arms_of_two_to_eight_segments_reach(browser, count, key, width):
    load(browser, width)
    press(browser, "#segments", key)
    assert ask(browser, "scene.count") == count
    handles = browser.find_elements(By.CSS_SELECTOR, ".handle")
    assert len(handles) == count + 2  # joints, the hand and the target
    for name in ("aria-label", "role"):
        assert all(handle.get_attribute(name) for handle in handles)
    assert browser.find_element(By.ID, "ppo-says").text == "cannot act"
    settle(browser)


@marked
def test_what_the_triangles_say_comes_to_agree_in_the_network_that_is_chosen(page):
    settle(page)
    page.find_element(By.ID, "means").click()
    press(page, ".target", Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    page.find_element(By.ID, "once").click()
    assert ask(page, "scene.iterations") == 1
    dots = "view.shapes.spread.getAttribute('d').split('a').length - 1"
    assert ask(page, dots) == 2 * 6 * 2  # two arcs for each of two triangles of six vectors
    assert ask(page, "scene.disagreement") > 0.05
    for dynamics, normalizer in (("kinematic", "accurate"), ("dynamic", "exact")):
        Select(page.find_element(By.ID, "dynamics")).select_by_value(dynamics)
        Select(page.find_element(By.ID, "normalizer")).select_by_value(normalizer)
        settings = [dynamics == "dynamic", normalizer]
        assert ask(page, "[scene.settings.dynamic, scene.settings.normalizer]") == settings
        settle(page)
    assert ask(page, "scene.disagreement") < 1e-3


@marked
def test_without_motion_the_end_of_the_movement_is_shown_at_once(page):
    reduced = {"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]}
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", reduced)
    try:
        load(page, 1400, runs=True)
        press(page, ".target", *[Keys.ARROW_DOWN] * 8)
        picture = "[scene.distance(scene.bodies.mmc) < 0.01, view.stage.innerHTML]"
        first = ask(page, picture)
        assert first[0]
        page.execute_async_script("setTimeout(arguments[0], 200)")
        assert ask(page, picture) == first
    finally:
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
