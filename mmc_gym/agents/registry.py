"""The agents of this package and what is known of each.  A new agent is one new entry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium as gym

from mmc_gym.agents.base import Agent, RandomAgent, require_plain
from mmc_gym.agents.body_model.agent import ik_body, mmc_body
from mmc_gym.agents.inverse_kinematics import (
    InverseKinematicsAgent,
    Solver,
    closed_form,
    damped_least_squares,
)
from mmc_gym.agents.mmc import MMCAgent, TimedMMCAgent, dynamic_mmc, network_of_arm, tuned_mmc
from mmc_gym.agents.optimal_control import OptimalControlAgent
from mmc_gym.agents.planners import MinimumJerkAgent
from mmc_gym.agents.policy_network import VIEWS, View
from mmc_gym.interface import Control, InterfacedEnv, ReachInterface
from mmc_gym.network import LearnedNormalizer

Kind = Literal[
    "yours",
    "network",
    "inverse kinematics",
    "planner",
    "optimal control",
    "learned",
    "baseline",
    "ideal",
]


@dataclass(frozen=True)
class Knowledge:
    """The kind of an agent, what it is given and what it senses, in words for a table."""

    kind: Kind  #: "yours" for one that does not ship with the package
    lengths: str = "given"  #: whether it is given the segment lengths
    actions: str = "given"  #: whether it is given what its actions do (the servo and its limits)
    senses: str = "posture once, at the start; the target in every step"  #: what it looks at


UNKNOWN = Knowledge("yours", "unknown", "unknown", "unknown")

REFERENCE = "minimum jerk (ideal)"
"""The name of the ideal hand, which plays without an arm, beside the agents."""

IDEAL = Knowledge("ideal", "has no arm", "has no arm", "start and target")


def learned_knowledge(
    view: View, base_agent: str = "", kind: Kind = "learned", *, memory: int = 0
) -> Knowledge:
    """Return what a trained policy of this view is given and senses.

    It may correct a `base_agent`, and remember its last steps (`memory`).
    """
    senses = f"{VIEWS[view]}, in every step"
    senses += f"; remembers its last {memory} steps" if memory else ""
    if not base_agent:
        unaware = "not given: had to learn"
        return Knowledge(kind, unaware, unaware, senses)
    given = f"given to {base_agent}, which it corrects"
    return Knowledge(kind, given, given, f"{senses}; and what {base_agent} proposes")


@dataclass(frozen=True)
class AgentEntry:
    """An agent of this package, and what is known of it."""

    description: str  #: what it is, in a line
    #: makes it from what it is given; for a trained agent, its training of seed 0
    build: Callable[[ReachInterface], Agent[Any]]
    knowledge: Knowledge  #: its kind, what it is given, and what it senses
    #: the control mode in which it is compared.  Agents that give joint targets act in every mode
    #: that has a servo; only joint positions do not depend on late senses.
    control: Control = "joint_position"
    training_seeds: int = 0  #: how many trainings of it ship with the package; 0 if untrained

    def make(self, env: gym.Env[Any, Any]) -> Agent[Any]:
        """Make it for an environment, whose wrappers may change no observation or action."""
        require_plain(env)
        interface = ReachInterface.of(env)
        if self.build is RandomAgent and isinstance(env, InterfacedEnv):
            return RandomAgent(interface, env.action_space)
        return self.build(interface)


def _mmc(
    description: str, build: Callable[[ReachInterface], Agent[Any]], **knowledge: str
) -> AgentEntry:
    return AgentEntry(description, build, Knowledge("network", **knowledge))


_BODY = {
    "lengths": "given, then identified",
    "senses": "posture, speeds, seen hand and target in every step; estimates noise and delay, "
    "detects locked joints and contacts",
}


def _ik(description: str, solver: Solver, iterations_per_step: int = 3) -> AgentEntry:
    return AgentEntry(
        description,
        lambda interface: InverseKinematicsAgent(interface, solver, iterations_per_step),
        Knowledge("inverse kinematics"),
    )


def _trained(
    name: str,
    description: str,
    training_seeds: int,
    *,
    control: Control = "joint_delta",
    view: View = "arm",
    base_agent: str = "",
    memory: int = 0,
    command: str = "mmc-gym train {}",
) -> dict[str, AgentEntry]:
    def build(interface: ReachInterface) -> Agent[Any]:
        # Not at the top: pydantic, which checks the card, takes a while to load.
        from mmc_gym.agents.policy import PolicyAgent, load_policy, shipped_file

        return PolicyAgent(*load_policy(shipped_file(name, 0)), interface)

    description += f", trained by `{command.format(name)}`"
    knowledge = learned_knowledge(view, base_agent, memory=memory)
    return {name: AgentEntry(description, build, knowledge, control, training_seeds)}


AGENTS: dict[str, AgentEntry] = {
    "mmc-body": _mmc(
        "MMC network as internal model of a body that it identifies: senses, body, locks, "
        "imagination, drive",
        mmc_body,
        **_BODY,
    ),
    "ik-body": AgentEntry(
        "as mmc-body, with damped least squares as internal model",
        ik_body,
        Knowledge("inverse kinematics", **_BODY),
    ),
    "mmc": _mmc("dynamic MMC network, best setting", dynamic_mmc),
    "mmc-classical": _mmc(
        "classical MMC network with the paper's constants, one iteration per control step",
        lambda interface: MMCAgent(interface, network_of_arm(interface)),
    ),
    "mmc-neural": _mmc(
        "as mmc, with the learned normalizer",
        lambda interface: dynamic_mmc(interface, LearnedNormalizer.shipped()),
    ),
    "mmc-tuned": _mmc("as mmc, with constants that Optuna found", tuned_mmc),
    "ik-dls": _ik("inverse kinematics by damped least squares", damped_least_squares),
    **_trained("ppo", "PPO of stable-baselines3", 10),
    **_trained("sac", "SAC of stable-baselines3", 5),
    **_trained("tqc-her", "TQC of sb3-contrib with hindsight, sparse rewards", 5),
    **_trained(
        "ppo-residual",
        "PPO on top of mmc: it corrects its actions",
        5,
        base_agent="mmc",
        command="python -m studies.learners.ppo_residual",
    ),
    **_trained("ppo-smooth", "PPO that is also rewarded for smoothness", 3),
    **_trained(
        "ppo-position",
        "PPO whose actions are joint angles",
        3,
        control="joint_position",
        view="target",
        command="python -m studies.learners.ppo_position",
    ),
    **_trained("ppo-torque", "PPO whose actions are torques", 3, control="joint_torque"),
    **_trained(
        "ppo-memory",
        "a memory of 1.4 s, taught by PPO that is given the truth, under perturbations drawn for "
        "each episode",
        3,
        memory=68,
        command="python -m studies.learners.ppo_memory",
    ),
    "random": AgentEntry(
        "uniformly random actions, the same at every run",
        RandomAgent,
        Knowledge("baseline", "not given", "not given", "nothing"),
    ),
    "ik-closed-form": _ik(
        "inverse kinematics in closed form, the solution nearest to the posture; N up to 3",
        closed_form,
        iterations_per_step=1,
    ),
    "mmc-bell": _mmc(
        "classical MMC network on a minimum-jerk time base, for a bell-shaped speed",
        lambda interface: TimedMMCAgent(
            interface, network_of_arm(interface), iterations_per_step=2
        ),
    ),
    "minimum-jerk": AgentEntry(
        "minimum-jerk path of the hand, followed by damped least squares",
        MinimumJerkAgent,
        Knowledge("planner"),
    ),
    "optimal-control": AgentEntry(
        "optimal feedback control (LQG with noise that grows with the command) of the given arm",
        OptimalControlAgent,
        Knowledge(
            "optimal control",
            senses="posture, speeds, seen hand and target in every step, filtered",
        ),
        control="joint_velocity",
    ),
}
