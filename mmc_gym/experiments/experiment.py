"""Experiments over trials: blocks with perturbations, probes and rests, as data.

    Experiment  ->  schedule: what happens in each trial  ->  mmc_gym.experiments.trials plays it

All trials are centre-out: they start in one posture, and the targets lie around the hand.
Classic experiments have names, with a strength as scenarios have: `rotation-30`.  Others are
written in Python or YAML.  Angles are in degrees, counter-clockwise.
"""

from __future__ import annotations

import functools
import inspect
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.resources import files
from itertools import cycle, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeAlias, TypeVar, cast

import numpy as np
import yaml
from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    PlainSerializer,
    PlainValidator,
    StringConstraints,
    TypeAdapter,
    ValidationError,
)
from pydantic.dataclasses import dataclass

from mmc_gym._errors import UserError, explain, require, unknown
from mmc_gym._files import read_yaml, read_yaml_file
from mmc_gym.envs.changes import Change, Family, digits
from mmc_gym.envs.names import TaskEntry, parse_change
from mmc_gym.envs.perturbations import (
    Channel,
    CursorJump,
    EndpointFeedback,
    ErrorClamp,
    ForceField,
    JointNoise,
    JointNoiseSpeed,
    NoFeedback,
    VisionNoise,
    VisionNoiseDistance,
    delay,
    vision_delay,
)
from mmc_gym.envs.scenarios import Scenario
from mmc_gym.envs.tasks import CuedTarget, outward

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Class = TypeVar("Class", bound=type)
Part = TypeVar("Part", "Block", "Probe")

_LABEL_ROOM = 90  # letters that fit above a timeline
TRIALS_MOST = 100_000
"""Trials of an experiment, at most."""


def _named(value: object) -> Change:
    """Return a perturbation that has a name, by which files hold it."""
    change = value if isinstance(value, Change) else parse_change(value)
    require(change.is_named, "perturbations", change.name, "one that has a name")
    return change


def _measured(changes: tuple[Change, ...]) -> tuple[Change, ...]:
    """Refuse a perturbation that has no measure of learning, unless it disturbs the senses."""
    for change in changes:
        is_learned = change.unit == "°" or change.family in (ForceField, CursorJump)
        if not (is_learned or _is_of_senses(change)):
            raise UserError(
                "must be rotation, clamp, force-field or cursor-jump, which have a measure of "
                "learning, or noise, delay, feedback or channel; "
                f"{change.name} may hold in all trials (noise)"
            )
    return changes


_ByName = Annotated[
    Change,
    PlainValidator(_named),
    PlainSerializer(lambda change: change.name, return_type=str),
]
Perturbations = Annotated[
    tuple[_ByName, ...],
    BeforeValidator(lambda value: (value,) if isinstance(value, str | Change) else value),
]
Learned = Annotated[Perturbations, AfterValidator(_measured)]
Directions = Annotated[
    tuple[Annotated[float, Ge(-360), Lt(360), AfterValidator(lambda turn: turn % 360)], ...],
    MaxLen(3_600),  # bounds the time to make the environments
]
Word = Annotated[str, MinLen(1)]
Seconds = Annotated[float, Ge(0), Lt(1000)]
Aim = Annotated[float, Ge(-180), Le(180)]
ProbeKind: TypeAlias = Literal["catch", "clamp", "channel", "hidden", "transfer", "jump", "other"]
Kind: TypeAlias = Literal["plain", ProbeKind]
"""What a trial is measured as; "plain" ones have no probe, and show the hand, free to move."""
MARKS = {"catch": "x", "channel": "+", "hidden": "|"}
"""Markers of such probes in figures."""

_NOISE = (JointNoise, JointNoiseSpeed, VisionNoise, VisionNoiseDistance)
_OF_SENSES = (*_NOISE, delay, vision_delay, NoFeedback, EndpointFeedback, Channel)
EIGHT = tuple(45.0 * k for k in range(8))
_STRICT = ConfigDict(extra="forbid")


