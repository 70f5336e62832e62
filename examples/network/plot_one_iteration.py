"""
What does one iteration of the network do?
==========================================

It computes each vector from every triangle of which it is a side, and takes the mean. An arm of
three segments has six vectors: the segments L1, L2, L3, the diagonals D1, D2, and the end effector
R. Each is a side of two triangles, and each triangle computes it from the other two sides.
"""

import matplotlib.pyplot as plt
import numpy as np

from mmc_gym.network import MMCNetwork
from mmc_gym.network.chain import vector_pairs

network = MMCNetwork(damping=4)
rest = network.state_from_joint_angles([0.3, 0.6, 0.6])
target = network.inverse([-1.0, 1.5])
start = network.run(rest, target, iterations=0)  # R is at the target, nothing else has changed

# %%
# A vector from node i to node j by way of another node k is v_ik + v_kj. In an arm at rest all
# triangles agree. Now that R has moved, the triangles with R contradict the others.

names = dict(zip(vector_pairs(3), ("L1", "L2", "L3", "D1", "D2", "R")))
vector = dict(zip(names, start.vectors))
vector |= {(j, i): -value for (i, j), value in vector.items()}
opinions = {
    (i, j): [vector[i, k] + vector[k, j] for k in range(4) if k not in (i, j)] for i, j in names
}
for pair, name in names.items():
    said = " and ".join(str(value.round(2)) for value in opinions[pair])
    print(f"{name}: now {vector[pair].round(2)}, its triangles say {said}")

# %%
# In the mean the present value has the weight (d − 2)/d, and each of the two computations 1/d, with
# the damping d. Then the segments are brought back to their length; R, which is clamped, stays.

after, d = network.step(start, target), network.damping
layout = [["arm", "L1", "L2", "L3"], ["arm", "D1", "D2", "R"]]
widths = dict(width_ratios=(1.8, 1, 1, 1), layout="constrained")
figure, panels = plt.subplot_mosaic(layout, figsize=(11, 4.4), **widths)
for row, ((i, j), name) in enumerate(names.items()):
    tip = start.nodes[i] + vector[i, j]
    style = dict(arrowstyle="->", linewidth=2, linestyle="-" if name[0] == "L" else "--")
    panels["arm"].annotate("", tip, start.nodes[i], arrowprops=style)
    panels["arm"].text(*(start.nodes[i] + tip) / 2, name, color="tab:red", fontsize=14)
    mean = ((d - 2) * vector[i, j] + sum(opinions[i, j])) / d
    arrows = [("tab:blue", "^:", opinion, "a triangle") for opinion in opinions[i, j]]
    arrows += [("0.6", "s-", vector[i, j], "before"), ("black", "o-", after.vectors[row], "after")]
    for colour, line, end, label in [*arrows, ("tab:red", "x--", mean, "mean")]:
        panels[name].plot(*np.transpose([(0, 0), end]), line, c=colour, label=label, markevery=[1])
for name, axes in panels.items():
    axes.set(title=name, aspect="equal", xlim=(-2.8, 2.2), ylim=(-1, 2.4))
panels["arm"].set(title="before", xlim=(-1.2, 2.1), ylim=(-0.2, 2.4))
figure.supxlabel("x [segment lengths]; on the right, each vector from 0", fontsize="medium")
figure.supylabel("y [segment lengths]", fontsize="medium")
handles, labels = panels["L1"].get_legend_handles_labels()
figure.legend(handles[1:], labels[1:], loc="outside upper center", ncols=4)
plt.show()
