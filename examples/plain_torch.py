"""
How do I train without a reinforcement-learning library?
========================================================

With PPO in a page of plain PyTorch, on 1,024 arms that write their observations into one array
(``copy=False``). A single page is easy to change. PyTorch takes most of the time, not the arms.
"""

import time

import gymnasium as gym
import torch
from torch.nn import Linear, ReLU, Sequential, init, utils

import mmc_gym  # noqa: F401  (registers the environments)

torch.manual_seed(0)
torch.set_num_threads(1)  # for networks so small, threads wait for each other
ARMS, STEPS, EPOCHS, PARTS, GAMMA, LAMBDA, CLIP = 1024, 16, 3, 8, 0.9, 0.95, 0.2
kind = dict(engine="analytic", autoreset_mode="SameStep", copy=False)
arms, tests = (gym.make_vec("MMCReach-v0", count, **kind) for count in (ARMS, 300))
size, joints = arms.single_observation_space.shape[0], arms.single_action_space.shape[0]


def network(outputs, gain):
    layers = Linear(size, 64), ReLU(), Linear(64, 64), ReLU(), Linear(64, outputs)
    for layer, last in zip(layers[::2], (2**0.5, 2**0.5, gain)):
        init.orthogonal_(layer.weight, last)
        init.zeros_(layer.bias)
    return Sequential(*layers)


policy, value = network(joints, 0.01), network(1, 1.0)
log_std = torch.nn.Parameter(torch.zeros(joints))
weights = [*policy.parameters(), *value.parameters(), log_std]
optimizer = torch.optim.Adam(weights, lr=1e-3, fused=True)
seen, actions = torch.empty(STEPS + 1, ARMS, size), torch.empty(STEPS, ARMS, joints)
rewards, is_over, advantages = torch.empty(3, STEPS, ARMS)


def log_probability(mean, action):
    return (-0.5 * ((action - mean) / log_std.exp()) ** 2 - log_std).sum(-1)


# %%
# A rollout fills the arrays; then advantages are summed from its end (GAE). Where an episode is
# truncated, its last state has the value of the state before.


@torch.no_grad()
def roll_out():
    for k in range(STEPS):
        mean = policy(seen[k])
        actions[k] = mean + log_std.exp() * torch.randn_like(mean)
        now, reward, _, over, _ = arms.step(actions[k].clamp(-1, 1).numpy())
        seen[k + 1], rewards[k], is_over[k] = map(torch.from_numpy, (now, reward, over))
    values, later = value(seen).squeeze(-1), torch.zeros(ARMS)
    for k in reversed(range(STEPS)):
        following = torch.where(is_over[k] > 0, values[k], values[k + 1])
        later = GAMMA * LAMBDA * (1 - is_over[k]) * later
        later = advantages[k] = rewards[k] + GAMMA * following - values[k] + later
    columns = seen[:-1], actions, log_probability(policy(seen[:-1]), actions), advantages
    returns = (advantages + values[:-1]).flatten()
    seen[0] = seen[-1]
    return *(column.reshape(STEPS * ARMS, *column.shape[2:]) for column in columns), returns


def learn(states, actions, old, advantages, returns):
    for part in (part for _ in range(EPOCHS) for part in torch.randperm(len(old)).chunk(PARTS)):
        ratio = (log_probability(policy(states[part]), actions[part]) - old[part]).exp()
        gain = (advantages[part] - advantages[part].mean()) / advantages[part].std()
        gain = torch.minimum(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
        error = ((value(states[part]).squeeze(-1) - returns[part]) ** 2).mean()
        optimizer.zero_grad()
        (0.5 * error - gain - 0.003 * log_std.sum()).backward()
        utils.clip_grad_norm_(weights, 0.5)
        optimizer.step()


@torch.no_grad()
def success():
    now, infos = tests.reset(seed=1)
    for _ in range(100):
        now, _, _, _, infos = tests.step(policy(torch.from_numpy(now)).clamp(-1, 1).numpy())
    return infos["final_info"]["is_success"].mean()


# %%
# Learn until 95 % of other arms end at their targets, tested without exploration.

seen[0] = torch.from_numpy(arms.reset(seed=0)[0])
begin, curve = time.perf_counter(), [(0, success())]
while curve[-1][1] < 0.95 and len(curve) < 25:
    for _ in range(3):
        learn(*roll_out())
    curve.append((curve[-1][0] + 3 * STEPS * ARMS, success()))
steps, reached = curve[-1]
seconds = time.perf_counter() - begin
print(f"{reached:.1%} of the targets after {steps:,} steps and {seconds:.0f} s")
