"""
What does one iteration of the network do?
==========================================

It asks every triangle for its opinion of each vector, and takes the mean. An arm of three segments
has six vectors: the segments L1, L2, L3, the diagonals D1, D2, and the end effector R. Each is a
side of two triangles, and each triangle computes it from its other two sides.
"""

import matplotlib.pyplot as plt
import numpy as np

from mmc_gym.network import MMCNetwork
from mmc_gym.network.chain import vector_pairs

network = MMCNetwork(damping=4)
rest = network.state_from_joint_angles([0.3, 0.6, 0.6])
target = network.inverse([-1.0, 1.5])
start = network.run(rest, target, iterations=0)  # R is at the target, all else is as it was

# %%
# A vector from node i to node j, by way of another node k: v_ik + v_kj. As long as the arm stands
# still, all agree. Now that R has been moved, the triangles with R contradict the others.

pairs = vector_pairs(3)
names = dict(zip(pairs, ("L1", "L2", "L3", "D1", "D2", "R")))
vector = {pair: start.vectors[row] for row, pair in enumerate(pairs)}
vector |= {(j, i): -value for (i, j), value in vector.items()}
opinions = {
    (i, j): [vector[i, k] + vector[k, j] for k in range(4) if k not in (i, j)] for i, j in pairs
}
for pair, values in opinions.items():
    said = " and ".join(str(value.round(2)) for value in values)
    print(f"{names[pair]}: now {vector[pair].round(2)}, its triangles say {said}")

# %%
# The mean gives the present value the weight (d − 2)/d, and each of the two opinions 1/d, with the
# damping d. At last the segments, and only these, are brought back to their length, and what is
# held, R, stays where it is.

after = network.step(start, target)
d = network.damping
figure, panels = plt.subplots(2, 3, figsize=(9, 5), layout="constrained")
for axes, (row, pair) in zip(panels.flat, enumerate(pairs)):
    mean = ((d - 2) * vector[pair] + sum(opinions[pair])) / d
    arrows = [("tab:blue", "^:", opinion, "a triangle") for opinion in opinions[pair]]
    arrows += [("0.6", "s-", vector[pair], "before"), ("black", "o-", after.vectors[row], "after")]
    arrows += [("tab:red", "x--", mean, "mean")]
    for colour, line, tip, label in arrows:
        axes.plot(*np.transpose([(0, 0), tip]), line, color=colour, label=label, markevery=[1])
    axes.set(title=names[pair], aspect="equal", xlim=(-2.8, 2.2), ylim=(-1, 2.4))
figure.supxlabel("x [segment lengths], each vector drawn from its start", fontsize="medium")
figure.supylabel("y [segment lengths]", fontsize="medium")
handles, labels = panels[0, 0].get_legend_handles_labels()
figure.legend(handles[1:], labels[1:], loc="outside upper center", ncols=4)
plt.show()
