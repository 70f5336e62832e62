"""What is between environments and agents: observations, and what agents are given."""

from mmc_gym.interface.contract import (
    CONTROLS,
    ActionMeaning,
    CannotActError,
    Control,
    ControlError,
    JointLimits,
    ReachInterface,
    Seen,
    Sensed,
    action_meaning,
    read_attribute,
)
from mmc_gym.interface.observation import (
    OFFSET_SCALE,
    Observation,
    ObservationLayout,
    ObservationParts,
    relative_speeds,
)
from mmc_gym.interface.wrapper import InterfacedEnv, InterfaceLike

__all__ = [
    "CONTROLS",
    "OFFSET_SCALE",
    "ActionMeaning",
    "CannotActError",
    "Control",
    "ControlError",
    "InterfaceLike",
    "InterfacedEnv",
    "JointLimits",
    "Observation",
    "ObservationLayout",
    "ObservationParts",
    "ReachInterface",
    "Seen",
    "Sensed",
    "action_meaning",
    "read_attribute",
    "relative_speeds",
]
