"""Controllers for the reaching environments, all behind stable-baselines3's `predict`.

`make_agent(name, env)` makes any of `AGENTS`.  A new agent is one new entry there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

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
from mmc_gym.agents.ik.geometric import cyclic_coordinate_descent, fabrik
from mmc_gym.agents.ik.jacobian import (
    damped_least_squares,
    jacobian_transpose,
    null_space,
    pseudo_inverse,
)
from mmc_gym.agents.mmc import MMCAgent, TimedMMCAgent, dynamic_mmc
from mmc_gym.agents.planners import MinimumJerkAgent, PassiveMotionAgent
from mmc_gym.interface import ReachInterface
from mmc_gym.network import EuclideanNormalizer, LearnedNormalizer, MMCNetwork, Normalizer
from mmc_gym.network.chain import Floats

__all__ = [
    "AGENTS",
    "Agent",
    "AgentEntry",
    "agent_names",
    "find_agent",
    "is_policy_path",
    "make_agent",
]


@dataclass(frozen=True)
class AgentEntry:
    """A name's agent: what it is in a line, and how it is made for an environment.

    Attributes:
        description: what it is, in a line.
        make: makes it for an environment; of trained agents, the one of training seed 0.
        training_seeds: how many trainings of it ship with the package; 0: it is not trained.
    """

    description: str
    make: Callable[[gym.Env[Any, Any]], Agent[Any]]
    training_seeds: int = 0


def make_agent(name: str, env: gym.Env[Any, Any]) -> Agent[Any]:
    """Make an agent for an environment, wrapped or not.

    Args:
        name: a key of `AGENTS`; for trained agents also "NAME-SEED", such as "ppo-3", where NAME
            alone is the training of seed 0.  Or the path of a policy of one's own, of either of its
            two files, such as "runs/ppo-1/ppo-1.safetensors".
        env: a reaching environment; the agent is told its segment lengths and control mode.

    Raises:
        ValueError: for an unknown name, a file that holds no policy, or an environment that the
            agent cannot act in.
        FileNotFoundError: if a file of the policy is missing.

    >>> import gymnasium as gym, mmc_gym
    >>> env = gym.make("MMCReach-v0")
    >>> agent, state = make_agent("mmc", env), None
    >>> observation, info = env.reset(seed=0)
    >>> for _ in range(100):
    ...     action, state = agent.predict(observation, state)
    ...     observation, reward, terminated, truncated, info = env.step(action)
    >>> info["is_success"]
    True
    """
    make = find_agent(name)
    if make is None:
        raise ValueError(f"agent must be one of {agent_names()}, got {name!r}")
    return make(env)


def find_agent(name: str) -> Callable[[gym.Env[Any, Any]], Agent[Any]] | None:
    """What makes the agent of a name that `make_agent` accepts; None for any other name."""
    if not isinstance(name, str):
        return None
    if is_policy_path(name):
        return partial(_policy_of_file, name)
    if name in AGENTS:
        return AGENTS[name].make
    kind, _, seed = name.rpartition("-")
    is_shipped = kind in AGENTS and seed in map(str, range(AGENTS[kind].training_seeds))
    return partial(_policy, kind, int(seed)) if is_shipped else None


def is_policy_path(name: str) -> bool:
    """Whether a name is the path of a policy's file."""
    return name.endswith((".json", ".safetensors"))


def agent_names() -> str:
    """The names that `make_agent` accepts, for a message."""
    return ", ".join(
        f"{name} (or {name}-0 to {name}-{entry.training_seeds - 1})"
        if entry.training_seeds > 1
        else name
        for name, entry in AGENTS.items()
    )


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


def _policy(name: str, seed: int, env: gym.Env[Any, Any]) -> Agent[Any]:
    from mmc_gym.agents.policy import PolicyAgent

    return PolicyAgent.shipped(name, seed, ReachInterface.of(env))


def _policy_of_file(path: str, env: gym.Env[Any, Any]) -> Agent[Any]:
    from mmc_gym.agents.policy import PolicyAgent, load_policy

    return PolicyAgent(*load_policy(path), ReachInterface.of(env))


def _trained(name: str, description: str, training_seeds: int) -> AgentEntry:
    made_by = f"{description}, trained by `mmc-gym train {name}`"
    return AgentEntry(made_by, partial(_policy, name, 0), training_seeds)


def _closed_loop(name: str) -> Callable[[gym.Env[Any, Any]], Agent[Any]]:
    return lambda env: closed_loop_mmc(ReachInterface.of(env), LOOPS[name], told_lockable(env))


