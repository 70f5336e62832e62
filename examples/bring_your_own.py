"""
How do I use my own things on the command line?
===============================================

Put your agents, environment, reward, task, perturbation and measure into a module. In every command
``--import`` imports the module, and ``module:name`` names an object in it.

.. code-block:: sh

    mmc-gym compare --agents mmc examples.bring_your_own:still \
        --scenarios examples.bring_your_own:Squared
    mmc-gym benchmark --import examples.bring_your_own --agents mmc --scenarios ahead weak-30
"""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np

import mmc_gym
from mmc_gym.envs import register_task
from mmc_gym.envs.tasks import RandomTarget, Trial
from mmc_gym.measures import measure


def still(observation):
    """An agent: a function of observations."""
    return np.zeros(3)


class Turner:
    """An agent: a class, called with the environment."""

    def __init__(self, env):
        self.action = np.full(env.action_space.shape, 0.2, np.float32)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.action, state


class Squared(gym.Wrapper):
    """An environment with another reward."""

    def __init__(self, **arguments):
        super().__init__(gym.make("MMCReach-v0", **arguments))

    def step(self, action):
        observation, _, terminated, truncated, info = self.env.step(action)
        return observation, -(info["distance"] ** 2), terminated, truncated, info


@dataclass(frozen=True)
class Ahead(RandomTarget):
    """A task: from any posture to a target straight ahead."""

    def draw(self, request):
        return Trial(request.draw_posture(), [(0.0, request.random.uniform(1.0, 2.9))])


SERVOS = "servos give {} % of their torque"


@mmc_gym.perturbation("weak", unit="%", default=50, neutral=100, low=1, description=SERVOS)
def weak(arms, percent):
    """A perturbation: servos give a part of their torque."""
    arms.torque_limit *= percent / 100


@measure(label="half-way time", unit="s", best="low", shown=True, successes_only=True)
def half_way_time(episode):
    return int((episode.distances <= episode.distances[0] / 2).argmax()) * episode.control_step


register_task("ahead", Ahead(), "targets straight ahead")

if __name__ == "__main__":
    print(mmc_gym.compare({"mmc": "mmc", "still": still, "turner": Turner}, Squared, episodes=10))
    arguments = {"task": "ahead", "perturbations": ["weak-30"]}
    print(mmc_gym.compare(["mmc", "ppo"], episodes=10, env_kwargs=arguments).headline)
