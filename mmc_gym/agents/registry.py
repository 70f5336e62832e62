"""Controllers for the reaching environments, all behind stable-baselines3's `predict`.

`AGENTS` lists them, with all that is known of each.  A new agent is one new entry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym

from mmc_gym.agents.base import Agent, RandomAgent
from mmc_gym.agents.closed_loop.agent import (
    LOOPS,
    closed_loop_inverse_kinematics,
    closed_loop_mmc,
    told_lockable,
)
from mmc_gym.agents.ik.agent import InverseKinematicsAgent, Solver
from mmc_gym.agents.ik.closed_form import closed_form
from mmc_gym.agents.ik.iterative import (
    cyclic_coordinate_descent,
    damped_least_squares,
    fabrik,
    jacobian_transpose,
    null_space,
    pseudo_inverse,
)
from mmc_gym.agents.mmc import MMCAgent, TimedMMCAgent, dynamic_mmc
from mmc_gym.agents.planners import MinimumJerkAgent, PassiveMotionAgent
from mmc_gym.agents.views import VIEWS, View
from mmc_gym.interface import Control, ReachInterface
from mmc_gym.network import EuclideanNormalizer, LearnedNormalizer, MMCNetwork, Normalizer
from mmc_gym.network.chain import Floats

Kind = Literal["yours", "network", "inverse kinematics", "planner", "learned", "baseline", "ideal"]


@dataclass(frozen=True)
class Knowledge:
    """The kind of an agent, what it is told of its body and what it senses, in words for a table.

    Attributes:
        kind: the sort of agent; "yours" for one that does not ship with the package.
        lengths: whether it is told the segment lengths.
        actions: whether it is told what its actions do (the servo and its limits).
        senses: what it looks at, and when.
    """

    kind: Kind
    lengths: str = "told"
    actions: str = "told"
    senses: str = "posture once, at the start; the target in every step"


UNKNOWN = Knowledge("yours", "unknown", "unknown", "unknown")


def learned_knowledge(view: View, base_agent: str = "", kind: Kind = "learned") -> Knowledge:
    """Return what a trained policy is told and senses.

    Args:
        view: what it sees.
        base_agent: the agent that it corrects; empty for none.
        kind: "yours" for a policy that does not ship.
    """
    senses = f"{VIEWS[view]}, in every step"
    if not base_agent:
        unaware = "not told: had to learn"
        return Knowledge(kind, unaware, unaware, senses)
    told = f"told to {base_agent}, which it corrects"
    return Knowledge(kind, told, told, f"{senses}; and what {base_agent} proposes")


@dataclass(frozen=True)
class AgentEntry:
    """An agent of this package, with all that is known of it.

    Attributes:
        description: a line.
        make: makes it for an environment; of trained agents, the one of training seed 0.
        knowledge: its kind, what it is told, and what it senses.
        control: the control mode that it acts by; None for any that has a servo.
        training_seeds: how many trainings of it ship with the package; 0: it is not trained.
    """

    description: str
    make: Callable[[gym.Env[Any, Any]], Agent[Any]]
    knowledge: Knowledge
    control: Control | None = None
    training_seeds: int = 0

    @property
    def kind(self) -> Kind:
        """The sort of agent."""
        return self.knowledge.kind


def _dynamic_mmc(env: gym.Env[Any, Any], normalizer: Normalizer) -> MMCAgent:
    return dynamic_mmc(ReachInterface.of(env), normalizer)


def _classical_mmc(env: gym.Env[Any, Any]) -> MMCAgent:
    interface = ReachInterface.of(env)
    return MMCAgent(interface, MMCNetwork(interface.segment_lengths))


def _tuned_mmc(env: gym.Env[Any, Any]) -> MMCAgent:
    """The dynamic network with constants from `mmc-gym tune mmc`, 20 trials of 200,000 steps.

    They bring 77.4 % of the time at the target, those of `mmc` 75.7 %.  d is just above
    (N + 1) / 2, where the network no longer converges.
    """
    interface = ReachInterface.of(env)
    lengths = interface.segment_lengths
    network = MMCNetwork(
        lengths,
        0.547 * (len(lengths) + 1),
        dynamics="paper",
        velocity_damping=4.44,
        velocity_decay=0.963,
    )
    return MMCAgent(interface, network, iterations_per_step=5)


def _timed_mmc(env: gym.Env[Any, Any]) -> TimedMMCAgent:
    interface = ReachInterface.of(env)
    return TimedMMCAgent(interface, MMCNetwork(interface.segment_lengths), iterations_per_step=2)


def _inverse_kinematics(
    solver: Solver, iterations_per_step: int
) -> Callable[[gym.Env[Any, Any]], InverseKinematicsAgent]:
    return lambda env: InverseKinematicsAgent(ReachInterface.of(env), solver, iterations_per_step)


def _limited_inverse_kinematics(
    solver: Callable[..., Floats], iterations_per_step: int
) -> Callable[[gym.Env[Any, Any]], InverseKinematicsAgent]:
    """As `_inverse_kinematics`, of a solver that can heed joint limits."""

    def make(env: gym.Env[Any, Any]) -> InverseKinematicsAgent:
        interface = ReachInterface.of(env)
        limited = partial(solver, joint_limits=interface.joint_limits)
        return InverseKinematicsAgent(interface, limited, iterations_per_step, heeds_limits=True)

    return make


def policy_agent(path: Path, env: gym.Env[Any, Any]) -> Agent[Any]:
    """Make the agent of a policy's file for an environment."""
    # Not at the top: pydantic, which checks the card, takes a while to load.
    from mmc_gym.agents.policy import PolicyAgent, load_policy

    return PolicyAgent(*load_policy(path), ReachInterface.of(env))


