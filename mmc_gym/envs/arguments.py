"""The arguments of the environments, each listed once: as a field of a frozen dataclass.

`takes` gives an environment's constructor the fields as its signature, so that `help` and editors
show every argument with its type and default.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import wraps
from typing import Concatenate, Literal, ParamSpec, TypeAlias, TypeVar, get_args

from gymnasium.vector import AutoresetMode

from mmc_gym._errors import (
    LARGEST_SIZE,
    require,
    require_between,
    require_choice,
    require_known,
    require_whole,
)
from mmc_gym.body import ArmParameters, Engine
from mmc_gym.envs.changes import Change, Family, OneOf
from mmc_gym.envs.tasks import Task
from mmc_gym.interface import CONTROLS, Control

RewardType = Literal["dense", "sparse"]
RENDER_MODES = ("human", "rgb_array")
AnyChange: TypeAlias = str | Change | Family | OneOf
_MOST_ARMS = 10**8
_MOST_PIXELS = 4096  # of a side

Fields = ParamSpec("Fields")
Taken = TypeVar("Taken")
Self = TypeVar("Self")


@dataclass(frozen=True, kw_only=True)
class ReachArguments(ArmParameters):
    """The arguments of every reaching environment; those of the arm are `ArmParameters`."""

    control: Control = "joint_delta"  #: what actions mean
    reward_type: RewardType = "dense"  #: "sparse": 0 at the target, −1 elsewhere
    control_weight: float = 1.0  #: of the cost of joint speeds
    precision_weight: float = 1.0  #: of the reward near the target
    smoothness_weight: float = 0.0  #: of the cost of changing joint speeds
    success_distance: float = 0.05  #: largest distance to a reached target, segment lengths
    terminate_on_success: bool = False  #: whether an episode ends where the target is reached
    task: str | Task = "random"  #: where the target is and how it moves
    perturbations: AnyChange | Sequence[AnyChange] = ()  #: such as `"delay-160"`
    #: whether what is drawn is shown, on the scale of its ranges; or perturbations with such ranges
    observe_context: bool | AnyChange | Sequence[AnyChange] = False
    engine: Engine = "pymunk"  #: what simulates the arm

    def __post_init__(self) -> None:
        require_choice("control", self.control, CONTROLS)
        is_bool, ends = isinstance(self.terminate_on_success, bool), self.terminate_on_success
        require(is_bool, "terminate_on_success", ends, "True or False")
        require_choice("reward_type", self.reward_type, get_args(RewardType))
        weights = ("control_weight", "precision_weight", "smoothness_weight", "success_distance")
        for name in weights:
            require_between(0, LARGEST_SIZE, **{name: (value := getattr(self, name))})
            object.__setattr__(self, name, float(value))
        super().__post_init__()

    @property
    def arm(self) -> ArmParameters:
        """The parameters of the arm."""
        names = [field.name for field in fields(ArmParameters)]
        return ArmParameters(**{name: getattr(self, name) for name in names})


@dataclass(frozen=True, kw_only=True)
class GoalArguments(ReachArguments):
    """The arguments of goal environments, whose reward follows from the goals alone."""

    reward_type: RewardType = "sparse"
    control_weight: float = 0.0

    def __post_init__(self) -> None:
        for name in ("control_weight", "smoothness_weight"):
            weight = getattr(self, name)
            require(weight == 0.0, name, weight, "0: the reward is a function of the goals")
        super().__post_init__()


@dataclass(frozen=True, kw_only=True)
class SingleArguments(ReachArguments):
    """The arguments of `MMCReachEnv`."""

    render_mode: str | None = None  #: "human" opens a window, "rgb_array" returns pictures
    width: int = 640  #: of pictures, pixels; video encoders like multiples of 16
    height: int = 640  #: of pictures, pixels

    def __post_init__(self) -> None:
        require_choice("render_mode", self.render_mode, (None, *RENDER_MODES))
        require_whole("width", self.width, most=_MOST_PIXELS)
        require_whole("height", self.height, most=_MOST_PIXELS)
        super().__post_init__()


@dataclass(frozen=True, kw_only=True)
class VectorArguments(ReachArguments):
    """The arguments of `MMCReachVectorEnv`."""

    num_envs: int = field(default=1, kw_only=False)
    #: control steps of an episode: "task" takes the task's number, None sets no limit
    max_episode_steps: int | Literal["task"] | None = "task"
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP
    threads: int = 1  #: that step the arms
    copy: bool = True  #: whether each observation is a new array; else the next step overwrites it
    render_mode: str | None = None  #: "rgb_array" returns a picture of each arm
    width: int = 160  #: of a picture, pixels
    height: int = 160  #: of a picture, pixels

    def __post_init__(self) -> None:
        require_choice("render_mode", self.render_mode, (None, "rgb_array"))
        require_whole("width", self.width, most=_MOST_PIXELS)
        require_whole("height", self.height, most=_MOST_PIXELS)
        if self.max_episode_steps not in (None, "task"):
            require_whole("max_episode_steps", self.max_episode_steps)
        require_whole("num_envs", self.num_envs, most=_MOST_ARMS)
        modes = {mode.name: mode for mode in AutoresetMode}
        modes |= {mode.value: mode for mode in AutoresetMode}
        if not isinstance(self.autoreset_mode, AutoresetMode):
            require_choice("autoreset_mode", self.autoreset_mode, modes)
            object.__setattr__(self, "autoreset_mode", modes[self.autoreset_mode])
        super().__post_init__()


@dataclass(frozen=True, kw_only=True)
class SingleGoalArguments(GoalArguments, SingleArguments):
    """The arguments of `MMCReachGoalEnv`."""


@dataclass(frozen=True, kw_only=True)
class VectorGoalArguments(GoalArguments, VectorArguments):
    """The arguments of `MMCReachGoalVectorEnv`."""


def takes(
    kind: Callable[Fields, Taken],
) -> Callable[[Callable[[Self, Taken], None]], Callable[Concatenate[Self, Fields], None]]:
    """Let a constructor that takes a dataclass be called with the fields of the dataclass.

    An unknown argument raises a `UserError` that suggests the nearest one.
    """
    of_arm = {field.name for field in fields(ArmParameters)}
    parameters = [*inspect.signature(kind, eval_str=True).parameters.values()]
    parameters.sort(key=lambda parameter: (parameter.kind, parameter.name in of_arm))
    names = [parameter.name for parameter in parameters]

    def decorate(
        initialize: Callable[[Self, Taken], None],
    ) -> Callable[Concatenate[Self, Fields], None]:
        @wraps(initialize)
        def taking(self: Self, *values: Fields.args, **arguments: Fields.kwargs) -> None:
            require_known("the environment", arguments, names)
            initialize(self, kind(*values, **arguments))

        first = next(iter(inspect.signature(initialize).parameters.values()))
        taking.__signature__ = inspect.Signature([first, *parameters])  # type: ignore[attr-defined]
        return taking  # type: ignore[return-value]

    return decorate
