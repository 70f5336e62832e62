"""The site builds without a warning, and its pages show what they should.

The site is that in the folder MMC_GYM_SITE, which `make docs` has built.  Without one it is built
here, without running examples, which other tests do, and without films.  The pictures in it are
those that the commands next to them draw.
"""

import inspect
import os
import re
import runpy
import shutil
import subprocess
import sys
from functools import cache
from html import unescape
from importlib.metadata import version
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from PIL import Image

import mmc_gym
from mmc_gym.benchmark.suite import SCENARIOS
from mmc_gym.envs.names import TASKS
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.envs.reach import MMCReachEnv, MMCReachGoalEnv
from mmc_gym.envs.scenarios import parse_scenario
from tests.conftest import resize, wait_until
from tests.processes import run_python

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
MADE = ("_generated", "envs", "examples", "sg_execution_times.rst", "__pycache__")
BESIDE = ("AGENTS.md", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md")
QUICKLY = ("-D", "plot_gallery=0", "-D", "films=none")

pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="the documentation is not here")


def build(tree):
    shutil.copytree(DOCS, tree / "docs", ignore=shutil.ignore_patterns(*MADE))
    shutil.copytree(ROOT / "examples", tree / "examples")
    for name in BESIDE:
        shutil.copyfile(ROOT / name, tree / name)
    command = [sys.executable, "-m", "sphinx", "-n", "-W", "--keep-going", "-q", *QUICKLY]
    done = subprocess.run([*command, tree / "docs", tree / "site"], capture_output=True, text=True)
    (tree / "log").write_text(f"{done.returncode}\n{done.stderr}")


@pytest.fixture(scope="module")
def site(once):
    if built := os.environ.get("MMC_GYM_SITE"):
        return Path(built)
    tree = once("site", build)
    log = (tree / "log").read_text()
    assert log == "0\n", log
    return tree / "site"


CODE = re.compile(r"<(pre|code|script|style)\b.*?</\1>", re.DOTALL)


@cache
def anchors(path):
    """Return the anchors of a page."""
    return {"", *re.findall(r'<[^<>]* (?:id|name)="([^"]+)"', path.read_text(encoding="utf-8"))}


def pages(site):
    """Return the pages that Sphinx writes; playground and report are tested elsewhere."""
    others = ("_static", "playground", "report")
    paths = [path for path in site.rglob("*.html") if path.parent.name not in others]
    assert len(paths) > 100
    return paths


@pytest.mark.slow
def test_every_scenario_has_a_page(site):
    for name in {*SCENARIOS, *TASKS, *(parse_scenario(name).name for name in FAMILIES)}:
        text = re.sub("<[^>]+>", "", (site / "envs" / f"{name}.html").read_text())
        assert re.search(rf"mmc-gym benchmark --\w+ {name}\b", text)


@pytest.mark.slow
@pytest.mark.parametrize(("page", "kind"), [("reach", MMCReachEnv), ("goal", MMCReachGoalEnv)])
def test_the_page_of_an_environment_lists_its_arguments(site, page, kind):
    text = (site / "envs" / f"{page}.html").read_text()
    names = inspect.signature(kind).parameters
    assert len(names) > 20
    assert not [name for name in names if f'<span class="pre">{name}</span>' not in text]


@pytest.mark.slow
@pytest.mark.xdist_group("browser")
def test_the_first_page_scrolls_nowhere_on_a_phone(site, browser):
    resize(browser, 375, 812, 2)
    browser.get((site / "index.html").as_uri())
    # Once it is seen, the playground says how high it is, and its frame follows.
    frame = "const frame = document.querySelector('iframe.playground'); frame.scrollIntoView();"
    frame += "return frame.style.height"
    wait_until(browser, lambda: browser.execute_script(frame))
    wide = "return [...document.querySelectorAll('.bd-article *')].filter(one => one.clientWidth"
    wide += " && one.scrollWidth > one.clientWidth + 1).map(one => one.outerHTML.slice(0, 99))"
    assert browser.execute_script(wide) == []


