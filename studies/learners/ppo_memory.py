"""Train a policy with a memory, `ppo-memory`, to act like one that is shown what was drawn.

A policy that has to identify noise, delays and its body from a memory learns slowly from rewards.
One that is shown what was drawn, such as `ppo-context`, learns fast, and can say in any state what
it would do.  So its student acts, and learns from its memory to do what this teacher would if its
senses were in order.  Where actions are late, it learns what its teacher would do when they arrive.
It minimizes weighted squared errors on the states that the student itself visits (dataset
aggregation with the latest episodes only).

    mmc-gym train studies/learners/ppo-teacher.yml    # 2 minutes
    python -m studies.learners.ppo_memory             # 2.5

`ppo-memory-kinds` is the student of one that was shown perturbations of all six groups:

    mmc-gym train ppo-context
    python -m studies.learners.ppo_memory --name ppo-memory-kinds \
        --teacher runs/ppo-context-0/ppo-context-0.json

Sources: Kumar, Fu, Pathak & Malik (2021), RMA: Rapid motor adaptation for legged robots, RSS,
https://arxiv.org/abs/2107.04034 (a teacher that is shown what was drawn, a student with a memory).
Ross, Gordon & Bagnell (2011), A reduction of imitation learning and structured prediction to
no-regret online learning, AISTATS, https://arxiv.org/abs/1011.0686.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import create_mlp

from mmc_gym.agents.policy import (
    EVALUATION_EPISODES,
    FINAL_EPISODES,
    PolicyCard,
    load_policy,
    save_policy,
)
from mmc_gym.agents.policy_network import History, PolicyNetwork
from mmc_gym.envs.names import parse_change
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.interface import ReachInterface, relative_speeds
from mmc_gym.training.policies import export_network
from mmc_gym.training.training import evaluate_policy

Float32 = NDArray[np.float32]

TEACHER = Path("runs/ppo-teacher-0/ppo-teacher-0.json")
TASKS = {"MMCReach-v0": 800, "MMCReachPursuit-v0": 192, "MMCReachDoubleStep200-v0": 32}
"""Arms of each task: some targets move or jump, so that the student has met both."""
HIDDEN = {"action-delay", *(name for name in FAMILIES if FAMILIES[name].group == "senses")}
"""The teacher acts as if there were none of these."""
OFTEN = {"delay": 4.0, "action-delay": 4.0, "vision-noise": 3.0}
"""How much more often families are drawn than the teacher's options say; the others are not."""
BLOCKS = (1, 1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 4, 4, 4, 10, 10, 20)  # steps in each of the memory
STEPS, BATCH, EPOCHS, LEARNING_RATE, LAYERS, EVALUATIONS = 100, 1024, 2, 1e-3, (256, 128), 12
AHEAD, JUMP = 2, 0.3
"""The teacher, which was trained with targets at rest and follows others too late, is shown where
the target is so many steps later, unless it jumps so far."""
NOISE = 0.05  # standard deviation of a student's noise: it visits slightly more than its states
CALM = 0.002
"""Errors are divided by this plus the mean square of actions: they count most near rest."""


