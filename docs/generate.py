"""Write the pages, films and copies that the site is built from and that are not kept.

A page for each scenario says what its registry entry, its classes and its spaces say.  Those in
FILMED also show a film of some agents with how often they succeed; `make docs ARGS="-D films=all"`
makes films of all.  Films and counts are made again when what they show has changed: the rooms in
FILMED_ROOMS, or this file.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import json
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import astuple
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image, ImageOps
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.display import progress_message
from sphinx_gallery.scrapers import matplotlib_scraper

import mmc_gym
from mmc_gym._files import write_atomically
from mmc_gym._grid import run_grid
from mmc_gym.agents import AGENTS as AGENTS_THAT_SHIP
from mmc_gym.agents import resolve
from mmc_gym.benchmark.suite import SCENARIOS, Arms, make_player, play_episodes
from mmc_gym.body import parameters
from mmc_gym.envs import arguments
from mmc_gym.envs.names import TASKS
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.envs.reach import MMCReachEnv, MMCReachGoalEnv
from mmc_gym.envs.scenarios import Scenario, parse_scenario
from mmc_gym.listing import describe
from mmc_gym.measures import episode_seeds, run_episodes
from mmc_gym.measures.reaching import success
from mmc_gym.record import named

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
PAGE_OF_CLASS = {MMCReachEnv: "/envs/reach", MMCReachGoalEnv: "/envs/goal"}

AGENTS = ("mmc", "mmc-body", "ppo")  # from left to right
AGENTS_IN_WORDS = "mmc, mmc-body and ppo"
EPISODES = 20
EVERY = 4  # control steps between two pictures
SHRINK = 2
FILMED = {
    "Tasks": ("random", "centre-out", "pursuit", "via-points"),
    "Another body": ("longer-20", "locks-2", "hand-mass-10", "obstacles-2"),
    "Forces and senses": ("force-field-60", "rotation-30", "delay-100", "vision-noise-0.1"),
}
FILMED_ROOMS = ("agents", "body", "envs", "network", "interface")

GALLERY = {  # from easy to deep
    "arm": "a_movement contact_sheet locked_joint own_task million_arms",
    "comparing": "mmc_ik_rl own_agent own_measure benchmark_with_pandas",
    "network": "three_tasks one_iteration redundancy velocity_profiles longer_arms "
    "learned_normalizer population_code",
    "bodies": "longer_reacher settling_in_space locked_panda",
    "adaptation": "rotation_and_washout generalisation error_clamp",
    "learning": "plain_sb3 her curriculum residual learning_curves normalizer_in_the_loop "
    "backpropagation",
}
THUMBNAIL = (400, 280)  # pixels

REPORT = {
    "agents": ["mmc", "mmc-body", "ik-dls", "ppo-0", "sac-0"],
    "environments": ["random", "longer-20", "rotation-30", "locked-2", "delay-100"],
    "episodes": 20,
}


def write_all(app: Any) -> None:
    """Write everything, before Sphinx looks for pages; `films` may be "all", "some" or "none"."""
    source, films = Path(app.srcdir), app.config.films
    extra = source / "_generated" / "extra"
    shutil.copytree(source / "playground", extra / "playground", dirs_exist_ok=True)
    write(extra / "llms.txt", (ROOT / "AGENTS.md").read_text(encoding="utf-8"))
    write(source / "_generated" / "agents.md", "\n".join(agents_table()))
    write_environment_pages(source / "envs", source / "_generated", films)
    with progress_message("writing the report"):
        write_report(source / "_generated", films != "none")


def write(path: Path, text: str) -> None:
    """Write a file if that changes it: Sphinx reads again what is newer."""
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text)


def digest(*rooms: str) -> str:
    """Return a digest of rooms of the package (of all without any), and of this file."""
    package = Path(mmc_gym.__file__).parent
    found = hashlib.sha256(Path(__file__).read_bytes())
    for path in sorted(package.rglob("*")):
        is_among = not rooms or path.relative_to(package).parts[0] in rooms
        if is_among and path.suffix in {".py", ".safetensors"}:
            found.update(path.read_bytes())
    return found.hexdigest()[:16]


def agents_table() -> list[str]:
    """Return a Markdown table of what each agent is, is given and senses."""
    rows = ["| agent | what it is | kind | lengths | actions | senses |"]
    rows += ["| --- " * 6 + "|"]
    for name, entry in AGENTS_THAT_SHIP.items():
        knows = entry.knowledge
        cells = (f"`{name}`", entry.description, *astuple(knows))
        rows.append(f"| {' | '.join(cells)} |")
    return [*rows, ""]


# The report


def write_report(generated: Path, with_pictures: bool) -> None:
    """Copy the report of runs/benchmark, or make one of a small benchmark."""
    page = generated / "extra" / "report" / "index.html"
    page.parent.mkdir(parents=True, exist_ok=True)
    whole = ROOT / "runs" / "benchmark" / "report.html"
    if whole.is_file():
        shutil.copyfile(whole, page)
    elif not with_pictures:
        write(page, "<!doctype html><title>Report</title><p>Left out of this build.</p>\n")
    else:
        small = generated / f"report-{digest()}.html"
        if not small.is_file():
            from mmc_gym.benchmark.runner import benchmark
            from mmc_gym.report import write_report as write_html

            store = generated / "store"
            shutil.rmtree(store, ignore_errors=True)
            benchmark(REPORT["agents"], store, REPORT["environments"], REPORT["episodes"], jobs=1)
            write_html(store, small)
        shutil.copyfile(small, page)


# The gallery


class FromEasyToDeep:
    """Sorts the examples of a folder as `GALLERY` does."""

    def __init__(self, folder: str) -> None:
        """Take the folder."""
        self.names = GALLERY.get(Path(folder).name, "").split()

    def __call__(self, file: str) -> int:
        """Return the place of a file; one that is not listed comes last."""
        name = Path(file).stem.removeprefix("plot_")
        return self.names.index(name) if name in self.names else len(self.names)


def scrape(block: Any, variables: dict[str, Any], config: Any) -> str:
    """Let sphinx-gallery save the figures of a block; keep the first panel for the thumbnail."""
    path = Path(variables["image_path_iterator"].image_path.format(1))
    panel = path.with_name(f"{Path(variables['src_file']).stem}_panel.png")
    if plt.get_fignums() and len(variables["image_path_iterator"]) == 0:
        figure = plt.figure(plt.get_fignums()[0])
        figure.canvas.draw()
        axes = next((one for one in figure.axes if one.axison or one.images), None)
        box = figure.get_tightbbox()
        if axes is not None:
            box = axes.get_tightbbox().transformed(figure.dpi_scale_trans.inverted())
        figure.savefig(panel, bbox_inches=box.padded(0.08), dpi=160)
    found: str = matplotlib_scraper(block, variables, config)
    return found


def write_thumbnails(app: Any) -> None:
    """Make the gallery's thumbnails of the panels, which are read more easily than figures."""
    for path in (Path(app.srcdir) / "examples").rglob("*_panel.png"):
        with Image.open(path) as panel:
            small = ImageOps.pad(panel.convert("RGB"), THUMBNAIL, color="white")
        name = path.stem.removesuffix("_panel")
        small.save(path.parent / "thumb" / f"sphx_glr_{name}_thumb.png")


