"""The words in which numbers are explained: sentences below tables and figures, and in files.

Who shows numbers fills in the braces.  A phrase that several tables share is written once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from mmc_gym._tables import count

BETTER = {"high": "more is better", "low": "less is better", "neither": ""}
"""Which values of a measure are better, by its `best`."""

_SAME = "same starts and targets for all"
_SETTLED = "part of an episode after which the hand stays at the target"
_MEDIANS = "(mean of medians)"

# Comparisons.

PLAYED = f"{{env}}{{arguments}}, {{episodes}} episodes, {_SAME}. {{controls}}"
COMPARISON = (
    "Medians (of shares means) with 95 % intervals over episodes, NOT over trainings{trainings}. k "
    "of {episodes}: as many have a value. --explain (in Python explanation) says more."
)
STATISTICS = (
    "Medians ({means}: mean) with 95% bootstrap intervals, Wilson's of a share in one training; "
    "lengths in segment lengths; at the target: {within}. {of_all}: of all episodes; the others: "
    "of those that ended at the target, and k of {episodes} have a value (none where the hand "
    "started there)."
)
IDEAL_HAND = "{reference}: a hand without an arm, through the same measures."
DIFFERENCES = "Differences are of the same episodes of both ({time}: where both ended there)."
SHOWN = "Of {known} measures {shown} are shown; files hold all."
SEVERAL_TRAININGS = "The intervals of {several} replicate over trainings (so many) and episodes."
OVER_EPISODES = (
    "The intervals{others} replicate over episodes (starts and targets), NOT over training seeds: "
    "each agent is the result of one training, or of none."
)

# Rankings, in the terminal and in the report.

RANKING = (
    "{scenarios}, {instances} episodes of each training, the same for all. Ranked by success, each "
    f"scenario weighing the same, then by time {_MEDIANS}. settled: {_SETTLED}.{{improvement}} "
    "{controls} 95 % bootstrap intervals over episodes, and trainings where there are several. "
    "Cells that were not played count as without success. All cells took {seconds:.0f} s of one "
    "processor's time; {reused} were in the store.{mixed}"
)
IMPROVEMENT = " better than {baseline}: probability of being settled longer, ½ if equal."
VERSIONS = " Cells were played with several versions: {versions}."
CHANGED = (
    " These have changed since some of their cells were played: {changed}; play them again in all "
    "scenarios."
)
REPORTED_RANKING = (
    "Ranked by success over {scenarios}, each weighing the same, then by time to target "
    f"{_MEDIANS}. Settled: mean of the {_SETTLED}.{{improvement}} In brackets: 95 % intervals. "
    "{controls} {sample_sizes}"
)
REPORTED_IMPROVEMENT = (
    " Settled for longer than {focus}: in what part of the same episodes, 50 % if equal."
)
SAMPLE_SIZES = f"Episodes{{each}}: {{span}}, the {_SAME}.{{trainings}}"

# The rest of the report.

SETTINGS = (
    "Success: distance to the target at the end of at most",
    "Control step",
    "Segment lengths that agents are given",
    "Other arguments of the environment",
)

SCENARIO = "Success at the end of the episode, %, with 95 % intervals. {controls}{against}"
AGAINST = (
    " Below the success of each other agent: how much more or less {agent} has in the same "
    "episodes. + and blue: {agent} is clearly better; − and orange: clearly worse (the interval "
    "leaves out 0)."
)
GENERALISATION = (
    "Success, %, inside the ranges of a training, between them, beyond them, and in combinations "
    "of what it only met one at a time. The second number is the regret to {best}: how much more "
    "often that ends at the target, with its 95 % interval; below 0 where learning beats it."
)
KINDS = (
    "Success, %, by group of perturbations. Never met: of trainings without that group, one for "
    "each. The second number is the regret to {best}: how much more often that ends at the target, "
    "with its 95 % interval."
)
FAILURES = (
    "Failed: the hand is not at the target at the end of the episode. A number shows that episode "
    "in the replay below."
)

# Experiments over trials.

LEARNING = (
    "Of the mean over {subjects}; below, 95 % bootstrap intervals over subjects; –: no value."
    "{settings}{people}"
)
CITED = " {0.source}: {0.task}; what differs: {0.differs}."

# Figures.

LEARNING_CURVES = (
    "Success: part of {episodes} fixed episodes that end at the target, of the policy as it was "
    "then, without exploration. Lines: mean over training seeds; bands: 95 % bootstrap intervals "
    "over seeds and episodes (none for one seed). Minutes: CPU time of a training, evaluations "
    "included, which is its wall time with a core to itself. Thin dotted lines: 95 % and 98 %."
)


def scenarios(ranked: int, total: int, have_not: str) -> str:
    """Return the number of scenarios that a ranking is over, and how many more there are.

    >>> scenarios(1, 3, "were not")
    '1 scenario (2 more were not attempted by all)'
    """
    others = f" ({total - ranked} more {have_not} attempted by all)" if total > ranked else ""
    return f"{count(ranked, 'scenario')}{others}"


def arguments(values: Mapping[str, Any]) -> str:
    """Return arguments of an environment as they are written in a call."""
    return ", ".join(f"{name}={value}" for name, value in values.items())


def listed(items: Sequence[str]) -> str:
    """Join items by commas, the last one by "and".

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return " and ".join([", ".join(items[:-1]), items[-1]] if len(items) > 1 else items)


def other_controls(controls: Mapping[str, str]) -> dict[str, str]:
    """Return the control modes, by agent, of the agents that differ from most agents.

    Agents that did not act have none, "", and do not differ.
    """
    modes = Counter(filter(None, controls.values())).most_common(1)
    return {agent: mode for agent, mode in controls.items() if mode and mode != modes[0][0]}


def control_note(controls: Mapping[str, str]) -> str:
    """Return a sentence that names the control mode of each agent; empty if none has one."""
    if not any(controls.values()):
        return ""
    others = other_controls(controls)
    most = next(mode for agent, mode in controls.items() if mode and agent not in others)
    but = ", ".join(f"{agent} by {mode}" for agent, mode in others.items())
    return f"All act by {most}{but and f', but {but}'}."
