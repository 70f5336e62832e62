"""The figures of learning: success during training, and what success costs in training steps."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import EngFormatter, FuncFormatter, NullFormatter

from mmc_gym.agents.policy import EVALUATION_EPISODES
from mmc_gym.report.figures import INTERVALS
from mmc_gym.report.numbers import instances_of, quantity, seeds_of
from mmc_gym.report.panels import Block, Look, Panel, drawn, line_panel, name_lines
from mmc_gym.report.scores import Estimates
from mmc_gym.report.sentences import SUCCESS, base_of
from mmc_gym.report.svg import to_svg
from mmc_gym.training.curves import Axis, curve_rows, mean_curves

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
