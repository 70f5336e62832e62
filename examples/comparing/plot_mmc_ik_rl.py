"""
How do MMC, inverse kinematics and reinforcement learning differ?
=================================================================

They differ in how they reach, not in whether. All three agents reach for the same targets from the
same postures. The network and damped least squares move nearly straight and rest; the learned
policy makes detours, and its hand keeps moving around the target.
"""

import matplotlib.pyplot as plt

import mmc_gym

comparison = mmc_gym.compare(["mmc", "ik-dls", "ppo"], episodes=40)
print(comparison.headline)

# %%
# ``print(comparison)`` shows the whole table. Here is a part of it, with intervals over episodes.
# The ideal hand has no arm, and follows a minimum-jerk movement.

measures = ["success", "time_to_target", "path_ratio", "velocity_peaks", "joint_work"]
low, middle, high = (comparison.to_frame(of)[measures].T for of in ("low", "estimate", "high"))
print(middle.round(2))

# %%
# Hand paths and speed profiles, in one figure.

comparison.plot(plt.figure(figsize=(9, 5), layout="constrained"))
plt.show()

# %%
# They differ in detours and work, not in success.

figure, panels = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
units = {"path_ratio": "path / direct line", "joint_work": "joint work [mass · length² / s²]"}
for axes, (measure, label) in zip(panels, units.items()):
    agents = comparison.agents
    estimate = middle.loc[measure, agents]
    errors = [estimate - low.loc[measure, agents], high.loc[measure, agents] - estimate]
    axes.errorbar(agents, estimate, errors, fmt="o", capsize=6, color="black")
    axes.set(xlabel="agent", ylabel=label, ylim=(0, None))
    axes.margins(x=0.2)
plt.show()
