"""
Can a small neural network keep the segments at their length?
=============================================================

Yes: a multilayer perceptron learns to map any vector onto the unit circle without turning it. Then
the whole body model is a neural network. How well it reaches depends on the remaining angle error,
so the normalizer must be accurate.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from mmc_gym.network import LearnedNormalizer, MMCNetwork
from studies.network.fitting import PAPER, angle_errors, train_normalizers

# %%
# One normalizer has sixteen hidden units and a few epochs of the paper's recipe. The one that ships
# has two layers of sixteen units and a more careful training. `studies`, which trains them, comes
# with a clone of the project.

(trained,) = train_normalizers((16,), replace(PAPER, epochs=40), seed=1)
normalizers = {"16 units, 40 epochs": trained.normalizer, "shipped": LearnedNormalizer.shipped()}

# %%
# Arrows lead from a vector to the perceptron's output. They should end on the circle, and point
# away from the centre or towards it.

side = np.linspace(-1.5, 1.5, 13)
vectors = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
circle = np.exp(1j * np.linspace(0, 2 * np.pi, 200))
figure, panels = plt.subplots(1, 2, figsize=(9, 4.4), sharey=True, layout="constrained")
for axes, (name, normalizer) in zip(panels, normalizers.items()):
    moved = normalizer(vectors) - vectors
    axes.quiver(*vectors.T, *moved.T, angles="xy", scale_units="xy", scale=1, width=0.004)
    axes.plot(circle.real, circle.imag, color="tab:orange", linewidth=2, zorder=0)
    axes.set(title=name, xlabel="x [segment lengths]", aspect="equal")
panels[0].set_ylabel("y [segment lengths]")
plt.show()

# %%
# With the accurate normalizer the hand ends where it ends with exact normalization.

for name, normalizer in normalizers.items():
    network = MMCNetwork(damping=4, normalizer=normalizer)
    start = network.state_from_joint_angles([0.3, 0.6, 0.6])
    hand = network.run(start, network.inverse([-1.0, 1.5]), iterations=100).end_effector
    error = np.degrees(angle_errors(normalizer, [0.9, 1.0, 1.1])).mean()
    distance = np.linalg.norm(hand - [-1.0, 1.5])
    print(f"{name}: mean angle error {error:.4f}°, hand {distance:.4f} from its target")
