"""The figures of scores: measures at a glance, performance profiles, degradation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, PercentFormatter

from mmc_gym.benchmark.replication import performance_profile
from mmc_gym.measures.catalogue import Measure
from mmc_gym.report.numbers import count, instances_of, quantity, seeds_of, unit
from mmc_gym.report.panels import Block, Look, Panel, drawn, line_panel, shortened
from mmc_gym.report.results import Results
from mmc_gym.report.scores import Estimates
from mmc_gym.report.sentences import SUCCESS, base_of, base_title, families
from mmc_gym.report.svg import to_svg

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
        curves = performance_profile(frame, taus, "low", "final_distance", PROFILE_RESAMPLES)
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