def _explained(cls: Class) -> Class:
    """Make a class of pydantic raise its errors as a `UserError` in one line."""
    plain: Any = cls.__init__  # type: ignore[misc]

    @functools.wraps(plain)
    def initialize(self: Any, *args: Any, **arguments: Any) -> None:
        try:
            named = inspect.signature(cls).bind_partial(*args).arguments  # so errors name them
            plain(self, **named, **arguments)
        except ValidationError as error:
            raise UserError(f"{cls.__name__}: {explain(error)}") from error

    cls.__init__ = initialize  # type: ignore[misc]
    return cls


def has(changes: Sequence[Change], family: Family) -> bool:
    """Return whether one of the perturbations is of a family, from the start of a trial on."""
    return any(change.family is family and not change.is_timed for change in changes)


def _without_error(changes: Sequence[Change]) -> Literal["clamp", "channel", "hidden", ""]:
    """Return the kind of a trial in which the hand's own error is not seen, or nothing."""
    if has(changes, ErrorClamp):
        return "clamp"
    return "channel" if has(changes, Channel) else "hidden" if has(changes, NoFeedback) else ""


def _check_aim(part: Block | Probe, target_jump: float = 0.0) -> None:
    """Refuse an aim where it would move more than the place that is aimed at."""
    bound = any(has(part.perturbations, kind) for kind in (ErrorClamp, CursorJump, Channel))
    is_possible = not (part.aim and (bound or target_jump))
    require(is_possible, f"aim of {part.name!r}", part.aim, "0 with a clamp, jump or channel")


def _scaled(changes: Sequence[Change], scale: Callable[[float], float]) -> tuple[Change, ...]:
    """Return perturbations with other strengths, those that have one."""
    return tuple(
        change.with_strength(scale(change.number or 0.0)) if change.family.has_strength else change
        for change in changes
    )


def _is_of_senses(change: Change) -> bool:
    return change.family in _OF_SENSES


@_explained
@dataclass(frozen=True, config=_STRICT)
class Probe:
    """Single trials among those of a block in which something else happens."""

    name: Word  #: such as "catch", for the table of trials
    #: one of so many trials, at a drawn place among them, the same for all subjects
    every: Annotated[int, Ge(2)]
    #: in place of the block's; none for a catch trial, clamp-0 for an error clamp
    perturbations: Learned = ()
    targets: Directions = ()  #: directions in place of the block's, which may never be trained
    target_jump: float = 0.0  #: of the target in flight, see `CuedTarget.jump`
    aim: Aim = 0.0  #: in place of the block's
    #: what its trials are measured as.  None: "jump" with a jump of cursor or target; or "transfer"
    #: with targets of its own, "clamp" in an error clamp, "channel", "hidden" with no-feedback,
    #: "catch" without perturbations and aim, or "other"
    kind: ProbeKind | None = None

    def __post_init__(self) -> None:
        _check_aim(self, self.target_jump)

    @property
    def measured_as(self) -> ProbeKind:
        """Its kind, which follows from its other fields if it is not given."""
        if self.kind is not None:
            return self.kind
        if self.target_jump or has(self.perturbations, CursorJump):
            return "jump"
        if self.targets:
            return "transfer"
        usual: ProbeKind = "other" if self.perturbations or self.aim else "catch"
        return _without_error(self.perturbations) or usual


