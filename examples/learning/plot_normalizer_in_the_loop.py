"""
Does a normalizer learn better inside the network?
==================================================

Yes, by gradient descent: the gradient of the hand's error through the iterations shows which errors
of the normalizer matter. But imitating the exact one by a second-order method is better still.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import torch

from mmc_gym.network import MMCNetwork
from mmc_gym.network.differentiable import TorchNetwork
from studies.network.fitting import ACCURATE, train_normalizers

# %%
# Networks of eight hidden units learn to imitate the exact normalizer: in 60 epochs of Adam, in
# 240, and in 60 followed by the Levenberg-Marquardt method. `studies` comes with a clone.

short = replace(ACCURATE, samples=3600, epochs=60, refinement_iterations=0)
recipes = {"60 epochs": short, "240 epochs": replace(short, epochs=240)}
recipes["60 epochs, refined"] = replace(short, refinement_iterations=300)
learned = {name: train_normalizers((8,), recipe)[0].normalizer for name, recipe in recipes.items()}

# %%
# The first continues to learn inside the network: 60 iterations towards random targets, and
# gradients through the next 20. The loss is the distance of the hand, and errors of the lengths.

network = TorchNetwork(MMCNetwork(damping=4, normalizer=learned["60 epochs"]))
optimizer = torch.optim.Adam(network.parameters(), lr=0.03)
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 200)
for _ in range(200):
    starts, others = np.pi * (2 * torch.rand(2, 256, 3) - 1)
    target = network.state_from_joint_angles(others).end_effector
    with torch.no_grad():
        state = network(network.state_from_joint_angles(starts), network.inverse(target), 60)
    state = network(state, network.inverse(target), 20)
    loss = (state.end_effector - target).norm(dim=-1).mean()
    loss += (state.segments.norm(dim=-1) - 1).abs().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    schedule.step()
learned["60 epochs, then in the network"] = network.to_numpy().normalizer
plt.figure(figsize=(7, 3.6), layout="constrained")
starts, others = np.random.default_rng(0).uniform(-np.pi, np.pi, (2, 1000, 3))
for (name, normalizer), line in zip(learned.items(), (":", "-.", "--", "-")):
    plain = MMCNetwork(damping=4, normalizer=normalizer)
    target = plain.state_from_joint_angles(others).end_effector
    state = plain.run(plain.state_from_joint_angles(starts), plain.inverse(target), 100)
    distance = np.linalg.norm(state.end_effector - target, axis=-1)
    plt.semilogx(np.sort(distance), np.arange(1000) / 10, line, color="black", label=name)
    print(f"{name}: hands {np.median(distance):.3f} from their targets, median")
plt.axis((1e-5, 1, -2, 102))
plt.gca().set(xlabel="distance to the target [segment lengths]", ylabel="hands nearer [%]")
plt.legend(loc="upper left")
plt.show()
