"""
How do I look at a movement?
============================

Make the environment with ``render_mode="rgb_array"``: it draws itself into an array, without a
display. ``mmc-gym record`` makes a film of it, and ``mmc-gym play`` opens a window.
"""

import gymnasium as gym
import matplotlib.pyplot as plt

import mmc_gym

env = gym.make("MMCReach-v0", render_mode="rgb_array")
agent = mmc_gym.make_agent("mmc", env)

# %%
# Start and target are drawn from the seed, unless ``options`` give them.

options = {"joint_angles": [0.2, 0.4, 0.4], "target": (-1.8, 1.8)}
observation, info = env.reset(seed=0, options=options)
state, frames = None, {0: env.render()}
for step in range(1, 41):
    action, state = agent.predict(observation, state)
    observation, reward, terminated, truncated, info = env.step(action)
    if step in (6, 12, 40):
        frames[step] = env.render()
print(f"the hand is {info['distance']:.4f} segment lengths from its target")

# %%
# A step is 0.02 s.

figure, panels = plt.subplots(1, 4, figsize=(10, 2.8), layout="constrained")
for axes, (step, frame) in zip(panels, frames.items()):
    axes.imshow(frame)
    axes.set_title(f"{step * env.unwrapped.parameters.control_step:.2f} s")
    axes.axis("off")
env.close()
plt.show()
