"""`mmc-gym compare`: agents play the same episodes; the result as table, figure and files."""

from __future__ import annotations

import io
import json
import math
import platform
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from rich.console import Console

from mmc_gym._console import make_console, print_written, progress_bar, text_for
from mmc_gym._errors import require_choice, require_names
from mmc_gym._files import check_folder, write_atomically
from mmc_gym._tables import Cell, Heading, Row, Table, estimate_cell, print_table, to_html
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.agents.resolver import Agents, Statistics, Wrappers, resolve_all
from mmc_gym.benchmark import suite
from mmc_gym.benchmark.statistics import (
    CONFIDENCE,
    RESAMPLES,
    Bootstrap,
    Estimate,
    Scores,
    summarize,
)
from mmc_gym.benchmark.store import episode_columns
from mmc_gym.envs.scenarios import EnvLike, Playable, parse_environment
from mmc_gym.interface import InterfacedEnv, read_attribute
from mmc_gym.measures import MEASURES, Episode, Measure, episode_seeds, words
from mmc_gym.measures.catalogue import leave_out_failures, shown_measures

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
    resolved_agents = resolve_all(agents, every_training=False, **shared)
    labels = [agent.label for agent in resolved_agents]
    named = require_names("focus", focus, dict.fromkeys(labels))
    yours = [agent.label for agent in resolved_agents if agent.knowledge.kind == "yours"]
    focus = tuple(dict.fromkeys(named or yours or labels[:1]))
    resolved_agents.sort(key=lambda agent: [*focus, agent.label].index(agent.label))
    seeds, seed = episode_seeds(seed, episodes), int(seed)
    if out is not None:
        out = check_folder(out, "out")
    scenario = parse_environment(env, env_kwargs, interface)
    contestants: list[Contestant] = []
    with ExitStack() as stack:
        players = []
        for agent in resolved_agents:
            agent_env, player = suite.make_player(agent, scenario)
            stack.callback(agent_env.close)
            players.append((agent, agent_env, player))
        first_env = players[0][1]
        reach = float(first_env.get_wrapper_attr("reach"))
        arms = stack.enter_context(closing(suite.Arms(scenario)))
        bar = stack.enter_context(progress_bar())
        task = bar.add_task("", total=len(players) * len(seeds))
        for agent, agent_env, player in players:
            bar.update(task, description=agent.label)
            contestants.append(
                Contestant(
                    label=agent.label,
                    training_seed=agent.training_seed,
                    training_steps=getattr(player, "training_steps", None),
                    control=str(read_attribute(agent_env, "control")),
                    episodes=suite.play_episodes(
                        arms, agent_env, player, seeds, on_episode=lambda _: bar.advance(task)
                    ),
                )
            )
    if suite.has_reference(first_env):
        ideal = suite.minimum_jerk_episodes(contestants[0].episodes)
        contestants.append(Contestant(REFERENCE, ideal, training_steps=0))
    table = pd.concat([contestant.table() for contestant in contestants], ignore_index=True)
    table = table.astype({"training_seed": "Int64"})
    comparison = Comparison(
        env=scenario.name,
        seed=seed,
        reach=reach,
        focus=focus,
        contestants=tuple(contestants),
        episodes=table,
        summary=summarize(leave_out_failures(table), tuple(MEASURES.values()), seed),
        env_kwargs=dict(scenario.arguments),
        has_interface=isinstance(first_env.unwrapped, InterfacedEnv),
    )
    # Files first: an error in printing should not lose them.
    written = comparison.write(out) if out is not None else []
    if console is not None:
        comparison.print(console, explain)
        print_written(console, written)
    return comparison


