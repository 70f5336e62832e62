"""Draw a movement of the arm, without a display, into one picture."""

import gymnasium as gym
import matplotlib.image
import numpy as np

import mmc_gym

env = gym.make("MMCReach-v0", render_mode="rgb_array")
agent = mmc_gym.make_agent("mmc", env)
options = {"joint_angles": [0.2, 0.4, 0.4], "target": (-1.8, 1.8)}
observation, info = env.reset(seed=0, options=options)
state, frames = None, [env.render()]
for step in range(1, 41):
    action, state = agent.predict(observation, state)
    observation, reward, terminated, truncated, info = env.step(action)
    if step in (6, 12, 40):
        frames.append(env.render())
env.close()
matplotlib.image.imsave("movement.png", np.concatenate(frames, axis=1))
print(f"wrote movement.png; the hand is {info['distance']:.4f} from its target")
