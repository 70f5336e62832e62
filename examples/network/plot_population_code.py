"""
What do the hidden units of a learned normalizer encode?
========================================================

Directions. Though training does not require it, each unit is active for a range of directions
around a preferred one, and together they cover the circle: a population code, as in motor cortex.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from studies.network.fitting import PAPER, train_normalizers

# %%
# Train eight hidden units by the paper's recipe. `studies` comes with a clone of the project.

(trained,) = train_normalizers((8,), replace(PAPER, epochs=100), seed=1)

# %%
# Apply it to unit vectors in all directions, and record the activations of its hidden layer.

directions = np.linspace(-np.pi, np.pi, 361)
vectors = np.stack([np.cos(directions), np.sin(directions)], axis=-1)
hidden, _ = trained.normalizer.activations(vectors)

# %%
# A unit prefers the direction of the mean of all directions, each weighted by its activation.

preferred = np.angle(np.exp(1j * directions[:-1]) @ hidden[:-1])
order = np.argsort(preferred)
half = (hidden.max(axis=0) + hidden.min(axis=0)) / 2
width = 360 * (hidden > half)[:-1].mean(axis=0)
print("preferred directions [°]:", np.degrees(preferred[order]).round().astype(int).tolist())
print(f"tuning width: {width.min():.0f}° to {width.max():.0f}°")

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for number, unit in enumerate(order, start=1):
    line = axes.plot(np.degrees(directions), hidden[:, unit], "-" if number % 2 else "--")[0]
    style = dict(color=line.get_color(), ha="center", fontweight="bold")
    axes.text(np.degrees(preferred[unit]), hidden[:, unit].max() + 0.03, number, **style)
axes.set(xlabel="direction of the input [°]", ylabel="activation (tanh)", ylim=(-1.05, 1.2))
axes.set_xticks(range(-180, 181, 90))
plt.show()