@dataclass(frozen=True, eq=False)
class Contestant:
    """A training of an agent, or an agent without training, and the episodes that it played."""

    label: str  #: the agent's
    episodes: tuple[Episode, ...]
    training_seed: int | None = None  #: None if it was not trained, or not known
    training_steps: int | None = None  #: environment steps; None if unknown
    control: str = ""  #: the control mode in which it acted; empty for the ideal hand

    def table(self) -> pd.DataFrame:
        """Return a row for each episode, see `Comparison.episodes`."""
        columns: dict[str, Any] = {"agent": self.label, "training_seed": self.training_seed}
        columns |= {"episode": range(len(self.episodes)), **episode_columns(self.episodes)}
        return pd.DataFrame(columns).drop(columns="duration")


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """The result of a comparison.

    `print` it for the table; the last line of a notebook's cell shows it as HTML.
    """

    env: str  #: id of the environment
    seed: int  #: of the starts, the targets and the resampling
    reach: float  #: of the arm, segment lengths
    focus: tuple[str, ...]  #: the agents to compare, which come first
    contestants: tuple[Contestant, ...]  #: each training of each agent, and `REFERENCE` if it is in
    #: one row per agent, training and episode: agent, training_seed, episode, seed, start, target,
    #: measures
    episodes: pd.DataFrame
    #: one row per agent and measure, see `statistics.summarize`; of the episodes that ended at the
    #: target, for measures of `successes_only`
    summary: pd.DataFrame
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)  #: arguments of the environment
    has_interface: bool = False  #: whether the environment is one of yours with an `InterfacedEnv`

    @cached_property
    def recorded(self) -> dict[str, tuple[Episode, ...]]:
        """The episodes of each agent, of one training after the other, and of `REFERENCE`.

        The i-th of each training have the same start and target.
        """
        last = words.other_controls(self.controls).keys() - set(self.focus) | {REFERENCE}
        recorded: dict[str, tuple[Episode, ...]] = {}
        for contestant in sorted(self.contestants, key=lambda contestant: contestant.label in last):
            before = recorded.get(contestant.label, ())
            recorded[contestant.label] = before + contestant.episodes
        return recorded

    @property
    def training_steps(self) -> dict[str, int | None]:
        """The environment steps of each agent's training; None if unknown."""
        return {contestant.label: contestant.training_steps for contestant in self.contestants}

    @property
    def controls(self) -> dict[str, str]:
        """The control mode of each agent, without the ideal hand."""
        acting = (contestant for contestant in self.contestants if contestant.label != REFERENCE)
        return {contestant.label: contestant.control for contestant in acting}

    @property
    def agents(self) -> list[str]:
        """The labels of the agents, without the ideal hand."""
        return [label for label in self.recorded if label != REFERENCE]

    @property
    def trainings(self) -> dict[str, int]:
        """The number of trainings of each agent; 1 also for an agent without training."""
        return {label: len(of) // self._episodes for label, of in self.recorded.items()}

    @property
    def _episodes(self) -> int:
        return len(self.contestants[0].episodes)

    @property
    def _first(self) -> Episode:
        return self.contestants[0].episodes[0]

    @property
    def headline(self) -> str:
        """The success of each agent, in a line."""
        means = self.episodes.groupby("agent")["success"].mean()[self.agents]
        success = MEASURES["success"]
        shares = ", ".join(f"{label} {success.quantity(mean)}" for label, mean in means.items())
        return f"{success.label}: {shares}"

    @property
    def differences(self) -> str:
        """How much better or worse each agent in focus is than each other one, in plain lines.

        Differences of the statistics in the table, with intervals over episodes that both played;
        of the time to the target, over those in which both ended there.
        """
        lines = []
        for number, agent in enumerate(self.focus, start=1):
            others = [label for label in self.agents if label not in self.focus[:number]]
            for name in _DIFFERENCES:
                if text := self._in_words(MEASURES[name], agent, others):
                    lines.append(f"{agent}, {MEASURES[name].label}: {text}")
        return "\n".join(lines)

    def _in_words(self, measure: Measure, agent: str, others: Sequence[str]) -> str:
        """Return how much an agent differs from others: "0.06 s slower than ppo [−0.04, 0.16]".

        Those from which it differs alike are together.
        """
        unit, higher, lower = _DIFFERENCES[measure.name]
        groups: dict[tuple[str, str], list[str]] = {}
        for other in others:
            estimate, low, high = self._difference(measure, agent, other)
            if not math.isfinite(estimate):
                continue
            word = higher
            if estimate < 0:
                low, high, word = -high, -low, lower
            size = f"{measure.number(abs(estimate))} {unit} {word} than" if estimate else "equal to"
            groups.setdefault((size, measure.interval(low, high)), []).append(other)
        texts = (f"{size} {', '.join(labels)} {ends}" for (size, ends), labels in groups.items())
        return "; ".join(map(str.rstrip, texts))

    def _difference(self, measure: Measure, agent: str, other: str) -> Estimate:
        """Estimate the statistic of one agent less that of another, NaN without common episodes."""
        tables = {}
        for label in (agent, other):
            values = self.episodes.loc[self.episodes["agent"] == label, measure.name]
            tables[label] = values.to_numpy(np.float64).reshape(-1, self._episodes)
        both = np.all([np.isfinite(table).any(axis=0) for table in tables.values()], axis=0)
        if not both.any():
            return Estimate(math.nan, math.nan, math.nan)
        common = {label: (table[:, both],) for label, table in tables.items()}
        scores = Scores((int(both.sum()),), common)
        return Bootstrap(scores, seed=self.seed).difference(agent, other, measure.statistic)

    @property
    def _shown(self) -> list[Measure]:
        """The measures of the table; those that an interface gives no values of are left out."""
        known = self.summary.loc[self.summary["count"] > 0, "measure"]
        names = set(known) if self.has_interface else MEASURES.keys()
        return [measure for measure in shown_measures() if measure.name in names]

    @property
    def note(self) -> str:
        """How to read the numbers, in short: the lines below the table."""
        return self._explain(words.PLAYED, words.COMPARISON)

    @property
    def explanation(self) -> str:
        """How to read the numbers, in full: with `--explain`, and in summary.json."""
        sentences = {
            words.PLAYED: True,
            words.STATISTICS: True,
            words.IDEAL_HAND: REFERENCE in self.recorded,
            words.DIFFERENCES: bool(self.differences),
            words.SHOWN: True,
            words.SEVERAL_TRAININGS: max(self.trainings.values()) > 1,
            words.OVER_EPISODES: True,
        }
        return self._explain(*(sentence for sentence, is_so in sentences.items() if is_so))

    def _explain(self, *sentences: str) -> str:
        """Fill the facts of the comparison into sentences of `words`."""
        shown, tolerance = self._shown, self._first.tolerance
        several = ", ".join(f"{label} ({n})" for label, n in self.trainings.items() if n > 1)
        return " ".join(sentences).format(
            env=self.env,
            arguments=f" with {words.arguments(self.env_kwargs)}" if self.env_kwargs else "",
            episodes=self._episodes,
            controls=words.control_note(self.controls),
            trainings=f"; of {several} over trainings, too" if several else "",
            several=several,
            others=" of the others" if several else "",
            means=", ".join(measure.label for measure in shown if measure.statistic == "mean"),
            of_all=", ".join(measure.label for measure in shown if not measure.successes_only),
            within="as the environment says" if math.isnan(tolerance) else f"within {tolerance:g}",
            reference=REFERENCE,
            time=MEASURES["time_to_target"].label,
            known=len(MEASURES),
            shown=len(shown),
        )

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

        movements = {
            label: [
                PlottedMovement(episode.seen_hands[:, :2], episode.target[:2], episode.speeds)
                for episode in episodes
            ]
            for label, episodes in self.recorded.items()
        }
        tolerance, control_step = self._first.tolerance, self._first.control_step
        return paths_and_profiles(movements, self.reach, tolerance, control_step, figure)

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
        summary = {(row["agent"], row["measure"]): row for row in self.summary.to_dict("records")}
        rows = []
        for measure in self._shown:
            best = Cell(measure.best.replace("neither", ""))
            cells = (
                estimate_cell(summary[label, measure.name], measure.decimals)
                for label in self.recorded
            )
            unit = f"[{measure.unit}]" if measure.unit else ""
            rows.append(Row(measure.label, (best, *cells), unit))
        steps = (self.training_steps[label] for label in self.recorded)
        trained = (Cell("unknown" if count is None else f"{count:,}") for count in steps)
        rows.append(Row("training", (Cell(""), *trained), "[env steps]"))
        others = words.other_controls(self.controls)
        agents = (Heading(label, others.get(label, "")) for label in self.recorded)
        headings = (Heading(""), Heading("best", is_text=True), *agents)
        return Table(headings, tuple(rows), caption=self.note)
