"""Write the pages, films and copies that the site is built from and that are not kept.

A page for each scenario says what its registry entry, its classes and its spaces say, and shows a
film of some agents with how often they succeed.  Films and counts are made again when anything in
the package or in this file has changed.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import json
import shutil
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from PIL import Image

import mmc_gym
from mmc_gym._files import write_atomically
from mmc_gym.agents import AGENTS as AGENTS_THAT_SHIP
from mmc_gym.agents import resolve
from mmc_gym.benchmark.suite import SCENARIOS, make_player
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.envs.reach import MMCReachEnv, MMCReachGoalEnv
from mmc_gym.envs.scenarios import TASK_SCENARIOS, Scenario, scenario
from mmc_gym.listing import describe
from mmc_gym.measures import episode_seeds, run_episodes
from mmc_gym.measures.reaching import success

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
PAGE_OF_CLASS = {MMCReachEnv: "/envs/reach", MMCReachGoalEnv: "/envs/goal"}

AGENTS = ("mmc", "mmc-body", "ppo")  # beside each other, from left to right
EPISODES = 50
EVERY = 4  # control steps between two pictures
SHRINK = 2

REPORT = {
    "agents": ["mmc", "mmc-body", "ik-dls", "ppo-0", "sac-0"],
    "environments": ["random", "longer-20", "rotation-30", "locked-2", "delay-100"],
    "episodes": 20,
}


def write_all(app: Any) -> None:
    """Write everything, before Sphinx looks for pages; without pictures in a quick build."""
    source, with_pictures = Path(app.srcdir), bool(app.config.with_pictures)
    extra = source / "_generated" / "extra"
    shutil.copytree(source / "playground", extra / "playground", dirs_exist_ok=True)
    write(extra / "llms.txt", (ROOT / "AGENTS.md").read_text(encoding="utf-8"))
    write(source / "_generated" / "agents.md", "\n".join(agents_table()))
    write_report(source / "_generated", with_pictures)
    write_environment_pages(source / "envs", source / "_generated", with_pictures)


def write(path: Path, text: str) -> None:
    """Write a file if that changes it: Sphinx reads again what is newer."""
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text)


def package_digest() -> str:
    """Return a digest of all that ships in the package, and of this file."""
    found = hashlib.sha256(Path(__file__).read_bytes())
    for path in sorted(Path(mmc_gym.__file__).parent.rglob("*")):
        if path.suffix in {".py", ".safetensors"}:
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
        small = generated / f"report-{package_digest()}.html"
        if not small.is_file():
            from mmc_gym.benchmark.runner import benchmark
            from mmc_gym.report import write_report as write_html

            store = generated / "store"
            shutil.rmtree(store, ignore_errors=True)
            benchmark(REPORT["agents"], store, REPORT["environments"], REPORT["episodes"], jobs=1)
            write_html(store, small)
        shutil.copyfile(small, page)


# Environments


def all_scenarios() -> dict[str, Scenario]:
    """Return the scenarios that have a page: the benchmark's, the default strengths among them."""
    defaults = [scenario(name) for name in FAMILIES]
    known = {**SCENARIOS, **{one.name: one for one in defaults}}
    order = ["", *FAMILIES]
    return dict(sorted(known.items(), key=lambda item: (order.index(item[1].family), item[1].told)))


def write_environment_pages(folder: Path, generated: Path, with_pictures: bool) -> None:
    """Write the pages of the environments' classes, of all scenarios, and their index."""
    films = generated / "films" / package_digest()
    for kind, page in PAGE_OF_CLASS.items():
        write(folder / f"{Path(page).name}.md", class_page(kind))
    scenarios = all_scenarios()
    for one in scenarios.values():
        counts = film(one, films) if with_pictures else None
        write(folder / f"{one.name}.md", scenario_page(one, films.relative_to(generated), counts))
    write(folder / "index.md", index_page(scenarios))


def class_page(kind: type[MMCReachEnv]) -> str:
    """Return the page of an environment's class: its docstring, which is Markdown."""
    env_id = f"{kind.__name__.removesuffix('Env')}-v0"
    spec = gym.spec(env_id)
    lines = [
        f"# {env_id}",
        "",
        inspect.getdoc(kind) or "",
        "",
        "## Registered as",
        f"`{env_id}`, single (`{spec.entry_point}`) and vector (`{spec.vector_entry_point}`), with "
        f"at most {spec.max_episode_steps} steps in an episode.",
        "",
    ]
    return "\n".join(lines)