@_explained
@dataclass(frozen=True, config=_STRICT)
class Block:
    """Trials under one condition."""

    name: Word  #: of the phase, such as "baseline" or "washout"
    trials: Annotated[int, Gt(0), Le(TRIALS_MOST)]  #: how many
    #: by name, such as "rotation-30", or as a `Change`: rotation, clamp, force-field, cursor-jump,
    #: of which learning is measured, and what disturbs the senses
    perturbations: Learned = ()
    #: directions from the start; each subject has another order, with all of them before one
    #: is repeated
    targets: Annotated[Directions, MinLen(1)] = EIGHT
    probes: tuple[Probe, ...] = ()  #: trials among these in which something else happens
    gradual: bool = False  #: whether perturbations grow, to their strength in the last trial
    rest: Annotated[float, Ge(0), Lt(math.inf)] = 0.0  #: before the block, s
    go_cue: Seconds = 0.0  #: when the target appears, s after the trial's start; the hand waits
    #: instructed, degrees from the target: where agents are asked to reach, while hand and errors
    #: are measured from the target.  See Taylor, Krakauer & Ivry (2014), J. Neurosci. 34:3023.
    aim: Aim = 0.0

    def __post_init__(self) -> None:
        _check_aim(self)
        few = sum(1 / probe.every for probe in self.probes) < 1
        require(few, "probes", self.probes, "fewer than the trials")
        for probe in self.probes:
            accepted = f"at most the {self.trials} trials of block {self.name!r}"
            require(probe.every <= self.trials, f"every of {probe.name!r}", probe.every, accepted)

    def perturbations_in(self, trial: int) -> tuple[Change, ...]:
        """Return the perturbations in a trial of the block, counted from 0."""
        if not self.gradual:
            return self.perturbations
        return _scaled(self.perturbations, lambda number: number * (trial + 1) / self.trials)

    def probes_by_trial(self, seed: int) -> list[Probe | None]:
        """Return the probe of each trial, or None; their places are drawn."""
        random = np.random.default_rng(seed)
        placed: list[tuple[Probe, int] | None] = [None] * self.trials  # and its first place

        def put(probe: Probe, first: int, tried: set[int]) -> bool:
            group = [trial for trial in range(first, first + probe.every) if trial not in tried]
            free = [trial for trial in group if placed[trial] is None]
            for trial in [random.choice(free)] if free else group:
                tried.add(trial)
                earlier = placed[trial]
                if earlier is None or put(*earlier, tried):  # else it moves on, within its group
                    placed[trial] = probe, first
                    return True
            return False

        for probe in self.probes:
            for first in range(0, self.trials - probe.every + 1, probe.every):
                put(probe, first, set())
        return [place and place[0] for place in placed]


class Condition(NamedTuple):
    """What may differ between the environments of trials."""

    perturbations: tuple[Change, ...] = ()
    go_cue: float = 0.0
    target_jump: float = 0.0


UNCHANGED = Condition()


class PlannedTrial(NamedTuple):
    """A trial of an experiment; attributes that are not explained are those of block and probe."""

    trial: int  #: its number in the experiment, from 0
    block: int  #: index of its block
    phase: str  #: the block's name
    condition: Condition
    strength: float  #: of the last perturbation that is not of the senses; 0 without one
    probe: str  #: the probe's name; empty for other trials
    kind: Kind  #: what it is measured as
    targets: tuple[float, ...]  #: the directions of which one is met
    rest: float  #: before it, s
    aim: float = 0.0  #: instructed, degrees from the target


