"""Settings and fixtures that all tests share."""

import math
import os
import re
import shutil
from types import SimpleNamespace
from typing import get_args

# Before any library is imported.
# One thread a worker: the tests run in parallel already, and sums keep their order.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# No display is needed, and none is opened.
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("SDL_AUDIODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# Tables are as wide as for a reader without a terminal; readline sets it for workers of pytest.
os.environ.pop("COLUMNS", None)

import gymnasium as gym  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from filelock import FileLock  # noqa: E402
from hypothesis import settings  # noqa: E402

import mmc_gym  # noqa: E402, F401  registers the environments
from mmc_gym.body import Engine  # noqa: E402
from mmc_gym.envs.names import TASKS  # noqa: E402
from mmc_gym.envs.perturbations import FAMILIES  # noqa: E402
from mmc_gym.measures import MEASURES, Episode  # noqa: E402

# A deadline measures the machine, not the code.  Where CI is set the examples are the same in
# every run; elsewhere hypothesis looks for new ones.
settings.register_profile("local", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")


class Oracle:
    """An agent that knows a posture for every target: segments along an arc, q = (β − φ, φ, φ).

    Its hand is at the distance |1 + e^{iφ} + e^{2iφ}| = 1 + 2 cos φ from the base.  Its actions are
    those of `joint_delta`, the default.
    """

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        values = observation.astype(np.float64)
        _, second, third = np.arctan2(values[3:6], values[:3])
        x, y = values[9:11]  # in the first segment's frame
        bend = math.acos(np.clip((math.hypot(x, y) - 1) / 2, -1, 1))
        turns = (math.atan2(y, x) - bend, bend - second, bend - third)
        action = [math.remainder(turn, math.tau) * 12 / math.tau for turn in turns]
        return np.array(action, np.float32).clip(-1, 1), None


@pytest.fixture
def oracle():
    return Oracle()


@pytest.fixture
def frozen():
    """An agent whose target posture is always the present one, so that it never moves."""
    return SimpleNamespace(predict=lambda seen, *_, **__: (np.zeros_like(seen[..., :3]), None))


@pytest.fixture
def env():
    env = gym.make("MMCReach-v0")
    yield env
    env.close()


@pytest.fixture(scope="session", params=get_args(Engine))
def engine(request):
    return request.param


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """Return a folder that the first of all workers that asks for it has filled."""
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def folder_of(name, fill):
        folder = base / name
        with FileLock(base / f"{name}.lock"):
            if not folder.is_dir():
                folder.mkdir()
                fill(folder)
        return folder

    return folder_of


@pytest.fixture
def forget_what_is_registered():
    registries = FAMILIES, MEASURES, TASKS, gym.registry
    before = [dict(registry) for registry in registries]
    yield
    for registry, entries in zip(registries, before, strict=True):
        registry.clear()
        registry.update(entries)


def by_night(values, daily):
    """Return parameters of a test of which all but some are slow."""
    slow = pytest.mark.slow
    return [value if value in daily else pytest.param(value, marks=slow) for value in values]


def episode_of(hands, targets, control_step=0.02, joint_angles=None, **changes):
    """Make an episode of these hand positions and targets; the servos do nothing."""
    hands = np.array(hands, dtype=np.float64)
    targets = np.broadcast_to(np.array(targets, dtype=np.float64), hands.shape)
    joint_angles = np.zeros((len(hands), 3)) if joint_angles is None else np.array(joint_angles)
    nothing = np.zeros_like(joint_angles[1:])
    values = {
        "seed": 0,
        "hands": hands,
        "distances": np.linalg.norm(hands - targets, axis=-1),
        "targets": targets,
        "joint_angles": joint_angles,
        "servo_impulses": nothing,
        "servo_work": nothing,
        "rewards": np.zeros(len(nothing)),
        "action_times": np.full(len(nothing), 1e-5),
        "control_step": control_step,
        "tolerance": 0.05,
        "reach": 3.0,
    }
    return Episode(**{**values, **changes})


@pytest.fixture
def make_episode():
    return episode_of


CHROMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",  # they may appear after the page and make it narrower
)
PATIENCE = 120  # seconds; the machine may be busy


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """A browser without a window; the test is skipped without Chromium and its driver."""
    chrome = next(filter(None, map(shutil.which, CHROMES)), None)
    driver = shutil.which("chromedriver")
    if not (chrome and driver):
        pytest.skip("no Chromium with chromedriver (Debian: apt install chromium chromium-driver)")
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = chrome
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options=options, service=Service(driver))
    browser.set_page_load_timeout(PATIENCE)
    browser.set_script_timeout(PATIENCE)
    yield browser
    browser.quit()


def resize(browser, width, height, scale=1):
    metrics = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def wait_until(browser, condition):
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, PATIENCE, 0.05).until(lambda _: condition())


def assert_quiet(browser):
    """Nothing is logged, and nothing was asked of a network."""
    asked = " ".join(line["message"] for line in browser.get_log("performance"))
    urls = re.findall(r'"Network.requestWillBeSent".*?"url":"(\w+):', asked)
    assert "file" in urls and not {"http", "https", "ws", "wss"} & set(urls)
    assert [entry for entry in browser.get_log("browser") if entry["level"] != "INFO"] == []