# Environments


def all_scenarios() -> dict[str, Scenario]:
    """Return the scenarios that have a page: the benchmark's, the default strengths among them."""
    every = {one.name: one for one in (*SCENARIOS.values(), *map(parse_scenario, FAMILIES))}
    order = ["", *FAMILIES]

    def place(one: Scenario) -> tuple[int, bool]:
        return order.index(one.family), one.name.endswith("-known")

    return {one.name: one for one in sorted(every.values(), key=place)}


def write_environment_pages(folder: Path, generated: Path, films: str) -> None:
    """Write the pages of the environments' classes, of all scenarios, and their index."""
    kept = generated / "films" / digest(*FILMED_ROOMS)
    scenarios = all_scenarios()
    some = [name for group in FILMED.values() for name in group]
    for old in kept.parent.glob("*"):
        if old != kept:
            shutil.rmtree(old)
    asked = {"all": [*scenarios], "some": some, "none": []}[films]
    missing = [name for name in asked if not (kept / f"{name}.json").is_file()]
    with progress_message(f"filming {len(missing)} scenarios"):
        run_grid(partial(film, folder=kept), [scenarios[name] for name in missing])
    for name, one in scenarios.items():
        facts = kept / f"{name}.json"
        counts = json.loads(facts.read_text()) if name in asked else None
        picture = f"../{facts.relative_to(generated.parent).with_suffix('.webp')}"
        write(folder / f"{name}.md", scenario_page(one, picture, counts))
    cards = kept.relative_to(generated.parent) if asked else None
    for kind, page in PAGE_OF_CLASS.items():
        write(folder / f"{Path(page).name}.md", class_page(kind, cards))
    write(folder / "index.md", index_page(scenarios, cards))
    for page in folder.glob("*.md"):  # of an earlier build
        if page.stem not in {"index", "reach", "goal", *scenarios}:
            page.unlink()


