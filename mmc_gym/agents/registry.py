"""The agents of this package, and what is known about each.  A new agent needs one new entry."""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import gymnasium as gym

from mmc_gym.agents.base import Agent, require_plain
from mmc_gym.interface import Control, ReachInterface

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

    kind: Kind  #: "yours" if the agent does not ship with the package
    lengths: str = "given"  #: whether it is given the segment lengths
    actions: str = "given"  #: whether it is given the effect of its actions (servo and limits)
    senses: str = "posture once, at the start; the target in every step"  #: what it looks at


UNKNOWN = Knowledge("yours", lengths="unknown", actions="unknown", senses="unknown")

REFERENCE = "minimum jerk (ideal)"
"""The name of the ideal hand: it moves without an arm, for comparison with agents."""

IDEAL = Knowledge("ideal", lengths="has no arm", actions="has no arm", senses="start and target")


def learned_knowledge(
    base_agent: str = "", kind: Kind = "learned", *, memory: int = 0, context: bool = False
) -> Knowledge:
    """Return the `Knowledge` of a trained policy.

    The policy may correct the actions of `base_agent`, remember its last `memory` steps, and be
    given what was drawn for the episode (`context`).
    """
    senses = "posture, joint speeds, target, and offset from hand to target, in every step"
    senses += f"; remembers its last {memory} steps" if memory else ""
    senses += "; and what was drawn for the episode" if context else ""
    access = "not given: had to learn"
    if base_agent:
        access = f"given to {base_agent}, which it corrects"
        senses += f"; and what {base_agent} proposes"
    return Knowledge(kind, lengths=access, actions=access, senses=senses)


@dataclass(frozen=True)
class AgentEntry:
    """An agent of this package, and what is known about it."""

    description: str  #: what it is, in a line
    #: "module:function" that makes it from a `ReachInterface`, imported when it is needed; for a
    #: trained agent, its training of seed 0
    maker: str
    knowledge: Knowledge  #: its kind, what it is given, and what it senses
    #: the only control mode in which it is compared; None: the mode of the environment, as for
    #: all agents that give joint targets, because they act in every mode that has a servo
    control: Control | None = None
    training_seeds: int = 0  #: how many trainings of it ship with the package; 0 if untrained
    settings: Mapping[str, Any] = field(default_factory=dict)  #: arguments of the maker, by name
    draws_actions: bool = False  #: whether the maker also takes the action space, as `space`
    is_ranked: bool = True  #: whether a benchmark that names no agents includes it

    def build(self, interface: ReachInterface, **settings: Any) -> Agent[Any]:
        """Return the agent for an interface; `settings` are further arguments of its maker."""
        maker = pkgutil.resolve_name(f"mmc_gym.agents.{self.maker}")
        agent: Agent[Any] = maker(interface, **self.settings, **settings)
        return agent

    def make(self, env: gym.Env[Any, Any]) -> Agent[Any]:
        """Return the agent for `env`, whose wrappers may not change observations or actions."""
        require_plain(env)
        space = {"space": env.action_space} if self.draws_actions else {}
        return self.build(ReachInterface.of(env), **space)


_IDENTIFIES_BODY = {
    "lengths": "given, then identified",
    "senses": "posture, speeds, seen hand and target in every step; estimates noise and delay, "
    "detects locked joints and contacts",
}


def _trained(
    name: str,
    description: str,
    training_seeds: int,
    *,
    control: Control = "joint_delta",
    base_agent: str = "",
    memory: int = 0,
    context: bool = False,
    is_ranked: bool = True,
    command: str = "mmc-gym train {}",
) -> dict[str, AgentEntry]:
    """Return the entry of a policy that ships with the package, in a dict under its name."""
    return {
        name: AgentEntry(
            f"{description}, trained by `{command.format(name)}`",
            "policy:shipped_agent",
            learned_knowledge(base_agent, memory=memory, context=context),
            control,
            training_seeds,
            settings={"name": name},
            is_ranked=is_ranked,
        )
    }


AGENTS: dict[str, AgentEntry] = {
    "mmc-body": AgentEntry(
        "MMC network as internal model of a body that it identifies: senses, body, locks, "
        "imagination, drive",
        "body_model.agent:mmc_body",
        Knowledge("network", **_IDENTIFIES_BODY),
    ),
    "ik-body": AgentEntry(
        "as mmc-body, with damped least squares as internal model",
        "body_model.agent:ik_body",
        Knowledge("inverse kinematics", **_IDENTIFIES_BODY),
    ),
    "mmc": AgentEntry("dynamic MMC network, best setting", "mmc:dynamic_mmc", Knowledge("network")),
    "mmc-classical": AgentEntry(
        "classical MMC network with the paper's constants, one iteration per control step",
        "mmc:classical_mmc",
        Knowledge("network"),
    ),
    "mmc-neural": AgentEntry(
        "as mmc, with the learned normalizer", "mmc:neural_mmc", Knowledge("network")
    ),
    "ik-dls": AgentEntry(
        "inverse kinematics by damped least squares",
        "inverse_kinematics:InverseKinematicsAgent",
        Knowledge("inverse kinematics"),
    ),
    **_trained("ppo", "PPO of stable-baselines3", 10),
    **_trained("sac", "SAC of stable-baselines3", 5),
    **_trained("tqc-her", "TQC of sb3-contrib with hindsight, sparse rewards", 5),
    **_trained(
        "ppo-residual",
        "PPO on top of mmc: it corrects its actions",
        5,
        base_agent="mmc",
        command="python -m studies.learners.train_all --names ppo-residual",
    ),
    **_trained("ppo-smooth", "PPO that is also rewarded for smoothness", 3),
    **_trained("ppo-torque", "PPO whose actions are torques", 3, control="joint_torque"),
    **_trained(
        "ppo-drawn",
        "PPO under perturbations of all groups, drawn for each episode",
        3,
        is_ranked=False,
    ),
    **_trained(
        "ppo-context",
        "as ppo-drawn, but it is shown what was drawn",
        3,
        context=True,
        is_ranked=False,
    ),
    **_trained(
        "ppo-memory",
        "it remembers 1.4 s; taught by PPO that is shown which perturbation was drawn for the "
        "episode",
        3,
        memory=68,
        command="python -m studies.learners.ppo_memory",
    ),
    **_trained(
        "ppo-memory-kinds",
        "as ppo-memory, taught under motors and senses that fail, too",
        3,
        memory=68,
        command="python -m studies.learners.ppo_memory --name ppo-memory-kinds "
        "--teacher runs/ppo-context-0/ppo-context-0.json",
    ),
    "random": AgentEntry(
        "uniformly random actions, the same at every run",
        "base:RandomAgent",
        Knowledge("baseline", "not given", "not given", "nothing"),
        draws_actions=True,
    ),
    "mmc-bell": AgentEntry(
        "classical MMC network on a minimum-jerk time base, for a bell-shaped speed",
        "mmc:bell_mmc",
        Knowledge("network"),
    ),
    "minimum-jerk": AgentEntry(
        "minimum-jerk path of the hand, followed by damped least squares",
        "planners:MinimumJerkAgent",
        Knowledge("planner"),
    ),
    "optimal-control": AgentEntry(
        "optimal feedback control (LQG with noise that grows with the command) of the given arm",
        "optimal_control:OptimalControlAgent",
        Knowledge(
            "optimal control",
            senses="posture, speeds, seen hand and target in every step, filtered",
        ),
        control="joint_velocity",
    ),
}
