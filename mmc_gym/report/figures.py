"""The figures of the report: movements, measures at a glance, learning, profiles, degradation.

Each function returns None where there is nothing to show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, NullFormatter, PercentFormatter

from mmc_gym._plotting import EXAMPLES, PlottedMovement, draw_paths, draw_speed, speed_quartiles
from mmc_gym.agents.policy import EVALUATION_EPISODES, PolicyCard
from mmc_gym.benchmark.statistics import Bootstrap
from mmc_gym.measures import Measure
from mmc_gym.measures.episode import hand_speed
from mmc_gym.report.panels import (
    Curve,
    Look,
    Panel,
    PanelFigure,
    drawn,
    line_panel,
    name_lines,
    shortened,
    to_svg,
)
from mmc_gym.report.results import Results, count, listed
from mmc_gym.report.scores import SUCCESS, Estimates
from mmc_gym.report.tables import BETTER
from mmc_gym.training.curves import Axis, curve_rows, mean_curves

PROFILE_RESAMPLES = 300
"""Resamples of the bands of performance profiles, which are over thousands of episodes."""

_POINTS = 41  # of a performance profile
_UNPERTURBED = 0.0
_MOVEMENT_SIZE = (2.6, 4.3)  # inches
_OTHERS = Look("0.45", "-", "|")  # agents that only the dots show
_AXES: tuple[tuple[Axis, str, float], ...] = (
    ("steps", "environment steps", 1.0),
    ("cpu_seconds", "time on one core [min]", 60.0),
)


def dots(
    estimates: Estimates, measures: Sequence[Measure], look: Mapping[str, Look]
) -> PanelFigure | None:
    """Draw each measure of each agent with its interval, without perturbation."""
    results = estimates.results
    panels = []
    for measure in measures:
        found = estimates.taking_part(results.base, measure, results.agents)
        if not found:
            continue
        with drawn(height=0.75 + 0.17 * len(found)) as (figure, axes):
            scale = 100 if measure.unit == "fraction" else 1
            for row, (agent, one) in enumerate(found.items()):
                own = look.get(agent, _OTHERS)
                ends = [scale * one.low, scale * one.high]
                axes.plot(ends, [row, row], color=own.colour, linewidth=1.6, solid_capstyle="butt")
                axes.plot(
                    scale * one.estimate,
                    row,
                    marker=own.marker,
                    color=own.colour,
                    markersize=6 if own is _OTHERS else 5,
                    markerfacecolor="white",
                    clip_on=False,
                )
            axes.set_yticks(range(len(found)), [shortened(agent, 20) for agent in found])
            axes.set_ylim(len(found) - 0.4, -0.6)
            axes.grid(axis="y", color="0.92", linewidth=0.6)
            axes.set_axisbelow(True)
            if measure.unit == "fraction":
                least = min(one.low for one in found.values())
                axes.set_xlim(100 * max(0.0, min(least - 0.05, 0.9)), 101)
            elif measure.unit == "lengths":
                axes.set_xlim(0, max(axes.get_xlim()[1], results.manifest.tolerance))
            unit = measure.shown_unit
            axes.set_xlabel(f"{measure.label} [{unit}]" if unit else measure.label)
        said = "; ".join(f"{agent} {measure.quantity(e.estimate)}" for agent, e in found.items())
        better = f" ({BETTER[measure.best]})" if BETTER[measure.best] else ""
        panels.append(
            Panel(
                f"{measure.label}{better}",
                f"{measure.label}: {said}",
                to_svg(figure, f"dots-{measure.name}"),
            )
        )
    if not panels:
        return None
    return PanelFigure(
        tuple(panels),
        f"Environment: {results.base}. Marks: means of shares, medians of the others; bars: 95 % "
        "intervals. Agents are missing where fewer than half of their episodes have a value. "
        f"{results.sample_sizes(results.agents, [results.base])}",
    )


def profiles(estimates: Estimates, look: Mapping[str, Look]) -> PanelFigure | None:
    """Draw the share of episodes that end within τ of the target, for all τ."""
    results, base = estimates.results, estimates.results.base
    taus = np.geomspace(0.001, 1.0, _POINTS)
    perturbed = [key for keys in results.families.values() for key in keys if key != base]
    plain = f"Only {base}" if results.environments[base].family else f"Unperturbed ({base})"
    panels, used, left_out = [], [], 0

    def finish(axes: Axes) -> None:
        axes.axvline(results.manifest.tolerance, color="0.5", linestyle=":", linewidth=0.8)
        axes.set(xscale="log", ylim=(0, 1.02), xlim=(taus[0], taus[-1]))
        axes.set_xlabel("τ: final distance [segment lengths]")
        axes.set_ylabel("episodes that end within τ")
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))

    for key, chosen in (("base", [base]), ("perturbed", perturbed)):
        rows = results.episodes["environment"].isin(chosen)
        rows &= results.episodes["agent"].isin(list(look))
        frame = _met_by_all(results.episodes[rows])
        there = set(frame["environment"].unique())
        met = [name for name in chosen if name in there]
        left_out += len(chosen) - len(met)
        if not met:
            continue
        used += met
        curves = Bootstrap.of(frame, "final_distance", PROFILE_RESAMPLES).profile(taus, "low")
        parts = ["threshold", "estimate", "low", "high"]
        lines = {
            str(agent): Curve(*curve[parts].to_numpy().T)
            for agent, curve in curves.groupby("agent", sort=False)
        }
        lines = {agent: lines[agent] for agent in look if agent in lines}
        title = plain if key == "base" else count(len(met), "perturbed environment")
        panels.append(
            line_panel(
                f"profile-{key}",
                title,
                f"Share of episodes that end within a distance, {title}",
                lines,
                look,
                finish,
                markers=False,
            )
        )
    if not panels:
        return None
    partly = (
        f"Left out: {count(left_out, 'environment')} that not all these agents have met with all "
        "their training seeds. "
    )
    return PanelFigure(
        tuple(panels),
        "Further to the left and higher is better. Dotted: the distance that counts as success, "
        f"{results.manifest.tolerance:g}. Bands: 95 % intervals. {partly if left_out else ''}"
        f"{results.sample_sizes(look, used)}",
    )


def _met_by_all(frame: pd.DataFrame) -> pd.DataFrame:
    """Return only the environments that every policy in the frame has met, as profiles need."""
    policies = frame[["agent", "training_seed"]].drop_duplicates()
    cells = frame[["agent", "training_seed", "environment"]].drop_duplicates()
    met = cells["environment"].value_counts()
    return frame[frame["environment"].isin(met.index[met == len(policies)])]


def degradation(estimates: Estimates, look: Mapping[str, Look]) -> PanelFigure | None:
    """Draw success against the strength of each family of perturbations."""
    results = estimates.results
    panels, used = [], []
    for number, (family, keys) in enumerate(results.families.items()):
        first = results.environments[keys[0]]
        is_scale = first.unit != "joint"
        points = [(results.environments[key].strength, key) for key in keys]
        if first.baseline in results.environments and is_scale:
            points = [(_UNPERTURBED, first.baseline), *points]
        used += [key for _, key in points]
        lines, said = {}, []
        for agent in look:
            found = [(x, estimates.of(key, SUCCESS).get(agent)) for x, key in points]
            known = [(x, one) for x, one in found if one is not None]
            if known:
                shares = 100 * np.array([one for _, one in known])
                lines[agent] = Curve([x for x, _ in known], *shares.T)
                texts = (SUCCESS.quantity(one.estimate) for _, one in known)
                said.append(f"{agent} {', '.join(texts)}")

        def finish(axes: Axes, unit_of: str = first.unit, name: str = family) -> None:
            axes.set(ylim=(-3, 103), ylabel="success [%]")
            axes.set_xlabel(f"{name} [{unit_of}]" if unit_of else name)
            if unit_of == "joint":
                axes.set_xticks([1, 2, 3], ["1 (base)", "2", "3"])
                axes.set_xlim(0.6, 3.4)

        strengths = ", ".join(f"{x:g}" for x, _ in points)
        panels.append(
            line_panel(
                f"degradation-{number}",
                family,
                f"Success at strengths {strengths} {first.unit}: {'; '.join(said)}",
                lines,
                look,
                finish,
                connected=is_scale,
            )
        )
    if not panels:
        return None
    return PanelFigure(
        tuple(panels),
        "Success against the strength of the perturbation; at 0, the same task without it. Bands: "
        f"95 % intervals. {_untrained_for(results)}{results.sample_sizes(look, used)}",
    )


def _untrained_for(results: Results) -> str:
    """Return a sentence about which policies were trained under perturbations."""
    met = [name for name, cards in results.cards.items() if any(map(_met_perturbations, cards))]
    if not any(results.cards.values()):
        return ""
    if met:
        return f"Of the policies, only {listed(met)} met perturbations in training. "
    return "No policy was trained under these perturbations. "


def _met_perturbations(card: PolicyCard) -> bool:
    """Tell whether a policy was trained in another scenario than the plain one, or in several."""
    names = repr(card.hyperparameters)
    is_plain = card.env_id in ("MMCReach-v0", "MMCReachGoal-v0")
    return not is_plain or "RandomScenarios" in names or "perturbations" in names


def learning(estimates: Estimates, look: Mapping[str, Look]) -> PanelFigure | None:
    """Draw success over the course of training, against steps and against time."""
    cards = {name: cards for name, cards in estimates.results.curves.items() if name in look}
    if not cards:
        return None
    panels = []
    curves = curve_rows(cards)
    for axis, label, scale in _AXES:
        lines = {
            str(agent): Curve(
                one[axis] / scale, *100 * one[["success", "low", "high"]].to_numpy().T
            )
            for agent, one in mean_curves(curves, axis).groupby("agent", sort=False)
        }

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
                lines,
                look,
                finish,
                markers=False,
            )
        )
    counted = "; ".join(f"{name} {len(group)}" for name, group in cards.items())
    return PanelFigure(
        tuple(panels),
        "Success of the policy as it was then, without exploration; mean and 95 % interval over "
        "training seeds and episodes. "
        f"Instances: {EVALUATION_EPISODES}, fixed. Training seeds: {counted}.",
    )


def frontier(estimates: Estimates, look: Mapping[str, Look]) -> PanelFigure | None:
    """Draw success against the environment steps that were spent in training."""
    results = estimates.results
    found = estimates.of(results.base, SUCCESS)
    steps = {
        agent: 0.0
        for agent in look
        if results.seeds(agent) == (0, 0) and results.kind(agent) != "yours"
    }
    for name, cards in results.cards.items():
        steps[name] = float(np.median([card.training_steps for card in cards]))
    steps = {agent: steps[agent] for agent in look if agent in steps and agent in found}
    if not steps:
        return None
    success = {agent: 100 * found[agent].estimate for agent in steps}
    with drawn() as (figure, axes):
        for agent, cost in steps.items():
            own, one = look[agent], found[agent]
            ends = [100 * one.low, 100 * one.high]
            axes.plot([cost, cost], ends, color=own.colour, linewidth=1.4)
            axes.plot(
                cost, success[agent], color=own.colour, marker=own.marker, markerfacecolor="white"
            )
        corners: list[tuple[float, float]] = []
        for agent in sorted(steps, key=lambda name: (steps[name], -success[name])):
            if not corners or success[agent] > corners[-1][1]:
                corners.append((steps[agent], success[agent]))
        corners.append((max(*steps.values(), 1.0) * 1.5, corners[-1][1]))
        axes.step(*zip(*corners, strict=True), where="post", color="0.6", linewidth=0.8, zorder=0)
        axes.set_xscale("symlog", linthresh=1e4, linscale=0.6)
        axes.set(xlabel="environment steps in training", ylabel=f"success in {results.base} [%]")
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlim(left=-2e3)
        axes.set_ylim(bottom=min(axes.get_ylim()[0], 90), top=101)
        name_lines(axes, {a: ([cost], [success[a]]) for a, cost in steps.items()}, look)
    said = "; ".join(
        f"{agent} {cost:,.0f} steps, {SUCCESS.quantity(found[agent].estimate)}"
        for agent, cost in steps.items()
    )
    panel = Panel("Sample cost", f"Success against training: {said}", to_svg(figure, "frontier"))
    return PanelFigure(
        (panel,),
        "Success after training against the environment steps of one training. Grey: the most "
        "success for at most so many steps. Agents at 0 are told their body. Bars: 95 % intervals. "
        f"{results.sample_sizes(steps, [results.base])}",
    )


def movements(results: Results, look: Mapping[str, Look]) -> PanelFigure | None:
    """Draw hand paths and speed profile of each agent in the base environment."""
    if results.paths.empty:
        return None
    rows = results.paths[results.paths["environment"] == results.base]
    fastest, shown, seeds = 0.0, {}, []
    for agent in look:
        mine = rows[rows["agent"] == agent]
        if mine.empty:
            continue
        lowest = mine["training_seed"].min()  # missing without training
        if not np.isnan(lowest):
            mine = mine[mine["training_seed"] == lowest]
            seeds.append(f"seed {lowest:.0f} of {agent}")
        shown[agent] = _movements_of(mine, results.manifest.control_step)
        fastest = max(fastest, float(np.nanmax(speed_quartiles(shown[agent])[2])))
    if not shown:
        return None
    panels = tuple(
        Panel(
            agent,
            f"Hand paths of {agent} to the first targets, and its hand speed over time",
            to_svg(_draw_movements(mine, results, fastest), f"movement-{number}"),
        )
        for number, (agent, mine) in enumerate(shown.items())
    )
    instances = int(rows["instance"].nunique())
    trainings = f"Training seeds: {listed(seeds)}." if seeds else "Not trained: all agents."
    return PanelFigure(
        panels,
        f"Environment: {results.base}. Above: hand paths in instances 1 to "
        f"{min(instances, EXAMPLES)}, from the open circle to the dot; the cross is the target, "
        "the ring around it the distance that counts as success; dotted: reach. Below: hand "
        f"speed, median and quartiles over {count(instances, 'instance')}. {trainings}",
    )


def _draw_movements(
    drawn_of: Sequence[PlottedMovement], results: Results, fastest: float
) -> Figure:
    with drawn(*_MOVEMENT_SIZE) as (figure, axes):
        axes.remove()
        above, below = figure.subplots(2, 1, height_ratios=(1.45, 1))
        reach = sum(results.manifest.segment_lengths)
        draw_paths(above, drawn_of, reach, results.manifest.tolerance)
        above.set(xlabel="x [segment lengths]", ylabel="y [segment lengths]")
        quartiles = speed_quartiles(drawn_of)
        draw_speed(below, quartiles, results.manifest.control_step)
        below.set(xlabel="time [s]", ylabel="hand speed [lengths/s]")
        below.set(xlim=(0, (quartiles.shape[1] - 0.5) * results.manifest.control_step))
        below.set(ylim=(0, 1.05 * fastest))
    return figure


def _movements_of(rows: pd.DataFrame, control_step: float) -> list[PlottedMovement]:
    """Return the movements of an agent, in the order of the instances."""
    found = []
    for _, steps in rows.sort_values("step").groupby("instance"):
        hands = steps[["hand_x", "hand_y"]].to_numpy(np.float64)
        target = steps[["target_x", "target_y"]].to_numpy(np.float64)[-1]
        found.append(PlottedMovement(hands, target, hand_speed(hands, control_step)))
    return found