def class_page(kind: type[MMCReachEnv], films: Path | None) -> str:
    """Return the page of an environment's class: film, docstring in Markdown, and arguments."""
    env_id = f"{kind.__name__.removesuffix('Env')}-v0"
    spec = gym.spec(env_id)
    lines = [
        f"# {env_id}",
        "",
        *(
            [f"![{AGENTS_IN_WORDS} reach for a target](../{films}/random.webp)", ""]
            if films
            else []
        ),
        *code("python", "import gymnasium as gym", "import mmc_gym", "", f'gym.make("{env_id}")'),
        inspect.getdoc(kind) or "",
        "",
        "## All arguments",
        "",
        *arguments_table(kind),
        "",
        "## Registered as",
        f"`{env_id}`, single (`{spec.entry_point}`) and vector (`{spec.vector_entry_point}`), with "
        f"at most {spec.max_episode_steps} steps in an episode.",
        "",
    ]
    return "\n".join(lines)


def arguments_table(kind: type[MMCReachEnv]) -> Iterator[str]:
    """Yield a Markdown table of an environment's arguments: the fields of its dataclass."""
    notes: dict[str, str] = {}
    for module in (parameters, arguments):
        comments = ModuleAnalyzer.for_module(module.__name__).find_attr_docs()
        for (_, name), lines in comments.items():
            notes.setdefault(name, " ".join(lines).replace(".  ", ". ").strip())
    yield "| argument | type | default | what it is |"
    yield "| --- | --- | --- | --- |"
    for one in inspect.signature(kind).parameters.values():
        of_type = inspect.formatannotation(one.annotation)
        of_type = re.sub(r"Literal\[(.*?)\]", lambda found: found[1].replace(",", " |"), of_type)
        of_type = re.sub(r"\b(?:\w+\.)+(\w)", r"\1", of_type)  # without the names of modules
        cells = (f"`{one.name}`", f"`{of_type}`", f"`{one.default!r}`", notes[one.name])
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def index_page(scenarios: dict[str, Scenario], films: Path | None) -> str:
    """Return the list of all environments, with films of some."""
    lines = [
        "# Environments",
        "",
        "One arm, many ways to make reaching hard. [MMCReach-v0](reach.md) describes the arm, its",
        "actions, observations and rewards. [MMCReachGoal-v0](goal.md) is the same arm with goals",
        "in its observations, for hindsight replay (HER). A *task* says where the target is, a",
        "*perturbation* what goes wrong. Together they have one name, with any strength:",
        "`[<task>+]<perturbation>[-<strength>][-at-<s>][-over-<s>][-known][+<perturbation>…]`.",
        "",
        *code("python", "import mmc_gym", "", 'env = mmc_gym.make("centre-out+rotation-30")'),
        f"The films show {AGENTS_IN_WORDS}, from left to right. The cross is the target, the thin",
        "arm a network's own, on its way ahead of the body.",
        "",
    ]
    for heading, names in FILMED.items():
        lines += [f"## {heading}", "", "::::{grid} 1 1 2 2", ":gutter: 3", ""]
        for name in names:
            lines += [f":::{{grid-item-card}} {name}", f":link: {name}", ":link-type: doc"]
            lines += [f":img-top: ../{films}/{name}.webp"] if films else []
            lines += [scenarios[name].description, ":::", ""]
        lines += ["::::", ""]
    lines += ["## All tasks", "", *table(scenarios[name] for name in TASKS)]
    lines += ["## All perturbations", "", "Any strength is accepted; these have a page.", ""]
    lines += ["| name | what it is | strengths |", "| --- | --- | --- |"]
    for family in FAMILIES.values():
        alike = [one for one in scenarios.values() if one.family == family.name]
        what = family.description.format(f"{family.default:g}")
        pages = ", ".join(f"[{one.name[len(family.name) + 1 :]}]({one.name}.md)" for one in alike)
        lines.append(f"| {family.name} | {what} | {pages} |")
    lines.append("")
    lines += ["```{toctree}", ":hidden:", "", "reach", "goal", *scenarios, "```", ""]
    return "\n".join(lines)


def table(scenarios: Iterable[Scenario]) -> list[str]:
    """Return a list of scenarios with links to their pages."""
    rows = [f"| [{one.name}]({one.name}.md) | {one.description} |" for one in scenarios]
    return ["| name | what it is |", "| --- | --- |", *rows, ""]


