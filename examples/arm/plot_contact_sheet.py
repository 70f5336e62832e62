"""
Which tasks and perturbations are there?
========================================

One picture of each, a moment after the start. The thin arm is the network's internal model, which
is ahead of the body; the cross is the target. A task says where the target is, a perturbation what
goes wrong.
"""

from math import ceil

import matplotlib.pyplot as plt

import mmc_gym

# %%
# Most are drawn after eleven steps; some need other numbers of steps, or a certain start.

COLUMNS, STEPS, BENT = 6, 11, {"joint_angles": [0.2, 0.4, 0.4]}
OTHER_STEPS = {"centre-out": 6, "force-field": 7, "pursuit": 60, "via-points": 30}
OPTIONS = {
    "random": {"joint_angles": [0.2, 0.4, 0.4], "target": (-1.5, 1.8)},
    "centre-out": {"trial": 3},
    "distances": {"trial": 26},
    "paper": {"trial": 130},
}


def picture(name):
    """Return a picture (height, width, 3) of an arm that the MMC network moves."""
    env = mmc_gym.make(name, render_mode="rgb_array")
    agent, state = mmc_gym.make_agent("mmc", env), None
    observation, _ = env.reset(seed=6, options=OPTIONS.get(name, BENT))
    for _ in range(OTHER_STEPS.get(name, STEPS)):
        action, state = agent.predict(observation, state)
        observation, *_ = env.step(action)
        env.get_wrapper_attr("show_posture")(state.joint_angles)
    drawn = env.render()
    env.close()
    return drawn


# %%
# ``mmc-gym show NAME`` describes one of them; ``mmc-gym list tasks`` lists the available tasks.

tasks, perturbations = mmc_gym.list_tasks(), mmc_gym.list_perturbations()
names = [*tasks, *perturbations]
rows = ceil(len(names) / COLUMNS)
figure, axes = plt.subplots(rows, COLUMNS, figsize=(1.6 * COLUMNS, 1.8 * rows), dpi=125)
for axis in axes.flat:
    axis.axis("off")
for axis, name in zip(axes.flat, names):
    axis.imshow(picture(name)[28:-28, 28:-28])
    axis.set_title(name, fontsize=8)
figure.tight_layout(pad=0.3)
print(f"{len(tasks)} tasks, {len(perturbations)} perturbations")
plt.show()