def _shipped(name: str, env: gym.Env[Any, Any]) -> Agent[Any]:
    from mmc_gym.agents.policy import shipped_file

    return policy_agent(shipped_file(name, 0), env)


def _trained(
    name: str,
    description: str,
    training_seeds: int,
    *,
    control: Control = "joint_delta",
    view: View = "arm",
    base_agent: str = "",
) -> AgentEntry:
    return AgentEntry(
        f"{description}, trained by `mmc-gym train {name}`",
        partial(_shipped, name),
        learned_knowledge(view, base_agent),
        control=control,
        training_seeds=training_seeds,
    )


def _closed_loop(name: str) -> Callable[[gym.Env[Any, Any]], Agent[Any]]:
    return lambda env: closed_loop_mmc(ReachInterface.of(env), LOOPS[name], told_lockable(env))


_MMC = Knowledge("network")
_IK = Knowledge("inverse kinematics")
_PLANNER = Knowledge("planner")
_LOOP = "posture, seen hand and target in every step"


AGENTS: dict[str, AgentEntry] = {
    "mmc": AgentEntry(
        "dynamic MMC network, best setting",
        lambda env: _dynamic_mmc(env, EuclideanNormalizer()),
        _MMC,
    ),
    "mmc-classical": AgentEntry(
        "classical MMC network with the paper's constants, one iteration per control step",
        _classical_mmc,
        _MMC,
    ),
    "mmc-neural": AgentEntry(
        "as mmc, with the learned normalizer",
        lambda env: _dynamic_mmc(env, LearnedNormalizer.shipped()),
        _MMC,
    ),
    "mmc-tuned": AgentEntry(
        "as mmc, with constants tuned as those of the trained policies were",
        _tuned_mmc,
        _MMC,
    ),
    "ik-dls": AgentEntry(
        "inverse kinematics by damped least squares",
        _inverse_kinematics(damped_least_squares, iterations_per_step=3),
        _IK,
    ),
    "ppo": _trained("ppo", "PPO of stable-baselines3", 10),
    "sac": _trained("sac", "SAC of stable-baselines3", 5),
    "tqc-her": _trained("tqc-her", "TQC of sb3-contrib with hindsight, sparse rewards", 5),
    "ppo-residual": _trained(
        "ppo-residual", "PPO on top of mmc: it corrects its actions", 5, base_agent="mmc"
    ),
    "ppo-smooth": _trained("ppo-smooth", "PPO that is also rewarded for smoothness", 3),
    "ppo-position": _trained(
        "ppo-position",
        "PPO whose actions are joint angles",
        3,
        control="joint_position",
        view="target",
    ),
    "ppo-torque": _trained(
        "ppo-torque", "PPO whose actions are torques", 3, control="joint_torque"
    ),
    "random": AgentEntry(
        "uniformly random actions, the same at every run",
        lambda env: RandomAgent(len(ReachInterface.of(env).segment_lengths)),
        Knowledge("baseline", "not told", "not told", "nothing"),
    ),
    "ik-transpose": AgentEntry(
        "inverse kinematics by the Jacobian transpose",
        _inverse_kinematics(jacobian_transpose, iterations_per_step=5),
        _IK,
    ),
    "ik-pinv": AgentEntry(
        "inverse kinematics by the truncated pseudo-inverse",
        _inverse_kinematics(pseudo_inverse, iterations_per_step=3),
        _IK,
    ),
    "ik-nullspace": AgentEntry(
        "as ik-dls, with a comfortable posture in the null space",
        _limited_inverse_kinematics(null_space, iterations_per_step=3),
        _IK,
    ),
    "ik-ccd": AgentEntry(
        "inverse kinematics by cyclic coordinate descent",
        _limited_inverse_kinematics(cyclic_coordinate_descent, iterations_per_step=3),
        _IK,
    ),
    "ik-fabrik": AgentEntry(
        "inverse kinematics by FABRIK, forward and backward reaching",
        _inverse_kinematics(fabrik, iterations_per_step=3),
        _IK,
    ),
    "ik-closed-form": AgentEntry(
        "inverse kinematics in closed form, the solution nearest to the posture; N up to 3",
        _limited_inverse_kinematics(closed_form, iterations_per_step=1),
        _IK,
    ),
    "mmc-bell": AgentEntry(
        "classical MMC network on a minimum-jerk time base, for a bell-shaped speed",
        _timed_mmc,
        _MMC,
    ),
    "minimum-jerk": AgentEntry(
        "minimum-jerk path of the hand, followed by damped least squares",
        lambda env: MinimumJerkAgent(ReachInterface.of(env)),
        _PLANNER,
    ),
    "pmp": AgentEntry(
        "Passive Motion Paradigm with a terminal attractor",
        lambda env: PassiveMotionAgent(ReachInterface.of(env)),
        _PLANNER,
    ),
    "mmc-feedback": AgentEntry(
        "as mmc, with the sensed posture in the mean, and the seen hand correcting the clamp",
        _closed_loop("feedback"),
        replace(_MMC, senses=_LOOP),
    ),
    "mmc-delay": AgentEntry(
        "as mmc-feedback, with the delay of the senses estimated and bridged",
        _closed_loop("delay"),
        replace(_MMC, senses=f"{_LOOP}; estimates their delay"),
    ),
    "mmc-lengths": AgentEntry(
        "as mmc, with segment lengths identified on line",
        _closed_loop("lengths"),
        replace(_MMC, lengths="told, then identified", senses=_LOOP),
    ),
    "mmc-lock": AgentEntry(
        "as mmc, with locked joints detected and clamped",
        _closed_loop("lock"),
        replace(_MMC, senses=f"{_LOOP}; detects locked joints"),
    ),
    "mmc-closed": AgentEntry(
        "as mmc, with all loops closed: feedback, delay, lengths and locks",
        _closed_loop("closed"),
        replace(
            _MMC, lengths="told, then identified", senses=f"{_LOOP}; estimates delay, detects locks"
        ),
    ),
    "ik-dls-feedback": AgentEntry(
        "as ik-dls, with the feedback of mmc-feedback",
        lambda env: closed_loop_inverse_kinematics(
            ReachInterface.of(env), damped_least_squares, LOOPS["feedback"]
        ),
        replace(_IK, senses=_LOOP),
    ),
}