@_explained
@dataclass(frozen=True, repr=False, config=_STRICT)
class Experiment:
    """An experiment over trials.

    `print` it as YAML; `plot` draws its timeline.
    """

    name: Annotated[str, StringConstraints(pattern=r"^[a-z0-9][a-z0-9.-]*$")]  #: words with hyphens
    blocks: Annotated[tuple[Block, ...], MinLen(1)]  #: in their order
    description: str = ""  #: what it asks, in a line
    source: str = ""  #: the study that it follows
    #: of the targets from the start, as a fraction of the arm's reach
    distance: Annotated[float, Gt(0), Lt(0.5)] = 0.2
    #: duration of a trial from the go cue on; all wait for the latest cue
    trial_seconds: Annotated[float, Gt(0), Lt(1000)] = 1.0
    #: of the servos, mass · length² / s²; None: that of the arm
    torque_limit: Annotated[float, Gt(0)] | None = None
    noise: Perturbations = ()  #: perturbations of all trials, such as noise of the senses
    #: of agents that have one (`body_model.parts.Parts`); 0 as people move
    vigour: Annotated[float, Ge(0), Lt(1.01)] = 0.0
    #: in `EXPERIMENTS`, for people's figures of such an experiment; empty for your own
    family: str = ""

    def __post_init__(self) -> None:
        trials = sum(block.trials for block in self.blocks)
        require(trials <= TRIALS_MOST, "blocks", trials, f"of {TRIALS_MOST:,} trials at most")
        changes = (change for change in self._learned() if not has([change], CursorJump))
        units = dict.fromkeys(change.unit for change in changes if change.number)
        accepted = "of one kind, either force fields or turns of the cursor"
        require(len(units) <= 1, "perturbations", [*units], accepted)

    def _learned(self) -> list[Change]:
        """Return the perturbations of blocks and probes that are not of the senses."""
        return [change for change in self.changes[len(self.noise) :] if not _is_of_senses(change)]

    @property
    def changes(self) -> list[Change]:
        """The perturbations of all trials, and then those of blocks and probes."""
        parts: list[Block | Probe] = [*self.blocks]
        parts += [probe for block in self.blocks for probe in block.probes]
        return [*self.noise, *(change for part in parts for change in part.perturbations)]

    @property
    def settings(self) -> dict[str, Any]:
        """All entries, ready for JSON; perturbations by name."""
        return cast(dict[str, Any], TypeAdapter(Experiment).dump_python(self, mode="json"))

    @property
    def seconds(self) -> float:
        """The duration of a trial, from its start on."""
        return self.trial_seconds + max(block.go_cue for block in self.blocks)

    @functools.cached_property
    def directions(self) -> tuple[float, ...]:
        """All directions in which there are targets."""
        pools = {(trial.targets, trial.aim) for trial in self.schedule}
        return tuple(sorted({(turn + aim) % 360 for pool, aim in pools for turn in pool}))

    def scenario(self, condition: Condition = UNCHANGED, **arguments: Any) -> Scenario:
        """Return what is played under a condition, with more arguments of the environment.

        Trial k of its task has the target in the k-th of the `directions`.
        """
        ways = outward([self.distance], [math.radians(turn) for turn in self.directions])
        task = CuedTarget(*ways, condition.go_cue, condition.target_jump)
        changes = *self.noise, *condition.perturbations
        return Scenario(TaskEntry(self.name, task), changes, arguments)

    @functools.cached_property
    def schedule(self) -> tuple[PlannedTrial, ...]:
        """The trials in their order, the same for all subjects."""
        planned: list[PlannedTrial] = []
        for index, block in enumerate(self.blocks):
            plain: Kind = _without_error(block.perturbations) or "plain"
            for trial, probe in enumerate(block.probes_by_trial(seed=index)):
                changes = block.perturbations_in(trial) if probe is None else probe.perturbations
                learned = [change for change in reversed(changes) if not _is_of_senses(change)]
                jump = probe.target_jump if probe else 0.0
                planned.append(
                    PlannedTrial(
                        trial=len(planned),
                        block=index,
                        phase=block.name,
                        condition=Condition(changes, block.go_cue, jump),
                        strength=next((change.number or 0.0 for change in learned), 0.0),
                        probe=probe.name if probe else "",
                        kind=probe.measured_as if probe else plain,
                        targets=(probe and probe.targets) or block.targets,
                        rest=0.0 if trial else block.rest,
                        aim=(probe or block).aim,
                    )
                )
        return tuple(planned)

    def targets_of(self, seed: int) -> NDArray[np.float64]:
        """Return the target's direction in each trial of the subject with this seed."""
        random, left, targets = np.random.default_rng(seed), dict[Any, list[float]](), []
        for trial in self.schedule:
            key = trial.block, trial.targets
            if not left.get(key):
                left[key] = random.permutation(trial.targets).tolist()
            targets.append(left[key].pop())
        return np.array(targets)

    def plot_timeline(self, axes: Axes) -> None:
        """Draw the strength of the perturbation over trials, with phases, probes and rests."""
        import pandas as pd  # takes long

        table = pd.DataFrame(self.schedule)
        plain = table[table["probe"] == ""]
        trials, strengths, clamped = plain["trial"], plain["strength"], plain["kind"] == "clamp"
        line: Any = {"color": "0.2", "drawstyle": "steps-mid"}
        axes.plot(trials, strengths.mask(clamped), **line, label="_")
        if clamped.any():
            axes.plot(trials, strengths.where(clamped), **line, linestyle=":", label="error clamp")
        if plain["aim"].any():
            axes.step(trials, plain["aim"], "--", color="0.5", where="mid", label="instructed aim")
        others = cycle("14.23")
        style: Any = {"linestyle": "", "markersize": 4, "color": "0.4"}
        for name, of in table[table["probe"] != ""].groupby("probe", sort=False):
            marker = MARKS.get(of["kind"].iloc[-1]) or next(others)
            axes.plot(of["trial"], of["strength"], **style, marker=marker, label=name)
        first = np.cumsum([0, *(block.trials for block in self.blocks)]) - 0.5
        text: Any = {"va": "bottom", "transform": axes.get_xaxis_transform()}
        for block, (begin, end) in zip(self.blocks, pairwise(first), strict=True):
            pause = f"{block.rest:g} s rest, " if block.rest else ""
            room = (end - begin) / len(self.schedule) * _LABEL_ROOM
            is_short = len(pause + block.name) > room  # its label would run over its neighbours'
            place: Any = {"rotation": 30, "ha": "left"} if is_short else {"ha": "center"}
            axes.text((begin + end) / 2, 1.03, pause + block.name, **text, **place)
            axes.axvline(begin, color="0.7", linewidth=0.6, linestyle=":" if pause else "-")
        units = dict.fromkeys(change.unit for change in self._learned())
        unit = f"\n[{', '.join(units)}]" if units else ""
        axes.set(xlim=(-0.5, first[-1]), xlabel="trial", ylabel=f"perturbation{unit}")

    def plot(self) -> Figure:
        """Return a figure of the timeline."""
        from matplotlib import rc_context

        from mmc_gym._plotting import STYLE, ShownFigure

        with rc_context(STYLE):
            figure = ShownFigure(6.5, 1.8)
            self.plot_timeline(figure.add_subplot())
            if figure.axes[0].get_legend_handles_labels()[0]:
                figure.legend(loc="outside right center", frameon=False)
        return figure

    def __repr__(self) -> str:
        phases = ", ".join(f"{block.name} {block.trials}" for block in self.blocks)
        return f"<Experiment {self.name}: {phases}>"

    def __str__(self) -> str:
        changed = TypeAdapter(Experiment).dump_python(self, mode="json", exclude_defaults=True)
        changed["blocks"] = changed.pop("blocks")  # the last
        style: Any = {"allow_unicode": True, "default_flow_style": None, "width": 100}
        return yaml.safe_dump(changed, sort_keys=False, **style).rstrip()


