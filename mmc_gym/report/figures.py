"""The figures of scores: measures at a glance, performance profiles, degradation."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import EngFormatter, FuncFormatter, NullFormatter, PercentFormatter
from numpy.typing import NDArray

from mmc_gym._plotting import COLOURS, EXAMPLES, LINES
from mmc_gym.agents.policy import EVALUATION_EPISODES
from mmc_gym.benchmark.statistics import Bootstrap
from mmc_gym.measures import Measure
from mmc_gym.measures.episode import hand_speed
from mmc_gym.report.numbers import count, instances_of, listed, quantity, seeds_of, unit
from mmc_gym.report.panels import (
    Block,
    Look,
    Panel,
    drawn,
    line_panel,
    name_lines,
    shortened,
    to_svg,
)
from mmc_gym.report.results import Results
from mmc_gym.report.scores import Estimates
from mmc_gym.report.sentences import SUCCESS, base_of, base_title, families
from mmc_gym.training.curves import Axis, curve_rows, mean_curves

INTERVALS = "Bands and bars: 95 % bootstrap intervals over instances and training seeds."
PROFILE_RESAMPLES = 300  # of the bands of profiles, which are over thousands of episodes
_POINTS = 41  # of a performance profile
_UNPERTURBED = 0.0


def dots(estimates: Estimates, measures: tuple[Measure, ...], look: Mapping[str, Look]) -> Block:
    """Each measure of each agent with its interval, without perturbation: a panel a measure."""
    results = estimates.results
    environment = base_of(results)
    panels = []
    for measure in measures:
        figures = estimates.taking_part(environment, measure, results.agents)
        if not figures:
            continue
        with drawn(height=0.75 + 0.17 * len(figures)) as (figure, axes):
            for row, (agent, estimate) in enumerate(figures.items()):
                own = look.get(agent)
                colour = own.colour if own else "0.45"
                scale = 100 if measure.unit == "fraction" else 1
                ends = scale * np.array([estimate.low, estimate.high])
                axes.plot(ends, [row, row], color=colour, linewidth=1.6, solid_capstyle="butt")
                axes.plot(
                    scale * estimate.estimate,
                    row,
                    marker=own.marker if own else "|",
                    color=colour,
                    markersize=5 if own else 6,
                    markerfacecolor="white",
                )
            axes.set_yticks(range(len(figures)), [shortened(agent, 20) for agent in figures])
            axes.set_ylim(len(figures) - 0.4, -0.6)
            axes.grid(axis="y", color="0.92", linewidth=0.6)
            axes.set_axisbelow(True)
            if measure.unit == "fraction":
                least = min(estimate.low for estimate in figures.values())
                axes.set_xlim(100 * max(0.0, min(least - 0.05, 0.9)), 101)
            elif measure.unit == "lengths":
                axes.set_xlim(0, max(axes.get_xlim()[1], results.tolerance))
            axes.set_xlabel(
                f"{measure.label} [{unit(measure)}]" if unit(measure) else measure.label
            )
        said = "; ".join(f"{a} {quantity(measure, e.estimate)}" for a, e in figures.items())
        better = {"high": " (more is better)", "low": " (less is better)", "neither": ""}
        panels.append(
            Panel(
                f"{measure.label}{better[measure.best]}",
                to_svg(figure, f"dots-{measure.name}", f"{measure.label}: {said}"),
            )
        )
    return Block(
        tuple(panels),
        f"Environment: {environment}. Marks: means of shares, medians of the others. {INTERVALS} "
        "Agents are missing where fewer than half of their episodes have a value. "
        f"{instances_of(results, [environment])} "
        f"{seeds_of(results, results.agents, [environment])}",
    )


def profiles(estimates: Estimates, look: Mapping[str, Look]) -> Block:
    """The share of episodes that end within τ of the target, for all τ."""
    results = estimates.results
    taus = np.geomspace(0.001, 1.0, _POINTS)
    panels, used, left_out = [], [], 0
    base = base_of(results)
    perturbed = [key for keys in families(results).values() for key in keys if key != base]
    for key, title, chosen in (
        ("base", base_title(results), [base]),
        ("perturbed", "", perturbed),
    ):
        rows = results.episodes["environment"].isin(chosen)
        rows &= results.episodes["agent"].isin(list(look))
        frame = _met_by_all(results.episodes[rows])
        met = [name for name in chosen if name in set(frame["environment"])]
        left_out += len(chosen) - len(met)
        if not met:
            continue
        used += met
        curves = Bootstrap.of(frame, "final_distance", PROFILE_RESAMPLES).profile(taus, "low")
        groups = {str(agent): curve for agent, curve in curves.groupby("agent", sort=False)}
        groups = {agent: groups[agent] for agent in look if agent in groups}

        def finish(axes: Axes) -> None:
            axes.axvline(results.tolerance, color="0.5", linestyle=":", linewidth=0.8)
            axes.set(xscale="log", ylim=(0, 1.02), xlim=(taus[0], taus[-1]))
            axes.set_xlabel("τ: final distance [segment lengths]")
            axes.set_ylabel("episodes that end within τ")
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))

        named = title or count(len(met), "perturbed environment")
        panels.append(
            line_panel(
                f"profile-{key}",
                named,
                f"Share of episodes that end within a distance, {named}",
                {a: (c["threshold"], c["estimate"]) for a, c in groups.items()},
                {a: (c["low"], c["high"]) for a, c in groups.items()},
                look,
                finish,
                markers=False,
            )
        )
    partly = (
        f"Left out: {count(left_out, 'environment')} that not all these agents have met with all "
        "their training seeds. "
    )
    return Block(
        tuple(panels),
        "Performance profiles: a curve further to the left and higher is better everywhere. "
        f"Dotted: the distance that counts as success, {results.tolerance:g}. "
        f"{partly if left_out else ''}{INTERVALS} {instances_of(results, used)} "
        f"{seeds_of(results, look, used)}",
    )


def degradation(estimates: Estimates, look: Mapping[str, Look]) -> Block:
    """Success against the strength of each family of perturbations."""
    results = estimates.results
    panels, used = [], []
    for number, (family, keys) in enumerate(families(results).items()):
        lines, bands = {}, {}
        baseline = results.environments[keys[0]].baseline
        points = [(results.environments[key].strength, key) for key in keys]
        is_scale = results.environments[keys[0]].unit != "joint"
        if baseline in results.environments and is_scale:
            points = [(_UNPERTURBED, baseline), *points]
        used += [key for _, key in points]
        for agent in look:
            found = [(x, estimates.of(key, SUCCESS).get(agent)) for x, key in points]
            known = [(x, estimate) for x, estimate in found if estimate is not None]
            if known:
                x = [strength for strength, _ in known]
                lines[agent] = (x, [100 * e.estimate for _, e in known])
                bands[agent] = ([100 * e.low for _, e in known], [100 * e.high for _, e in known])
        measured_in = results.environments[keys[0]].unit

        def finish(axes: Axes, unit_of: str = measured_in, name: str = family) -> None:
            axes.set(ylim=(-3, 103), ylabel="success [%]")
            axes.set_xlabel(f"{name} [{unit_of}]" if unit_of else name)
            if unit_of == "joint":
                axes.set_xticks([1, 2, 3], ["1 (base)", "2", "3"])
                axes.set_xlim(0.6, 3.4)

        said = "; ".join(
            f"{agent} {', '.join(f'{y:.0f} %' for y in np.asarray(line[1]))}"
            for agent, line in lines.items()
        )
        strengths = ", ".join(f"{x:g}" for x, _ in points)
        panels.append(
            line_panel(
                f"degradation-{number}",
                family,
                f"Success at strengths {strengths} {measured_in}: {said}",
                *(lines, bands, look, finish),
                connected=is_scale,
            )
        )
    return Block(
        tuple(panels),
        "Success at the end of the episode against the strength of the perturbation; at 0, the "
        f"same task without it. {_untrained_for(results)}{INTERVALS} "
        f"{instances_of(results, used)} {seeds_of(results, look, used)}",
    )


def _untrained_for(results: Results) -> str:
    """Whether any policy was trained in a perturbed environment, as far as the cards tell."""
    plain = {"MMCReach-v0", "MMCReachGoal-v0"}
    met = {card.env_id for cards in results.cards.values() for card in cards}
    return "No policy was trained under these perturbations. " if met and met <= plain else ""


def _met_by_all(frame: pd.DataFrame) -> pd.DataFrame:
    """Only environments that every policy in the frame has met, as profiles ask for."""
    policies = frame[["agent", "training_seed"]].drop_duplicates()
    cells = frame[["agent", "training_seed", "environment"]].drop_duplicates()
    met = cells["environment"].value_counts()
    return frame[frame["environment"].isin(met.index[met == len(policies)])]


_AXES: tuple[tuple[Axis, str, float], ...] = (
    ("steps", "environment steps", 1.0),
    ("cpu_seconds", "time on one core [min]", 60.0),
)


def learning(estimates: Estimates, look: Mapping[str, Look]) -> Block:
    """Success over the course of training, against steps and against time."""
    results = estimates.results
    cards = {name: cards for name, cards in results.curves.items() if name in look}
    if not cards:
        return Block((), "")
    panels = []
    curves = curve_rows(cards)
    for axis, label, scale in _AXES:
        means = mean_curves(curves, axis)
        groups = {str(agent): curve for agent, curve in means.groupby("agent", sort=False)}

        def finish(axes: Axes, steps: bool = axis == "steps", name: str = label) -> None:
            axes.set(xscale="log", ylim=(0, 103), ylabel="success [%]", xlabel=name)
            form = EngFormatter(sep="") if steps else FuncFormatter(lambda value, _: f"{value:g}")
            axes.xaxis.set_major_formatter(form)
            axes.xaxis.set_minor_formatter(NullFormatter())

        panels.append(
            line_panel(
                f"learning-{axis}",
                f"Against {label.partition(' [')[0]}",
                f"Success during training against {label}",
                {a: (c[axis] / scale, 100 * c["success"]) for a, c in groups.items()},
                {a: (100 * c["low"], 100 * c["high"]) for a, c in groups.items()},
                look,
                finish,
                markers=False,
            )
        )
    counted = "; ".join(f"{name} {len(group)}" for name, group in cards.items())
    return Block(
        tuple(panels),
        f"Learning curves: share of {EVALUATION_EPISODES} fixed instances that end at the target, "
        "of the policy as it was then, without exploration; mean and 95 % bootstrap interval over "
        f"training seeds (none for a single one). Training seeds: {counted}. Agents that do not "
        "learn have no curve: what they know was built in.",
    )


def frontier(estimates: Estimates, look: Mapping[str, Look]) -> Block:
    """Success against the environment steps that were spent in training."""
    results = estimates.results
    environment = base_of(results)
    figures = estimates.of(environment, SUCCESS)
    steps = {
        agent: 0.0
        for agent in look
        if results.seeds(agent) == (0, 0) and results.kind(agent) != "yours"
    }
    for name, cards in results.cards.items():
        steps[name] = float(np.median([card.training_steps for card in cards]))
    steps = {agent: steps[agent] for agent in look if agent in steps and agent in figures}
    if not steps:
        return Block((), "")
    with drawn() as (figure, axes):
        for agent, cost in steps.items():
            own, found = look[agent], figures[agent]
            low, high = 100 * found.low, 100 * found.high
            axes.plot([cost, cost], [low, high], color=own.colour, linewidth=1.4)
            axes.plot(
                *(cost, 100 * found.estimate),
                color=own.colour,
                marker=own.marker,
                markerfacecolor="white",
            )
        top, corner = -math.inf, []
        for agent in sorted(steps, key=lambda name: (steps[name], -figures[name].estimate)):
            if figures[agent].estimate > top:
                top = figures[agent].estimate
                corner.append((steps[agent], 100 * top))
        corner.append((max(*steps.values(), 1.0) * 1.5, 100 * top))
        axes.step(*zip(*corner, strict=True), where="post", color="0.6", linewidth=0.8, zorder=0)
        axes.set_xscale("symlog", linthresh=1e4, linscale=0.6)
        axes.set(xlabel="environment steps in training", ylabel=f"success in {environment} [%]")
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlim(left=-2e3)
        axes.set_ylim(bottom=min(axes.get_ylim()[0], 90), top=101)
        ends = {agent: ([cost], [100 * figures[agent].estimate]) for agent, cost in steps.items()}
        name_lines(axes, ends, look)
    said = "; ".join(
        f"{agent} {cost:,.0f} steps, {quantity(SUCCESS, figures[agent].estimate)}"
        for agent, cost in steps.items()
    )
    return Block(
        (Panel("Sample cost", to_svg(figure, "frontier", f"Success against training: {said}")),),
        "Sample cost: success after training against the environment steps of one training. Grey: "
        "the frontier, the most success for at most so many steps. Agents at 0 are told their "
        f"body instead. {INTERVALS} {instances_of(results, [environment])} "
        f"{seeds_of(results, steps, [environment])}",
    )


_SIZE = (2.6, 4.3)  # inches


def movements(results: Results, environment: str, look: Mapping[str, Look]) -> Block:
    """Hand paths and speed profile of each agent in an environment: a panel an agent."""
    if results.paths.empty:
        return Block((), "")
    rows = results.paths[results.paths["environment"] == environment]
    fastest, shown, seeds = 0.0, {}, []
    for agent in look:
        mine = rows[rows["agent"] == agent]
        if not mine.empty:
            lowest = mine["training_seed"].min()  # missing without training
            if not np.isnan(lowest):
                mine = mine[mine["training_seed"] == lowest]
                seeds.append(f"{agent} seed {lowest:.0f}")
            shown[agent] = mine
            speeds = _quartiles(mine, results.control_step)
            fastest = max(fastest, float(np.nanmax(speeds[2])))
    panels = tuple(
        Panel(agent, to_svg(_draw(mine, results, fastest), f"movement-{number}", _alt(agent)))
        for number, (agent, mine) in enumerate(shown.items())
    )
    instances = int(rows["instance"].nunique())
    return Block(
        panels,
        f"Environment: {environment}. Above: hand paths in instances 1 to "
        f"{min(instances, EXAMPLES)}, from the open "
        "circle to the dot; the cross is the target, the ring around it the distance that counts "
        "as success; dotted: reach. Below: hand speed, median (line) and quartiles (grey) over "
        f"{count(instances, 'instance')}; all panels have the same scales. {_trainings(seeds)}",
    )


def _trainings(seeds: Sequence[str]) -> str:
    """Of which training the movements are, where there may be several."""
    if not seeds:
        return "Not trained: all of these agents."
    return f"Training seeds: of trained agents, one training: {listed(seeds)}."


def _alt(agent: str) -> str:
    return f"Hand paths of {agent} to the first targets, and its hand speed over time"


def _draw(rows: pd.DataFrame, results: Results, fastest: float) -> Figure:
    with drawn(*_SIZE) as (figure, axes):
        axes.remove()
        above, below = figure.subplots(2, 1, height_ratios=(1.45, 1))
        _draw_paths(above, rows, results)
        low, median, high = _quartiles(rows, results.control_step)
        times = (np.arange(len(median)) + 0.5) * results.control_step
        below.fill_between(times, low, high, color="0.8", linewidth=0)
        below.plot(times, median, color="black", linewidth=1.2)
        below.set(xlabel="time [s]", ylabel="hand speed [lengths/s]")
        below.set(xlim=(0, times[-1]), ylim=(0, 1.05 * fastest))
    return figure


def _draw_paths(axes: Axes, rows: pd.DataFrame, results: Results) -> None:
    reach = sum(results.segment_lengths)
    axes.add_patch(Circle((0, 0), reach, fill=False, color="0.6", linestyle=":", linewidth=0.8))
    numbers = sorted(rows["instance"].unique())[:EXAMPLES]
    for number, instance in enumerate(numbers):
        steps = rows[rows["instance"] == instance].sort_values("step")
        hands = steps[["hand_x", "hand_y"]].to_numpy(np.float64)
        target = steps[["target_x", "target_y"]].to_numpy(np.float64)[-1]
        colour = COLOURS[number]
        axes.plot(*hands.T, color=colour, linestyle=LINES[number], linewidth=1.1)
        axes.plot(*target, "+", color="black", markersize=8, markeredgewidth=0.6)
        axes.add_patch(Circle((target[0], target[1]), results.tolerance, fill=False, linewidth=0.8))
        axes.plot(*hands[0], "o", color=colour, markersize=5, markerfacecolor="white")
        axes.plot(*hands[-1], "o", color=colour, markersize=2.5)
        axes.annotate(
            *(str(number + 1), (target[0], target[1]), (5, 4)),
            textcoords="offset points",
            color=colour,
        )
    border = 1.05 * reach
    axes.set(xlim=(-border, border), ylim=(-border, border), aspect="equal")
    axes.set(xlabel="x [segment lengths]", ylabel="y [segment lengths]")


def _quartiles(rows: pd.DataFrame, control_step: float) -> NDArray[np.float64]:
    """Speed over time, the quartiles over all movements, (3, steps)."""
    speeds = [
        hand_speed(steps.sort_values("step")[["hand_x", "hand_y"]].to_numpy(), control_step)
        for _, steps in rows.groupby("instance")
    ]
    padded = np.full((len(speeds), max(map(len, speeds))), np.nan)
    for line, speed in zip(padded, speeds, strict=True):
        line[: len(speed)] = speed
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a time that no movement reaches
        quartiles: NDArray[np.float64] = np.nanpercentile(padded, (25, 50, 75), axis=0)
    return quartiles
