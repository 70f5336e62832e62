"""
Where does the arm end if many postures reach the target?
=========================================================

In a posture near its start. With three joints for two coordinates one degree of freedom is left.
The network does not choose a solution but relaxes into one, so different starts end in different
postures.
"""

import matplotlib.pyplot as plt
import numpy as np

from mmc_gym.network import MMCNetwork

network = MMCNetwork(damping=4)
target = np.array([0.6, 1.2])
starts = np.random.default_rng(2).uniform(-np.pi, np.pi, (500, 3))
start = network.state_from_joint_angles(starts)
end = network.run(start, network.inverse(target), iterations=200)

# %%
# All hands are at the same place, and the postures fill a closed line in the space of joint
# angles: the self-motion of the arm, along which it could move without moving its hand.

distance = np.linalg.norm(end.end_effector - target, axis=-1)
print(f"{(distance < 0.05).mean():.0%} of {len(starts)} arms end at the target")
moved = np.abs(np.angle(np.exp(1j * (end.joint_angles - starts)))).mean()
other = np.abs(np.angle(np.exp(1j * (end.joint_angles - np.roll(starts, 1, axis=0))))).mean()
print(f"mean turn of a joint: {moved:.2f} rad; to where another start ends: {other:.2f} rad")

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
for nodes in end.nodes[:25]:
    left.plot(*nodes.T, "o-", color="tab:blue", alpha=0.5, markersize=3, linewidth=1)
left.plot(*target, "x", color="black", markersize=12, markeredgewidth=2, label="target")
left.plot(0, 0, "s", color="black", label="base")
left.set(xlabel="x [segment lengths]", ylabel="y [segment lengths]", aspect="equal")
left.legend()
_, second, third = np.degrees(end.joint_angles).T
_, begun, begun_third = np.degrees(starts).T
right.plot(begun, begun_third, ".", color="0.7", markersize=3, label="starts")
right.plot(second, third, ".", color="tab:blue", label="ends")
right.set(xlabel="second joint [°]", ylabel="third joint [°]", aspect="equal")
right.set(xticks=range(-180, 181, 90), yticks=range(-180, 181, 90))
right.legend()
plt.show()
