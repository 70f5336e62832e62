"""
Can one network do inverse, forward and mixed kinematics?
=========================================================

Yes. A task is a set of vectors that are clamped (held); all others settle. Clamp the hand and the
posture follows, clamp the segments and the hand follows, clamp some of both and the rest follows.
"""

import matplotlib.pyplot as plt
import numpy as np

from mmc_gym.network import MMCNetwork

network = MMCNetwork(segment_lengths=(1.0, 1.0, 1.0), damping=4)
rest = network.state_from_joint_angles([0.3, 0.6, 0.6])

# %%
# Inverse: the end effector is clamped at a target. Forward: the three segments are clamped. Mixed:
# the hand is clamped, and the first segment (from node 0, the base, to node 1) straight up.

inverse = network.run(rest, network.inverse([-1.0, 1.5]), iterations=60)
forward = network.run(rest, network.forward(inverse.segments), iterations=60)
held = network.clamp({(0, 3): [0.5, 1.6], (0, 1): [0.0, 1.0]})
mixed = network.run(rest, held, iterations=60)

print("inverse: joint angles", inverse.joint_angles.round(3), "hand", inverse.end_effector.round(3))
print("forward: end effector R", forward.vectors[-1].round(3))
print("mixed: segments", mixed.segments.round(3).tolist())

# %%
# The thin grey arm is where each task begins; the dashed arrow is the vector R, from base to hand.

figure, panels = plt.subplots(1, 3, figsize=(9, 3), sharex=True, sharey=True, layout="constrained")
for axes, name, state in zip(panels, ("inverse", "forward", "mixed"), (inverse, forward, mixed)):
    axes.plot(*rest.nodes.T, "o-", color="0.7", linewidth=1, markersize=3)
    axes.plot(*state.nodes.T, "o-", color="black", linewidth=3)
    arrow = dict(arrowstyle="->", linestyle="--", color="tab:blue", linewidth=1.5)
    axes.annotate("", state.vectors[-1], (0, 0), arrowprops=arrow)
    axes.set(title=name, xlabel="x [segment lengths]", aspect="equal")
panels[0].set_ylabel("y [segment lengths]")
plt.show()

# %%
# A batch is a leading axis: a thousand targets, from one starting posture.

targets = np.random.default_rng(0).uniform(-1.5, 1.5, (1000, 2))
batch = network.run(rest, network.inverse(targets), iterations=60)
error = np.linalg.norm(batch.end_effector - targets, axis=-1)
print(f"median distance of 1000 hands to their targets: {np.median(error):.1e}")