AGENTS: dict[str, AgentEntry] = {
    "mmc": AgentEntry(
        "dynamic MMC network, best setting",
        lambda env: _dynamic_mmc(env, EuclideanNormalizer()),
    ),
    "mmc-classical": AgentEntry(
        "classical MMC network with the paper's constants, one iteration per control step",
        _classical_mmc,
    ),
    "mmc-neural": AgentEntry(
        "as mmc, with the learned normalizer",
        lambda env: _dynamic_mmc(env, LearnedNormalizer.shipped()),
    ),
    "mmc-tuned": AgentEntry(
        "as mmc, with constants tuned as those of the trained policies were", _tuned_mmc
    ),
    "ik-dls": AgentEntry(
        "inverse kinematics by damped least squares",
        _inverse_kinematics(damped_least_squares, iterations_per_step=3),
    ),
    "ppo": _trained("ppo", "PPO of stable-baselines3", 10),
    "sac": _trained("sac", "SAC of stable-baselines3", 5),
    "tqc-her": _trained("tqc-her", "TQC of sb3-contrib with hindsight, sparse rewards", 5),
    "ppo-residual": _trained("ppo-residual", "PPO on top of mmc: it corrects its actions", 5),
    "ppo-smooth": _trained("ppo-smooth", "PPO that is also rewarded for smoothness", 3),
    "ppo-position": _trained("ppo-position", "PPO whose actions are joint angles", 3),
    "ppo-torque": _trained("ppo-torque", "PPO whose actions are torques", 3),
    "random": AgentEntry(
        "uniformly random actions, the same at every run",
        lambda env: RandomAgent(len(ReachInterface.of(env).segment_lengths)),
    ),
    "ik-transpose": AgentEntry(
        "inverse kinematics by the Jacobian transpose",
        _inverse_kinematics(jacobian_transpose, iterations_per_step=5),
    ),
    "ik-pinv": AgentEntry(
        "inverse kinematics by the truncated pseudo-inverse",
        _inverse_kinematics(pseudo_inverse, iterations_per_step=3),
    ),
    "ik-nullspace": AgentEntry(
        "as ik-dls, with a comfortable posture in the null space",
        _limited_inverse_kinematics(null_space, iterations_per_step=3),
    ),
    "ik-ccd": AgentEntry(
        "inverse kinematics by cyclic coordinate descent",
        _limited_inverse_kinematics(cyclic_coordinate_descent, iterations_per_step=3),
    ),
    "ik-fabrik": AgentEntry(
        "inverse kinematics by FABRIK, forward and backward reaching",
        _inverse_kinematics(fabrik, iterations_per_step=3),
    ),
    "ik-closed-form": AgentEntry(
        "inverse kinematics in closed form, the solution nearest to the posture; N up to 3",
        _limited_inverse_kinematics(closed_form, iterations_per_step=1),
    ),
    "mmc-bell": AgentEntry(
        "classical MMC network on a minimum-jerk time base, for a bell-shaped speed",
        _timed_mmc,
    ),
    "minimum-jerk": AgentEntry(
        "minimum-jerk path of the hand, followed by damped least squares",
        lambda env: MinimumJerkAgent(ReachInterface.of(env)),
    ),
    "pmp": AgentEntry(
        "Passive Motion Paradigm with a terminal attractor",
        lambda env: PassiveMotionAgent(ReachInterface.of(env)),
    ),
    "mmc-feedback": AgentEntry(
        "as mmc, with the sensed posture in the mean, and the seen hand correcting the clamp",
        _closed_loop("feedback"),
    ),
    "mmc-delay": AgentEntry(
        "as mmc-feedback, with the delay of the senses estimated and bridged",
        _closed_loop("delay"),
    ),
    "mmc-lengths": AgentEntry(
        "as mmc, with segment lengths identified on line",
        _closed_loop("lengths"),
    ),
    "mmc-lock": AgentEntry(
        "as mmc, with locked joints detected and clamped",
        _closed_loop("lock"),
    ),
    "mmc-closed": AgentEntry(
        "as mmc, with all loops closed: feedback, delay, lengths and locks",
        _closed_loop("closed"),
    ),
    "ik-dls-feedback": AgentEntry(
        "as ik-dls, with the feedback of mmc-feedback",
        lambda env: closed_loop_inverse_kinematics(
            ReachInterface.of(env), damped_least_squares, LOOPS["feedback"]
        ),
    ),
}
