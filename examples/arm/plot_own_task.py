"""
How do I add my own task?
=========================

Write a class that draws a trial: a starting posture, and a path of targets. Register it under a
name, which then works in every command, environment and benchmark. Here the target moves in a
circle.
"""

from dataclasses import dataclass

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np

import mmc_gym
from mmc_gym.envs import register_task
from mmc_gym.envs.tasks import Task, Trial

# %%
# The path has a place for each control step. It repeats, because the task is `periodic`. All
# randomness comes from `request.random`, so that the same seed gives the same trial.


@dataclass(frozen=True)
class Circle(Task):
    """The target moves in a circle that does not surround the base."""

    seconds: float = 2.0
    radius: float = 0.6
    periodic = True
    episode_steps = 200

    def draw(self, request):
        count = round(self.seconds / request.workspace.body.control_step)
        first = request.random.uniform(0, 2 * np.pi)
        angles = first + np.linspace(0, 2 * np.pi, count, endpoint=False)
        targets = [(1.5 + self.radius * np.cos(a), self.radius * np.sin(a)) for a in angles]
        return Trial(request.draw_posture(), targets)


register_task("circle", Circle(), "the target moves in a circle")

# %%
# The id contains the name. Agents need not know the task.

figure, axes = plt.subplots(figsize=(5, 4.4), layout="constrained")
for name, line in {"mmc": "-", "ppo": "--"}.items():
    env = gym.make("MMCReachCircle-v0")
    (episode,) = mmc_gym.run_episodes(mmc_gym.make_agent(name, env), env, seeds=[3])
    behind = np.median(episode.distances[100:])
    print(f"{name}: {behind:.2f} segment lengths behind the target, in the median")
    axes.plot(*episode.hands.T, line, label=f"hand of {name}")
axes.plot(*episode.targets.T, ":", color="black", label="target")
axes.set(xlabel="x [segment lengths]", ylabel="y [segment lengths]", aspect="equal")
axes.legend()
plt.show()