EXPERIMENTS: dict[str, dict[str, Any]] = read_yaml(
    files("mmc_gym.experiments").joinpath("experiments.yml").read_text(encoding="utf-8")
)
"""Experiments after classic ones, by name, of strength 1; `strength` is that of the bare name."""


def find_experiment(experiment: str | Path | Experiment) -> Experiment:
    """Return the experiment of a name, such as "rotation-45", or of a YAML file.

    >>> find_experiment("rotation-45")
    <Experiment rotation-45: baseline 60, learning 160, washout 80>
    """
    if isinstance(experiment, Experiment):
        return experiment
    text = str(experiment)
    if text.endswith((".yml", ".yaml")):
        try:
            entries = read_yaml_file(Path(text))
        except ValueError as error:
            raise UserError(f"{text} must be YAML: {error}") from error
        require(isinstance(entries, dict), text, entries, "a mapping with name and blocks")
        return Experiment(**entries)
    match = re.fullmatch(r"([a-z-]+?)(?:-(-?\d+(?:\.\d+)?))?", text)
    if match is None or match[1] not in EXPERIMENTS:
        raise unknown("experiment", text, EXPERIMENTS, "one with a strength", "a file (mine.yml)")
    family, entries = match[1], dict(EXPERIMENTS[match[1]])
    default = entries.pop("strength")
    strength = float(match[2] or default)
    entries["description"] = entries["description"].format(digits(strength))
    try:
        unit = Experiment(f"{family}-{digits(strength)}", family=family, **entries)
        return _times(unit, strength)
    except UserError as error:
        raise UserError(f"experiment {text!r} is not possible: {error}") from error


def _times(experiment: Experiment, factor: float) -> Experiment:
    """Return an experiment with strengths, aims and jumps of targets times a factor."""

    def scale(number: float) -> float:
        return number * factor if number else 0.0  # never -0.0

    def scaled(part: Part, **changed: Any) -> Part:
        changes = _scaled(part.perturbations, scale)
        return replace(part, perturbations=changes, aim=scale(part.aim), **changed)

    def block_scaled(block: Block) -> Block:
        probes = (scaled(probe, target_jump=scale(probe.target_jump)) for probe in block.probes)
        return scaled(block, probes=tuple(probes))

    return replace(experiment, blocks=tuple(map(block_scaled, experiment.blocks)))
