"""PPO with the constants of CleanRL's `ppo_continuous_action.py`.

CleanRL (Huang et al., JMLR 23, 2022) consists of single files that people copy.  This is the
algorithm that its documentation describes, written anew: the same wrappers, networks, constants and
order of random numbers.  The differences: one environment instead of a vector, which is reset in
the step that ends an episode; observations are not flattened; and nothing is logged or saved.

https://docs.cleanrl.dev/rl-algorithms/ppo/#ppo_continuous_actionpy
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count, pairwise
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from gymnasium import wrappers
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.distributions import Normal

ROLLOUT = 2048  # steps
MINIBATCHES = 32
EPOCHS = 10
LEARNING_RATE = 3e-4
ANNEALED_OVER = 1_000_000  # steps
GAMMA, LAMBDA = 0.99, 0.95
CLIP = 0.2  # largest change of the ratio, and of a value
VALUE_WEIGHT = 0.5  # the entropy's is 0
MAX_GRADIENT = 0.5
HIDDEN = 64
LARGEST = 10.0  # normalized observation or reward


class Rollout(NamedTuple):
    """The data of `ROLLOUT` steps: observations and actions (steps, …), all others (steps,)."""

    observations: Tensor
    actions: Tensor
    log_probabilities: Tensor
    values: Tensor
    advantages: Tensor
    returns: Tensor


def perceptron(inputs: int, outputs: int, last_gain: float) -> nn.Sequential:
    """Return a network with two hidden layers of tanh, orthogonal weights and no bias at first."""
    layers: list[nn.Module] = []
    gains = (2**0.5, 2**0.5, last_gain)
    for (width, following), gain in zip(pairwise((inputs, HIDDEN, HIDDEN, outputs)), gains):
        linear = nn.Linear(width, following)
        nn.init.orthogonal_(linear.weight, gain)
        nn.init.zeros_(linear.bias)
        layers += [linear, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


class CleanRLPPO:
    """PPO in one environment, with `learn` and `predict` as in stable-baselines3."""

    def __init__(self, env: gym.Env[Any, Any], seed: int) -> None:
        """Wrap `env`, whose observations and actions are `Box`es, and make the networks."""
        torch.manual_seed(seed)
        self._random = np.random.RandomState(seed)  # the generator of `numpy.random.seed`, unshared
        self._seed = seed
        self._space = env.action_space
        self._normalize = wrappers.NormalizeObservation(wrappers.ClipAction(env))
        clipped = wrappers.TransformObservation(self._normalize, _limit, None)
        scaled = wrappers.NormalizeReward(clipped, gamma=GAMMA)
        self._env = wrappers.TransformReward(scaled, _limit)
        inputs, outputs = (space.shape[0] for space in (env.observation_space, env.action_space))
        self._critic = perceptron(inputs, 1, 1.0)
        self._actor = perceptron(inputs, outputs, 0.01)
        self._log_std = nn.Parameter(torch.zeros(outputs))
        self._parameters = [*self._critic.parameters(), *self._actor.parameters(), self._log_std]
        self._optimizer = torch.optim.Adam(self._parameters, lr=LEARNING_RATE, eps=1e-5)
        self.num_timesteps = 0

    def learn(self, total_timesteps: int, callback: Callable[[Any, Any], bool]) -> None:
        """Learn for `total_timesteps`, or until `callback`, called in each step, returns False.

        The learning rate falls to 0 over `ANNEALED_OVER` steps, or over `total_timesteps` if that
        is more.
        """
        updates = max(total_timesteps, ANNEALED_OVER) // ROLLOUT
        observation, _ = self._env.reset(seed=self._seed)
        for update in count():
            self._optimizer.param_groups[0]["lr"] = LEARNING_RATE * max(0.0, 1 - update / updates)
            steps, observation = [], torch.as_tensor(observation)
            for _ in range(ROLLOUT):
                with torch.no_grad():
                    policy, value = self._policy(observation), self._critic(observation)
                    action = policy.sample()
                    log_probability = policy.log_prob(action).sum()
                following, reward, terminated, truncated, _ = self._env.step(action.numpy())
                is_over = terminated or truncated
                steps.append((observation, action, log_probability, value[0], reward, is_over))
                if is_over:
                    following, _ = self._env.reset()
                observation = torch.as_tensor(following)
                self.num_timesteps += 1
                if not callback(None, None) or self.num_timesteps == total_timesteps:
                    return
            self._update(self._rollout(steps, observation))

    def predict(
        self, observation: NDArray[Any], *_: Any, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], None]:
        """Return the mean actions, (…, actions), and no state.

        Observations are normalized by the statistics of the training.
        """
        assert deterministic
        seen = self._normalize.obs_rms
        normal = (observation - seen.mean) / np.sqrt(seen.var + self._normalize.epsilon)
        with torch.no_grad():
            action = self._actor(torch.as_tensor(np.float32(_limit(normal)))).numpy()
        return np.clip(action, self._space.low, self._space.high), None

    def _policy(self, observations: Tensor) -> Normal:
        mean = self._actor(observations)
        return Normal(mean, self._log_std.exp().expand_as(mean))

    def _rollout(self, steps: list[tuple[Any, ...]], last: Tensor) -> Rollout:
        """Return the steps with generalized advantages; truncation counts as termination."""
        observations, actions, log_probabilities, values, rewards, are_over = zip(*steps)
        with torch.no_grad():
            known = [*(float(value) for value in values), self._critic(last).item()]
        advantages = np.zeros(len(steps))
        advantage = 0.0
        for step in reversed(range(len(steps))):
            discount = 0.0 if are_over[step] else GAMMA
            error = rewards[step] + discount * known[step + 1] - known[step]
            advantage = advantages[step] = error + discount * LAMBDA * advantage
        arrays = [torch.stack(one) for one in (observations, actions, log_probabilities, values)]
        gained = torch.as_tensor(advantages, dtype=torch.float32)
        return Rollout(*arrays, gained, gained + arrays[-1])

    def _update(self, rollout: Rollout) -> None:
        """Take `EPOCHS` times `MINIBATCHES` steps of Adam."""
        order = np.arange(ROLLOUT)
        for _ in range(EPOCHS):
            self._random.shuffle(order)
            for chosen in np.split(order, MINIBATCHES):
                loss = self._loss(Rollout(*(values[chosen] for values in rollout)))
                self._optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self._parameters, MAX_GRADIENT)
                self._optimizer.step()

    def _loss(self, batch: Rollout) -> Tensor:
        """Return the sum of the clipped losses of policy and values."""
        spread = batch.advantages.std() + 1e-8
        advantages = (batch.advantages - batch.advantages.mean()) / spread
        logs = self._policy(batch.observations).log_prob(batch.actions).sum(-1)
        ratios = (logs - batch.log_probabilities).exp()
        gains = torch.minimum(advantages * ratios, advantages * ratios.clamp(1 - CLIP, 1 + CLIP))
        values = self._critic(batch.observations).squeeze(-1)
        near = batch.values + (values - batch.values).clamp(-CLIP, CLIP)
        errors = torch.maximum((values - batch.returns) ** 2, (near - batch.returns) ** 2)
        return VALUE_WEIGHT * 0.5 * errors.mean() - gains.mean()


def _limit(values: Any) -> Any:
    return np.clip(values, -LARGEST, LARGEST)
