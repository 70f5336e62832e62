"""`mmc-gym compare`: agents play the same episodes; the result as table, figure and files."""

from __future__ import annotations

import io
import json
import math
import platform
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import pandas as pd
from rich.console import Console

from mmc_gym._console import make_console, print_written, progress_bar, text_for
from mmc_gym._errors import require_choice, require_names
from mmc_gym._files import check_folder, write_atomically
from mmc_gym._tables import Cell, Heading, Row, Table, estimate_cell, print_table, to_html
from mmc_gym.agents.base import Predictor
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.agents.resolved import ResolvedAgent
from mmc_gym.agents.resolver import Agents, Statistics, Wrappers, resolve, resolve_all
from mmc_gym.benchmark.statistics import (
    CONFIDENCE,
    RESAMPLES,
    Bootstrap,
    Estimate,
    Scores,
    summarize,
)
from mmc_gym.benchmark.store import episode_columns
from mmc_gym.benchmark.suite import (
    Arms,
    control_note,
    has_reference,
    make_player,
    minimum_jerk_episodes,
    other_controls,
    play_episodes,
)
from mmc_gym.envs.scenarios import EnvLike, Playable, parse_environment
from mmc_gym.interface import InterfacedEnv, read_attribute
from mmc_gym.measures import MEASURES, Episode, Measure, episode_seeds, leave_out_failures
from mmc_gym.measures.catalogue import shown_measures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PACKAGES = ("mmc-gym", "gymnasium", "numpy", "scipy", "pandas", "pymunk", "torch")
_DIFFERENCES = {  # measures that are compared: unit, and the words for a higher and a lower value
    "success": ("points", "higher", "lower"),
    "time_to_target": ("s", "slower", "faster"),
}


