"""The battery: the environments of the benchmark, by name: every task, and every perturbation.

Perturbations are met in the task "random" throughout, whatever the task under an id of their own,
so that an agent's episodes under all of them differ from those under "random" in the perturbation
alone: starts and targets are drawn from the same seeds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import cos, sin, tau
from typing import Any

import gymnasium as gym

from mmc_gym.envs.perturbations import (
    ForceField,
    HandMass,
    JointNoise,
    LockedJoint,
    Obstacles,
    Perturbation,
    SegmentLength,
    SensoryDelay,
    VisionNoise,
    VisuomotorRotation,
)
from mmc_gym.envs.tasks import PointToPoint, Task
from mmc_gym.envs.vector import MMCReachVectorEnv

BASELINE = "random"
"""The environment without perturbation: strength 0 of every family."""


@dataclass(frozen=True)
class BatteryEnvironment:
    """An environment of the battery.

    Attributes:
        description: what it is, in a line.
        env_id: Gymnasium's id.
        arguments: of the environment, those that `env_id` does not set.
        family: of the perturbation; empty for a task.
        strength: of the perturbation, to be compared within its family.
        unit: of the strength.
    """

    description: str
    env_id: str = "MMCReach-v0"
    arguments: Mapping[str, Any] = field(default_factory=dict)
    family: str = ""
    strength: float | None = None
    unit: str = ""

    def make(self, control: str | None = None) -> gym.Env[Any, Any]:
        """A single environment, with another control mode if one is given."""
        return gym.make(self.env_id, **self._arguments(control))

    def make_vec(self, episodes: int, control: str | None = None) -> MMCReachVectorEnv:
        """The native vector environment."""
        arguments = self._arguments(control)
        env = gym.make_vec(self.env_id, num_envs=episodes, **arguments).unwrapped
        assert isinstance(env, MMCReachVectorEnv)
        return env

    def _arguments(self, control: str | None) -> dict[str, Any]:
        return {**self.arguments, **({} if control is None else {"control": control})}

    def instances(self, episodes: int) -> list[dict[str, Any]]:
        """Options of the reset of each instance: every trial once, if they are numbered.

        Args:
            episodes: how many there are where trials are drawn.
        """
        env: Any = self.make().unwrapped
        trials = env.setup.task.trial_count
        env.close()
        if trials is None:
            return [{} for _ in range(episodes)]
        return [{"trial": trial} for trial in range(trials)]

    @property
    def settings(self) -> dict[str, Any]:
        """What it is, ready for JSON; equal for equal environments."""
        return {
            "id": self.env_id,
            "kwargs": _plain(self.arguments),
            "description": self.description,
            "family": self.family,
            "strength": self.strength,
            "unit": self.unit,
            "baseline": BASELINE if self.family else None,
        }


def find_environments(names: Iterable[str]) -> dict[str, BatteryEnvironment]:
    """The environments of the battery with these names; all, if there are none.

    Raises:
        ValueError: for an unknown name.
    """
    names = tuple(dict.fromkeys(names)) or tuple(ENVIRONMENTS)
    unknown = [name for name in names if name not in ENVIRONMENTS]
    if unknown:
        raise ValueError(
            f"environments must be among {', '.join(ENVIRONMENTS)}, got {', '.join(unknown)}"
        )
    return {name: ENVIRONMENTS[name] for name in names}


def _plain(value: Any) -> Any:
    """A value as JSON would bring it back."""
    if isinstance(value, Perturbation | Task):
        fields: dict[str, Any] = asdict(value)  # type: ignore[call-overload]
        return {"name": type(value).__name__, **_plain(fields)}
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(one) for one in value]
    return value


def _outward() -> PointToPoint:
    """From one point outward, to all distances in all directions."""
    turns = [tau * direction / _DIRECTIONS for direction in range(_DIRECTIONS)]
    circles = [
        (distance * cos(turn), 0.5 + distance * sin(turn))
        for distance in _DISTANCES
        for turn in turns
    ]
    return PointToPoint(((0.0, 0.5), *circles), tuple((0, k + 1) for k in range(len(circles))))


def _task(description: str, env_id: str) -> BatteryEnvironment:
    return BatteryEnvironment(description, env_id)


def _family(
    family: str, unit: str, description: str, strengths: Mapping[float, Perturbation]
) -> dict[str, BatteryEnvironment]:
    return {
        f"{family}-{strength:g}": BatteryEnvironment(
            description.format(f"{strength:g}"),
            arguments={"perturbations": (one,)},
            family=family,
            strength=strength,
            unit=unit,
        )
        for strength, one in strengths.items()
    }


def _lengths(family: str, sign: int, percents: Sequence[int], told: bool) -> dict[str, Any]:
    return _family(
        family,
        "%",
        f"last segment {{}} % {'longer' if sign > 0 else 'shorter'}, agents "
        f"{'are' if told else 'are not'} told",
        {percent: SegmentLength(1 + sign * percent / 100, told=told) for percent in percents},
    )


def _locked(family: str, when: str, time: float, joints: Sequence[int]) -> dict[str, Any]:
    told = family.endswith("told")
    described = (
        f"joint {{}} (from the base) locked {when}, agents {'are' if told else 'are not'} told"
    )
    of = {float(joint): LockedJoint(joint - 1, time, told) for joint in joints}
    return _family(family, "joint", described, of)


_DISTANCES = (0.1, 0.2, 0.3, 0.4)  # from start to target, in reaches
_DIRECTIONS = 8
_DISCS = ((1.5, 1.0, 0.25), (-1.5, 1.0, 0.25), (1.5, -1.0, 0.25), (-1.5, -1.0, 0.25))

ENVIRONMENTS: dict[str, BatteryEnvironment] = {
    "random": _task("random starts and targets", "MMCReach-v0"),
    "paper": _task("the paper's 420 movements between 21 targets", "MMCReachPaper-v0"),
    "centre-out": _task("eight targets around a point", "MMCReachCentreOut-v0"),
    "distances": BatteryEnvironment(
        "eight directions at each of four distances", arguments={"task": _outward()}
    ),
    "double-step-100": _task("target jumps after 0.1 s", "MMCReachDoubleStep100-v0"),
    "double-step-200": _task("target jumps after 0.2 s", "MMCReachDoubleStep200-v0"),
    "pursuit": _task("target moves along sums of sines", "MMCReachPursuit-v0"),
    "via-points": _task("three targets, one after the other", "MMCReachViaPoints-v0"),
    **_family(
        *("force-field", "mass/s", "viscous curl field of {} at the hand"),
        {curl: ForceField(curl) for curl in (30.0, 60.0, 90.0)},
    ),
    **_family(
        *("rotation", "°", "cursor turned by {}° about the base"),
        {degrees: VisuomotorRotation(degrees) for degrees in (15.0, 30.0, 45.0, 60.0)},
    ),
    **_family(
        *("hand-mass", "segment masses", "hand carries {} segment masses"),
        {mass: HandMass(mass) for mass in (1.0, 3.0, 10.0)},
    ),
    **_lengths("longer", +1, (10, 20, 50), told=False),
    **_lengths("longer-told", +1, (20, 50), told=True),
    **_lengths("shorter", -1, (10, 20, 50), told=False),
    **_lengths("shorter-told", -1, (20, 50), told=True),
    **_locked("locked", "from the start", 0.0, (1, 2, 3)),
    **_locked("locked-told", "from the start", 0.0, (1, 2, 3)),
    **_locked("locks", "after 0.2 s", 0.2, (1, 2, 3)),
    **_locked("locks-told", "after 0.2 s", 0.2, (2,)),
    **_family(
        *("joint-noise", "rad", "noise of joint angles, {} rad"),
        {std: JointNoise(std) for std in (0.01, 0.02, 0.05)},
    ),
    **_family(
        *("joint-noise-speed", "s", "noise of joint angles, {} s of joint speed"),
        {std: JointNoise(0.0, speed_std=std) for std in (0.01, 0.03)},
    ),
    **_family(
        *("vision-noise", "lengths", "noise of the seen hand and target, {} segment lengths"),
        {std: VisionNoise(std) for std in (0.01, 0.03, 0.1)},
    ),
    **_family(
        *(
            "vision-noise-distance",
            "of distance",
            "noise of the seen hand and target, {} of their distance",
        ),
        {std: VisionNoise(0.0, distance_std=std) for std in (0.05, 0.15)},
    ),
    **_family(
        *("delay", "ms", "all senses late by {} ms"),
        {seconds * 1000: SensoryDelay(seconds) for seconds in (0.02, 0.04, 0.1, 0.2, 0.4)},
    ),
    **_family(
        *("obstacles", "discs", "fixed discs stop the arm, {}"),
        {count: Obstacles(_DISCS[:count]) for count in (1, 2, 4)},
    ),
    **{
        f"gravity-{g:g}": BatteryEnvironment(
            f"arm hangs in a gravity of {g:g} segment lengths/s²",
            arguments={"gravity": (0.0, -g)},
            family="gravity",
            strength=g,
            unit="lengths/s²",
        )
        for g in (10.0, 60.0, 120.0)
    },
}
"""The environments by name.

More strengths than `mmc_gym.envs.perturbations.PERTURBATIONS` has, to make series of them.  Delays
are whole control steps of 20 ms.
"""