def index_page(scenarios: dict[str, Scenario]) -> str:
    """Return the list of all environments."""
    tasks = [name for name in scenarios if name in TASK_SCENARIOS]
    lines = [
        "# Environments",
        "",
        "One arm, many ways to make reaching hard. [MMCReach-v0](reach.md) describes the arm, its",
        "actions, observations and rewards. A *task* says where the target is, a *perturbation*",
        "what goes wrong. Together they have one name, with any strength:",
        "`[<task>+]<perturbation>[-<strength>][-told][+<perturbation>…]`.",
        "",
        *code("python", 'env = mmc_gym.make("pursuit+hand-mass-5")'),
        "![A picture of each task and perturbation](../contact-sheet.png)",
        "",
        "The thin arm is the network's own, on its way ahead of the body; the cross is the target.",
        "",
        "## Tasks",
        "",
        *table(scenarios[name] for name in tasks),
    ]
    for family in FAMILIES.values():
        of_family = [one for one in scenarios.values() if one.family == family.name]
        lines += [f"## {family.name}", "", f"Strength in {family.unit}.", "", *table(of_family)]
    lines += ["```{toctree}", ":hidden:", "", "reach", "goal", *scenarios, "```", ""]
    return "\n".join(lines)


def table(scenarios: Any) -> list[str]:
    """Return a list of scenarios with links to their pages."""
    rows = [f"| [{one.name}]({one.name}.md) | {one.description} |" for one in scenarios]
    return ["| name | what it is |", "| --- | --- |", *rows, ""]


def code(language: str, *lines: str) -> list[str]:
    """Return a block of code."""
    return [f"```{language}", *lines, "```", ""]


def scenario_page(one: Scenario, films: Path, counts: dict[str, int] | None) -> str:
    """Return the page of a scenario."""
    facts = list(describe(one.name))
    lines = [f"# {one.name}", "", f"{one.description[0].upper()}{one.description[1:]}.", ""]
    if counts is not None:
        shares = ", ".join(f"{name} in {count} of {EPISODES}" for name, count in counts.items())
        names = f"{', '.join(AGENTS[:-1])} and {AGENTS[-1]}"
        lines += [
            f"![{names} in {one.name}](../_generated/{films}/{one.name}.webp)",
            "",
            f"From left to right: {names}, in the first of {EPISODES} episodes.",
            f"The hand ends at the target: {shares}.",
            "",
        ]
    lines += code(
        "sh",
        f"mmc-gym compare --agents {' '.join(AGENTS)} --episodes {EPISODES} --env {one.name}",
        f"mmc-gym record movement.gif --agent {AGENTS[0]} --env {one.name}",
        f"mmc-gym benchmark --environments {one.name}",
    )
    lines += ["## Make it", ""]
    way, same, _ = facts[1][1].splitlines()
    lines += code(
        "python",
        "import gymnasium as gym",
        "import mmc_gym",
        "",
        f"env = {way}",
        f"env = {same}  # the same",
    )
    lines += ["## What it is", ""]
    for heading, text in facts[2:]:
        lines += [f"**{heading[0].upper()}{heading[1:]}**", *definition(text, one, heading), ""]
    lines += ["All else is as in [MMCReach-v0](reach.md).", ""]
    return "\n".join(lines)


def definition(text: str, one: Scenario, heading: str) -> Iterator[str]:
    """Yield a paragraph of a definition list; the class of a thing links to its reference."""
    sign = ":   "
    for line in text.splitlines():
        if heading == "perturbation":
            made, _, about = line.partition(": ")
            names = {type(part).__name__: type(part).__module__ for part in one.perturbations}
            name = made.partition("(")[0]
            line = f"{{py:class}}`~{names[name]}.{name}` {about} Here: `{made}`."
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


def film(one: Scenario, folder: Path) -> dict[str, int]:
    """Film the agents beside each other; return how many episodes each ends at the target."""
    facts = folder / f"{one.name}.json"
    if not facts.is_file():
        counts, films = {}, []
        for name in AGENTS:
            counts[name], pictures = play(one, name)
            films.append(pictures)
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / f"{one.name}.webp", moving_picture(films))
        write_atomically(facts, json.dumps(counts))
    found: dict[str, int] = json.loads(facts.read_text())
    return found


def play(one: Scenario, agent: str) -> tuple[int, list[Image.Image]]:
    """Return how many of the episodes end at the target, and pictures of the first."""
    seeds = episode_seeds(0, EPISODES)
    world, player = make_player(resolve(agent), one)
    episodes = run_episodes(player, world, seeds, records_effort=False)
    world.close()
    # Made by name, which becomes the caption.
    world, player = make_player(resolve(agent), one.name, {"render_mode": "rgb_array"})
    filmed = Filmed(world)
    run_episodes(player, filmed, seeds[:1], records_effort=False)
    world.close()
    return sum(map(int, map(success, episodes))), filmed.pictures


def moving_picture(films: list[list[Image.Image]]) -> bytes:
    """Return films of the same length beside each other, as WebP that repeats."""
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