def actions_of(teacher: PolicyNetwork, shown: Float32) -> Float32:
    """Return the mean actions of a network for many rows, (..., features)."""
    weights, depth = teacher.tensors, sum(name.startswith("hidden.") for name in teacher.tensors)
    for name in (f"hidden.{layer}" for layer in range(depth // 2)):
        shown = np.maximum(shown @ weights[f"{name}.weight"].T + weights[f"{name}.bias"], 0.0)
    return np.clip(shown @ weights["mean.weight"].T + weights["mean.bias"], -1.0, 1.0)


def episodes_of(
    env: Any, history: History, student: Callable[[Float32], Float32]
) -> tuple[Float32, Float32]:
    """Let the student act for an episode; return what it sees, and true observations.

    These are followed by the context, and have targets of `AHEAD` steps later.  Where actions are
    late, they are those at the time when the action arrives.
    """
    size, setup = history.layout.size, env.setup
    observation, info = env.reset()
    memory = history.start(observation[:, :size])
    seen, true = [], []
    for _ in range(STEPS):
        now = history.observed(observation[:, :size], memory)
        seen.append(np.concatenate((observation[:, :size], history.recall(now, memory)), -1))
        speeds = relative_speeds(env.arms.joint_velocities, setup.given_body.speed_limit)
        hand = info.get("cursor", info["end_effector"])
        true.append((env.arms.joint_angles.copy(), speeds, hand, info["target"]))
        action = student(seen[-1])
        memory = history.extended(now, action, memory)
        observation, _, _, _, info = env.step(action)
    angles, speeds, hands, now = (np.array(column) for column in zip(*true, strict=True))
    later = np.concatenate((now[AHEAD:], now[-1:].repeat(AHEAD, axis=0)))
    target = np.where(np.abs(later - now).max(axis=-1, keepdims=True) < JUMP, later, now)
    shown = setup.layout.encode(angles, speeds, hand=hands, target=target)
    context = np.broadcast_to(observation[:, size:], (STEPS, *observation[:, size:].shape))
    shown = np.concatenate((shown, context), axis=-1, dtype=np.float32)
    late = np.nan_to_num(info["context"].get("action-delay", np.zeros(len(observation)))) / 1000
    arrival = np.arange(STEPS)[:, None] + np.rint(late / setup.control_step).astype(int)
    return np.array(seen), shown[np.minimum(arrival, STEPS - 1), np.arange(len(observation))]


def teach(
    teacher: PolicyNetwork,
    card: PolicyCard,
    rounds: int,
    report: Callable[[PolicyNetwork, int], None],
) -> PolicyNetwork:
    """Return a student of a teacher with this card, after rounds of an episode of all arms."""
    torch.manual_seed(card.seed)
    options = card.context[0]["one_of"]
    changes = [option and parse_change(option) for option in options]
    families = [change.family.name if change and change.family else "" for change in changes]
    weights = card.context[0].get("weights") or [1.0] * len(options)
    weights = [OFTEN.get(family, 1.0) * w for family, w in zip(families, weights, strict=True)]
    mixture = {"one_of": options, "weights": weights}
    # The context has these columns twice: for options, then for their strengths.
    is_shown = np.tile([family not in HIDDEN for family in families if family], 2)
    arguments: Any = {"engine": "analytic", "perturbations": [mixture], "observe_context": True}
    envs = [gym.make_vec(name, count, **arguments).unwrapped for name, count in TASKS.items()]
    for env in envs:
        env.reset(seed=card.seed)
    layout = ReachInterface.of(envs[0]).layout
    history = History(layout, BLOCKS)
    student = torch.nn.Sequential(
        *create_mlp(layout.size + history.size, card.segment_count, [*LAYERS], torch.nn.ReLU)
    )
    log_std = torch.full((card.segment_count,), math.log(NOISE))
    optimizer = torch.optim.Adam(student.parameters())

    def act(seen: Float32) -> Float32:
        with torch.no_grad():
            actions = student(torch.from_numpy(seen))
            noisy: Float32 = (actions + NOISE * torch.randn_like(actions)).clamp(-1, 1).numpy()
        return noisy

    for number in range(rounds):
        optimizer.param_groups[0]["lr"] = LEARNING_RATE * (1 - number / rounds)
        seen, true = zip(*(episodes_of(env, history, act) for env in envs), strict=True)
        shown = np.concatenate(true, axis=1).reshape(-1, true[0].shape[-1])
        shown[:, layout.size :] *= is_shown
        teacher_actions = torch.from_numpy(actions_of(teacher, shown))
        inputs = torch.from_numpy(np.concatenate(seen, axis=1).reshape(len(shown), -1))
        for _ in range(EPOCHS):
            for batch in torch.split(torch.randperm(len(shown)), BATCH):
                targets, actions = teacher_actions[batch], student(inputs[batch])
                # Actions are clipped to ±1, so one beyond a target at a bound is not wrong.
                beyond = (targets * actions >= 1.0) & (targets.abs() >= 1.0)
                errors = torch.where(beyond, 0.0, actions - targets).square()
                loss = (errors / (CALM + targets.square().mean(dim=-1, keepdim=True))).mean()
                optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                optimizer.step()
        *hidden, mean = student
        network = export_network(hidden, mean, log_std, "gaussian")
        report(network, number + 1)
    return network


def main(
    teacher: Path = TEACHER,
    rounds: int = 66,
    name: str = "ppo-memory",
    out: Path = Path("runs/ppo-memory"),
) -> None:
    """Train a policy with a memory.

    Args:
        teacher: Card of the teacher, whose seed is that of the student.
        rounds: Episodes of all arms.
        name: Of the policy; a group that the teacher was trained without is added.
        out: Folder for the policy.
    """
    torch.set_num_threads(1)
    policy, of_teacher = load_policy(teacher)
    options = of_teacher.context[0]["one_of"]
    of_student = {"observe_context": False, "perturbations": [{"one_of": options}]}  # equal chances
    env_kwargs = {**of_teacher.hyperparameters["env_kwargs"], **of_student}
    settings = {"teacher": of_teacher.file_stem, "arms": TASKS, "often": OFTEN, "rounds": rounds}
    _, dash, group = of_teacher.name.partition("-without-")
    card = replace(
        of_teacher,
        name=f"{name}{dash}{group}",
        hyperparameters={"env_kwargs": env_kwargs, **settings},
        blocks=BLOCKS,
        context=[],
        learning_curve=[],
    )
    clocks = {"seconds": time.perf_counter, "cpu_seconds": time.process_time}
    begin = {name: now() - getattr(of_teacher, f"training_{name}") for name, now in clocks.items()}

    def report(network: PolicyNetwork, done: int) -> None:
        nonlocal card
        if done % max(rounds // EVALUATIONS, 1) and done < rounds:
            return
        scores = evaluate_policy(network, card, EVALUATION_EPISODES)
        passed = {name: round(now() - begin[name], 1) for name, now in clocks.items()}
        steps = of_teacher.training_steps + done * STEPS * sum(TASKS.values())
        card = replace(
            card,
            training_steps=steps,
            **{f"training_{name}": seconds for name, seconds in passed.items()},
            learning_curve=[*card.learning_curve, {"steps": steps, **passed, **scores}],
        )
        print(f"{steps:>12,} steps  success {scores['success']:6.1%}", flush=True)

    network = teach(policy, of_teacher, rounds, report)
    save_policy(network, replace(card, scores=evaluate_policy(network, card, FINAL_EPISODES)), out)


if __name__ == "__main__":
    tyro.cli(main)