def code(language: str, *lines: str) -> list[str]:
    """Return a block of code."""
    return [f"```{language}", *lines, "```", ""]


def scenario_page(one: Scenario, picture: str, counts: dict[str, int] | None) -> str:
    """Return the page of a scenario, with its film if there are counts."""
    facts = list(describe(one.name))
    lines = [f"# {one.name}", "", f"{one.description[0].upper()}{one.description[1:]}.", ""]
    if counts is not None:
        shares = ", ".join(f"{name} in {count} of {EPISODES}" for name, count in counts.items())
        lines += [
            f"![{AGENTS_IN_WORDS} in {one.name}]({picture})",
            "",
            f"The first of {EPISODES} episodes. The hand ends at the target: {shares}.",
            "",
        ]
    way, same, benchmark = facts[1][1].splitlines()
    lines += code(
        "python",
        "import gymnasium as gym",
        "import mmc_gym",
        "",
        f"env = {way}",
        f"env = {same}  # the same",
    )
    lines += code(
        "sh",
        f"mmc-gym compare --agents {' '.join(AGENTS)} --episodes {EPISODES} --scenarios {one.name}",
        f"mmc-gym record --agents {AGENTS[0]} --scenarios {one.name}",
        benchmark,
    )
    for heading, text in facts[2:]:
        lines += [f"**{heading[0].upper()}{heading[1:]}**"]
        if language := {"experiment": "yaml", "run it": "sh"}.get(heading):
            lines += ["", *code(language, *text.splitlines())]
        else:
            lines += [*definition(text, one, heading), ""]
    lines += ["All else is as in [MMCReach-v0](reach.md).", ""]
    return "\n".join(lines)


def definition(text: str, one: Scenario, heading: str) -> Iterator[str]:
    """Yield a paragraph of a definition list; a perturbation is named with its function."""
    sign = ":   "
    for line in text.splitlines():
        if heading == "perturbation":
            made, _, about = line.partition(": ")
            functions = {change.name: change.family.apply for change in one.changes}
            line = f"`{made}` {about} It is `{functions[made].__name__}` of "
            line += "{py:mod}`mmc_gym.envs.perturbations`."
        yield f"{sign}{line}"
        sign = "    "


class Filmed(gym.Wrapper[Any, Any, Any, Any]):
    """Keeps a picture of the start, and of every so many steps."""

    def reset(self, **arguments: Any) -> Any:
        """Start a new film."""
        found = self.env.reset(**arguments)
        self.pictures, self.steps = [self.picture()], 0
        return found

    def step(self, action: Any) -> Any:
        """Go on."""
        found = self.env.step(action)
        self.steps += 1
        if self.steps % EVERY == 0:
            self.pictures.append(self.picture())
        return found

    def picture(self) -> Image.Image:
        """Return the present picture, small."""
        frame: Any = self.env.render()
        return Image.fromarray(np.asarray(frame)).reduce(SHRINK)


def film(one: Scenario, folder: Path) -> None:
    """Film the agents side by side; count how many episodes each ends at the target."""
    counts, films = {}, []
    for name in AGENTS:
        counts[name], pictures = play(one, name)
        films.append([named(picture, name) for picture in pictures])
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / f"{one.name}.webp", moving_picture(films))
    write_atomically(folder / f"{one.name}.json", json.dumps(counts))


def play(one: Scenario, agent: str) -> tuple[int, list[Image.Image]]:
    """Return how many of the episodes end at the target, and pictures of the first."""
    found, seeds = resolve(agent), episode_seeds(0, EPISODES)
    world, player = make_player(found, one.with_arguments(render_mode="rgb_array"))
    filmed = Filmed(world)
    run_episodes(player, filmed, seeds[:1], records_effort=False)
    with closing(Arms(one)) as arms:
        episodes = play_episodes(arms, world, player, seeds)
    world.close()
    return sum(map(int, map(success, episodes))), filmed.pictures


def moving_picture(films: list[list[Image.Image]]) -> bytes:
    """Return films of the same length side by side, as WebP that repeats."""
    frames = [
        Image.fromarray(np.hstack([np.asarray(picture) for picture in pictures]))
        for pictures in zip(*films, strict=True)
    ]
    held = io.BytesIO()
    durations = [EVERY * 20] * (len(frames) - 1) + [1000]
    frames[0].save(
        held,
        format="WEBP",
        save_all=True,
        append_images=frames[1:],
        duration=durations,
        loop=0,
        quality=70,
        method=3,
    )
    return held.getvalue()