@pytest.mark.slow
def test_every_internal_link_leads_somewhere_and_no_markup_is_left_as_text(site):
    for page in pages(site):
        name, html = str(page.relative_to(site)), page.read_text(encoding="utf-8")
        text = unescape(re.sub("<[^>]+>", "", CODE.sub("", html)))
        assert not re.search(r"\|\s*:?-{3}", text), f"{name}: a table"
        assert not re.search(r"^\s*#{2,} |:(py:)?(class|func|doc):|```", text, re.M), name
        assert name.startswith("changelog") or "`" not in text, f"{name}: {text}"
        for link in re.findall(r'<[^<>]* (?:href|src)="([^"]+)"', html):
            parts = urlsplit(unescape(link))
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            target = target / "index.html" if target.is_dir() else target
            assert target.is_file(), f"{name}: {link}"
            if target.suffix == ".html" and parts.fragment:
                assert unquote(parts.fragment) in anchors(target), f"{name}: {link}"


@pytest.mark.parametrize("page", [ROOT / "README.md", DOCS / "index.md"])
def test_the_first_screen_counts_what_is_available(page):
    first = "\n".join(page.read_text().splitlines()[:12])
    for things in ("agents", "perturbations", "measures"):
        assert f"{len(getattr(mmc_gym, f'list_{things}')())} {things}" in first


def test_links_of_the_readme_lead_somewhere_and_agents_md_is_up_to_date():
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", (ROOT / "README.md").read_text())
    assert links and not [link for link in links if not (ROOT / link).exists()]
    written = runpy.run_path(str(DOCS / "write_agents_md.py"))["agents_text"]()
    assert (ROOT / "AGENTS.md").read_text() == written, "run python docs/write_agents_md.py"


ALIKE = 40  # of 255
SQUARE = 8

LEARNERS = "ppo ppo-residual ppo-smooth ppo-torque sac tqc-her"
CURVES = f"-m studies.learners.trainings --out . --agents {LEARNERS}"
# Picture, the command that draws it, its file, and the frames that are compared.
COMPARE = "-m mmc_gym.cli compare --agents mmc-body mmc ik-dls ppo sac --out ."
PICTURES = [
    # Starts, the joint locks, ends.
    ("film.gif", "docs/draw_film.py film.gif", "film.gif", (0, 3, 25, 51)),
    ("panda.gif", "docs/draw_panda.py panda.gif", "panda.gif", (0, 20, 65)),
    ("learning-curves.png", CURVES, "learning_curves.png", (0,)),
    ("compare.png", COMPARE, "paths_and_profiles.png", (0,)),
]


def squares(path, frame):
    """Return the mean colours of a picture's squares."""
    with Image.open(path) as image:
        image.seek(frame)
        return np.asarray(image.convert("RGB").reduce(SQUARE), float)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "command", "file", "frames"), PICTURES)
def test_a_picture_shows_what_its_command_draws(name, command, file, frames, tmp_path):
    """Compared by the mean colours of squares, in which edges and single dots have little weight.

    Other versions and rounding change a square by up to 20 of 255, arms of a control step later
    some by 40 to 110.
    """
    if f"matplotlib=={version('matplotlib')}" not in (ROOT / "constraints.txt").read_text():
        pytest.skip("another matplotlib may put labels elsewhere")
    if name == "panda.gif":
        pytest.importorskip("panda_gym")
    first, *others = command.split()
    script = ROOT / first
    run_python(script if script.exists() else first, *others, folder=tmp_path)
    drawn, shown = tmp_path / file, ROOT / "docs" / name
    assert drawn.suffix != ".gif" or drawn.stat().st_size < 500_000
    for frame in frames:
        now, before = squares(drawn, frame), squares(shown, frame)
        assert now.shape == before.shape
        differences = np.abs(now - before).mean(axis=-1)
        assert differences.max() < ALIKE, f"draw docs/{name} anew: python {command}"
