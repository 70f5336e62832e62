"""One MMC network, three tasks: inverse, forward and mixed."""

import numpy as np

from mmc_gym.network import MMCNetwork

network = MMCNetwork(segment_lengths=(1.0, 1.0, 1.0), damping=4)
rest = network.state_from_joint_angles([0.3, 0.6, 0.6])

# Inverse: the end effector is held at the target, the posture follows.
solved = network.run(rest, network.inverse([-1.0, 1.5]), iterations=60)
print(
    "inverse: joint angles", solved.joint_angles.round(3), "hand at", solved.end_effector.round(3)
)

# Forward: the segments are held, the end effector R (the last vector) follows.
forward = network.run(rest, network.forward(solved.segments), iterations=60)
print("forward: R", forward.vectors[-1].round(3))

# Mixed: the hand at a target, and the first segment held straight up.
held = network.clamp({(0, 3): [0.5, 1.6], (0, 1): [0.0, 1.0]})
mixed = network.run(rest, held, iterations=60)
print("mixed:   segments", mixed.segments.round(3).tolist())

# A batch is a leading axis: a thousand targets from one starting posture.
targets = np.random.default_rng(0).uniform(-1.5, 1.5, (1000, 2))
batch = network.run(rest, network.inverse(targets), iterations=60)
error = np.linalg.norm(batch.end_effector - targets, axis=-1)
print(f"batch:   median distance of 1000 hands to their targets {np.median(error):.1e}")