def compare(
    agents: Agents,
    env: EnvLike | Playable = "MMCReach-v0",
    episodes: int = 200,
    seed: int = 0,
    out: Path | str | None = None,
    console: Console | None = None,
    *,
    focus: str | Sequence[str] = (),
    env_kwargs: Mapping[str, Any] | None = None,
    interface: Any = None,
    allow_pickle: bool = False,
    wrapper: Wrappers = (),
    statistics: Statistics = (),
    explain: bool = False,
) -> Comparison:
    """Let agents play the same episodes.

    An ideal hand without an arm, `REFERENCE`, reaches for the same targets, where there is one.
    All arguments are checked, and all agents made, before the first episode.

    Args:
        agents: names, paths of files, functions, classes, models of stable-baselines3, or other
            objects with `predict`, see `mmc_gym.agents.resolve`.  A mapping gives them labels.  A
            list in it holds several trainings of one agent; so does a pattern, "runs/mine-*".
        env: name of a scenario, such as "rotation-30", id of a reaching environment, "module:Id",
            "module:function", or a function or class that returns one.
        episodes: how many each agent plays.
        seed: of the starts and targets, see `episode_seeds`, and of the bootstrap.
        out: folder for data and figure; None writes none.
        console: to print the table to; None prints nothing.  `print(comparison)` does, too.
        focus: labels of the agents to compare.  They come first, and are compared with each
            other one.  By default your own agents, or else the first.
        env_kwargs: arguments of the environment.  A `control` among them is for agents that act by
            several control modes, or do not declare one.
        interface: for an environment that is not of this package, your `ReachInterface` for it,
            "module:name" of one, or a function of the environment that returns one.
            Measures of what it does not report are left out.
        allow_pickle: whether files with pickles may be loaded, such as those of stable-baselines3.
            That runs whatever code they name.
        wrapper: of models of stable-baselines3, a function of the environment, or
            "module:function", with the wrappers of their training; or a mapping of labels to these.
        statistics: of models of stable-baselines3 that were trained behind a `VecNormalize`: that,
            or the path of its file; or a mapping of labels to these.  Not needed for a model that
            is still in it, nor for a file with statistics in its folder.
        explain: whether to print all of how to read the numbers, see `Comparison.explanation`.

    >>> comparison = compare(["random"], episodes=2)
    >>> comparison
    <Comparison of random in MMCReach-v0, 2 episodes each>
    >>> comparison.headline
    'success at the end: random 0.0 %'
    >>> comparison.episodes.groupby("agent", sort=False).size().to_dict()
    {'random': 2, 'minimum jerk (ideal)': 2}
    """
    shared: Any = {"allow_pickle": allow_pickle, "wrapper": wrapper, "statistics": statistics}
    found = resolve_all(agents, every_training=False, **shared)
    labels = [agent.label for agent in found]
    wanted = require_names("focus", focus, dict.fromkeys(labels))
    own = [agent.label for agent in found if agent.knowledge.kind == "yours"]
    chosen = tuple(dict.fromkeys(wanted or own or labels[:1]))
    found.sort(key=lambda agent: [*chosen, agent.label].index(agent.label))
    seeds, seed = episode_seeds(seed, episodes), int(seed)
    if out is not None:
        out = check_folder(out, "out")
    scenario = parse_environment(env, env_kwargs, interface)
    envs: list[gym.Env[Any, Any]] = []
    players: list[Predictor] = []
    played: list[tuple[Episode, ...]] = []
    steps: dict[str, int | None] = {}
    controls: dict[str, str] = {}
    with ExitStack() as stack:
        for agent in found:
            made, player = make_player(agent, scenario)
            stack.callback(made.close)
            envs.append(made)
            players.append(player)
            steps[agent.label] = getattr(player, "training_steps", None)
            controls[agent.label] = str(read_attribute(made, "control"))
        arms = stack.enter_context(closing(Arms(scenario)))
        reach = float(envs[0].get_wrapper_attr("reach"))
        bar = stack.enter_context(progress_bar())
        task = bar.add_task("", total=len(players) * len(seeds))
        for agent, made, player in zip(found, envs, players):
            bar.update(task, description=agent.label)
            played.append(
                play_episodes(arms, made, player, seeds, on_episode=lambda _: bar.advance(task))
            )
    if has_reference(envs[0]):
        found.append(resolve(REFERENCE))
        played.append(minimum_jerk_episodes(played[0]))
        steps[REFERENCE] = 0
    recorded: dict[str, tuple[Episode, ...]] = {}
    for agent, one in zip(found, played):
        recorded[agent.label] = recorded.get(agent.label, ()) + one
    later = other_controls(controls).keys() - set(chosen) | {REFERENCE}
    table = _tidy(found, played)
    comparison = Comparison(
        env=scenario.name,
        seed=seed,
        reach=reach,
        focus=chosen,
        recorded=dict(sorted(recorded.items(), key=lambda item: item[0] in later)),
        training_steps=steps,
        episodes=table,
        summary=summarize(leave_out_failures(table), tuple(MEASURES.values()), seed),
        env_kwargs=dict(scenario.arguments),
        controls=controls,
        has_interface=isinstance(envs[0].unwrapped, InterfacedEnv),
    )
    # Files first: an error in printing should not lose them.
    written = comparison.write(out) if out is not None else []
    if console is not None:
        comparison.print(console, explain)
        print_written(console, written)
    return comparison


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """The result of a comparison.

    `print` it for the table; the last line of a notebook's cell shows it as HTML.
    """

    env: str  #: id of the environment
    seed: int  #: of the starts, the targets and the resampling
    reach: float  #: of the arm, segment lengths
    focus: tuple[str, ...]  #: the agents to compare, which come first
    #: the episodes of each agent, of one training after the other, and of `REFERENCE` if there are
    #: any; the i-th of each training have the same start and target
    recorded: Mapping[str, tuple[Episode, ...]]
    training_steps: Mapping[str, int | None]  #: environment steps, by agent; None if unknown
    #: one row per agent, training and episode: agent, training_seed, episode, seed, start, target,
    #: measures
    episodes: pd.DataFrame
    #: one row per agent and measure, see `statistics.summarize`; of the episodes that ended at the
    #: target, for measures of `successes_only`
    summary: pd.DataFrame
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)  #: arguments of the environment
    controls: Mapping[str, str] = field(default_factory=dict)  #: control mode, by agent
    has_interface: bool = False  #: whether the environment is one of yours with an `InterfacedEnv`

    @property
    def agents(self) -> list[str]:
        """The labels of the agents, without the ideal hand unless it is alone."""
        return [label for label in self.recorded if label != REFERENCE] or [REFERENCE]

    @property
    def trainings(self) -> dict[str, int]:
        """The number of trainings of each agent; 1 also for an agent without training."""
        return {agent: len(of) // self._episodes for agent, of in self.recorded.items()}

    @property
    def _episodes(self) -> int:
        return int(self.episodes["episode"].nunique())

    @property
    def _first(self) -> Episode:
        return next(iter(self.recorded.values()))[0]

    @property
    def headline(self) -> str:
        """The success of each agent, in a line."""
        means = self.episodes.groupby("agent")["success"].mean()[self.agents]
        success = MEASURES["success"]
        shares = ", ".join(f"{agent} {success.quantity(mean)}" for agent, mean in means.items())
        return f"{success.label}: {shares}"

    @property
    def differences(self) -> str:
        """How much better or worse each agent in focus is than each other one, in plain lines.

        Differences of the statistics in the table, with intervals over episodes that both played;
        of the time to the target, over those in which both ended there.
        """
        lines = []
        for number, agent in enumerate(self.focus):
            others = [one for one in self.agents if one not in self.focus[: number + 1]]
            for name, words in _DIFFERENCES.items():
                measure = MEASURES[name]
                found = {other: self._difference(measure, agent, other) for other in others}
                if text := _in_words(measure, words, found):
                    lines.append(f"{agent}, {measure.label}: {text}")
        return "\n".join(lines)

    def _difference(self, measure: Measure, agent: str, other: str) -> Estimate:
        """Estimate the statistic of one agent less that of another, NaN without common episodes."""
        tables = {}
        for label in (agent, other):
            values = self.episodes.loc[self.episodes["agent"] == label, measure.name]
            tables[label] = values.to_numpy(np.float64).reshape(-1, self._episodes)
        both = np.all([np.isfinite(one).any(axis=0) for one in tables.values()], axis=0)
        if not both.any():
            return Estimate(math.nan, math.nan, math.nan)
        scores = Scores((int(both.sum()),), {name: (of[:, both],) for name, of in tables.items()})
        return Bootstrap(scores, seed=self.seed).difference(agent, other, measure.statistic)

    @property
    def _shown(self) -> tuple[Measure, ...]:
        """The measures of the table; those that an interface gives no values of are left out."""
        if not self.has_interface:
            return shown_measures()
        known = self.summary.loc[self.summary["count"] > 0, "measure"]
        return tuple(one for one in shown_measures() if one.name in set(known))

    @property
    def note(self) -> str:
        """How to read the numbers, in short: the lines below the table."""
        trainings = f"; of {self._several} over trainings, too" if self._several else ""
        return (
            f"{self._played} Medians (of shares means) with 95 % intervals over episodes, NOT over "
            f"trainings{trainings}. k of {self._episodes}: as many have a value. --explain (in "
            "Python explanation) says more."
        )

    @property
    def _several(self) -> str:
        """The agents with several trainings, and how many; empty without any."""
        return ", ".join(f"{agent} ({n})" for agent, n in self.trainings.items() if n > 1)

    @property
    def _played(self) -> str:
        arguments = ", ".join(f"{name}={value}" for name, value in self.env_kwargs.items())
        return (
            f"{self.env}{' with ' if arguments else ''}{arguments}, {self._episodes} episodes, "
            f"same starts and targets for all. {control_note(self.controls)}"
        )

    @property
    def explanation(self) -> str:
        """How to read the numbers, in full: with `--explain`, and in summary.json."""
        shown, time = self._shown, MEASURES["time_to_target"].label
        means = ", ".join(measure.label for measure in shown if measure.statistic == "mean")
        of_all = ", ".join(one.label for one in shown if not one.successes_only)
        near = self._first.tolerance
        within = "as the environment says" if math.isnan(near) else f"within {near:g}"
        sentences = [
            self._played,
            f"Medians ({means}: mean) with {CONFIDENCE:.0%} bootstrap intervals, Wilson's of a "
            f"share in one training; lengths in segment lengths; at the target: {within}.",
            f"{of_all}: of all episodes; the others: of those that ended at the target, and k of "
            f"{self._episodes} have a value (none where the hand started there).",
        ]
        if REFERENCE in self.recorded:
            sentences.append(f"{REFERENCE}: a hand without an arm, through the same measures.")
        if self.differences:
            sentences.append(
                f"Differences are of the same episodes of both ({time}: where both ended there)."
            )
        sentences.append(f"Of {len(MEASURES)} measures {len(shown)} are shown; files hold all.")
        if several := self._several:
            over = "replicate over trainings (so many) and episodes."
            sentences.append(f"The intervals of {several} {over}")
        sentences.append(
            f"The intervals{' of the others' if several else ''} replicate over episodes (starts "
            "and targets), NOT over training seeds: each agent is the result of one training, or "
            "of none."
        )
        return " ".join(sentences)

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that the comparison was made with, ready for JSON."""
        tolerance = self._first.tolerance
        return {
            "environment": self.env,
            "env_kwargs": json.loads(json.dumps(dict(self.env_kwargs), default=repr)),
            "controls": dict(self.controls),
            "agents": self.agents,
            "focus": list(self.focus),
            "reference": REFERENCE if REFERENCE in self.recorded else None,
            "training_steps": {agent: self.training_steps[agent] for agent in self.agents},
            "trainings": {agent: self.trainings[agent] for agent in self.agents},
            "episodes": self._episodes,
            "seed": self.seed,
            "control_step": self._first.control_step,
            "tolerance": None if math.isnan(tolerance) else tolerance,
            "confidence": CONFIDENCE,
            "bootstrap_resamples": RESAMPLES,
            "bootstrap_method": "percentile, over episodes, and trainings if an agent has several; "
            "Wilson's interval of the share of successes in one training",
            "python": platform.python_version(),
            "machine": f"{platform.system()} {platform.machine()}",
            "versions": {package: version(package) for package in _PACKAGES},
            "note": self.explanation,
        }

    def to_frame(self, value: str = "estimate") -> pd.DataFrame:
        """Return a row for each agent and a column for each measure.

        `episodes` and `summary` hold the same in long form.

        Args:
            value: "estimate", an end of its interval ("low", "high"), or how many episodes have a
                value ("count") and how many have none ("missing").
        """
        require_choice("value", value, ("estimate", "low", "high", "count", "missing"))
        frame = self.summary.pivot(index="agent", columns="measure", values=value)
        return frame.loc[list(self.recorded), list(self.summary["measure"].unique())]

    def plot(self, figure: Figure | None = None) -> Figure:
        """Return a figure: hand paths above, speed profiles below, a column for each agent.

        Paths in space are seen along the z axis.  Draw on `figure`, such as
        `plt.figure(layout="constrained")`, which `plt.show()` then shows; a new one if None.
        """
        from mmc_gym._plotting import PlottedMovement, paths_and_profiles

        def plotted(one: Episode) -> PlottedMovement:
            return PlottedMovement(one.seen_hands[:, :2], one.target[:2], one.speeds)

        movements = {agent: list(map(plotted, of)) for agent, of in self.recorded.items()}
        one = self._first
        return paths_and_profiles(movements, self.reach, one.tolerance, one.control_step, figure)

    def print(self, console: Console | None = None, explain: bool = False) -> None:
        """Print headline, table and note, or `explanation`; to standard output by default."""
        console = console or make_console()
        for text in (self.headline, *self.differences.splitlines()):
            console.print(text_for(console, text))
        table = self._table
        print_table(console, table._replace(caption=self.explanation) if explain else table)

    def write(self, out: Path) -> list[Path]:
        """Write episodes.csv, summary.csv, summary.json and the figure into the folder `out`."""
        from mmc_gym._plotting import save_figure

        summary = self.summary.assign(
            training_steps=self.summary["agent"].map(self.training_steps).astype("Int64")
        )
        written = [
            write_atomically(out / f"{name}.csv", frame.to_csv(index=False, lineterminator="\n"))
            for name, frame in (("episodes", self.episodes), ("summary", summary))
        ]
        settings = json.dumps(self.settings, indent=2) + "\n"
        written.append(write_atomically(out / "summary.json", settings))
        return written + save_figure(self.plot(), out / "paths_and_profiles")

    def __repr__(self) -> str:
        count = f"{self._episodes} episodes each"
        return f"<Comparison of {', '.join(self.agents)} in {self.env}, {count}>"

    def __str__(self) -> str:
        text = io.StringIO()
        self.print(Console(file=text, width=make_console().width))
        return text.getvalue().rstrip()

    def _repr_html_(self) -> str:
        table = to_html(self._table)
        lines = [f"<b>{escape(self.headline)}</b>", *map(escape, self.differences.splitlines())]
        return f"<p>{'<br>'.join(lines)}</p>{table}<p>{escape(self.note)}</p>"

    @property
    def _table(self) -> Table:
        """The table as it is printed: a row for each measure, a column for each agent."""
        found: dict[Any, Any] = {
            (row["agent"], row["measure"]): row for row in self.summary.to_dict("records")
        }
        rows = []
        for one in self._shown:
            best = Cell(one.best.replace("neither", ""))
            cells = (estimate_cell(found[agent, one.name], one.decimals) for agent in self.recorded)
            unit = f"[{one.unit}]" if one.unit else ""
            rows.append(Row(one.label, (best, *cells), unit))
        steps = (self.training_steps[agent] for agent in self.recorded)
        trained = (Cell("unknown" if one is None else f"{one:,}") for one in steps)
        others = other_controls(self.controls)
        agents = (Heading(agent, others.get(agent, "")) for agent in self.recorded)
        return Table(
            headings=(Heading(""), Heading("best", is_text=True), *agents),
            rows=(*rows, Row("training", (Cell(""), *trained), "[env steps]")),
            caption=self.note,
        )


def _in_words(
    measure: Measure, words: tuple[str, str, str], differences: Mapping[str, Estimate]
) -> str:
    """Return how much an agent differs from others: "0.06 s slower than ppo [−0.04, 0.16]".

    Those from which it differs alike are together; for `words` see `_DIFFERENCES`.
    """
    unit, higher, lower = words
    groups: dict[tuple[str, str], list[str]] = {}
    for other, found in differences.items():
        if not math.isfinite(found.estimate):
            continue
        low, high, word = found.low, found.high, higher
        if found.estimate < 0:
            low, high, word = -found.high, -found.low, lower
        size = f"{measure.number(abs(found.estimate))} {unit} {word} than"
        what = size if found.estimate else "equal to"
        groups.setdefault((what, measure.interval(low, high)), []).append(other)
    texts = [f"{what} {', '.join(them)} {ends}".rstrip() for (what, ends), them in groups.items()]
    return "; ".join(texts)


def _tidy(agents: Sequence[ResolvedAgent], played: Sequence[Sequence[Episode]]) -> pd.DataFrame:
    tables = []
    for agent, episodes in zip(agents, played):
        who = {"agent": agent.label, "training_seed": agent.training_seed}
        columns = {**who, "episode": range(len(episodes)), **episode_columns(episodes)}
        tables.append(pd.DataFrame(columns).drop(columns="duration"))
    return pd.concat(tables, ignore_index=True).astype({"training_seed": "Int64"})
