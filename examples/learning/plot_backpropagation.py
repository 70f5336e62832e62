"""
Can a controller learn by backpropagation through the body model?
=================================================================

Yes. The network imagines where a posture puts the hand, and the gradient of the hand's error flows
back through its iterations into the controller. The controller learns in 10 s, without a step of
the environment, and masters the bodies that were imagined, one or many.
"""

import matplotlib.pyplot as plt
import torch

import mmc_gym
from mmc_gym.interface import ObservationLayout
from mmc_gym.network import MMCNetwork
from mmc_gym.network.differentiable import TorchNetwork

torch.set_num_threads(1)
layout, STEPS = ObservationLayout(joint_count=3, reach=3.0), 300
SEEN = [1, 2, 4, 5, *range(9, 15)]  # of an observation: no speeds, nor the first joint's angle
plt.figure(figsize=(8, 4), layout="constrained")
for spread, lines in ((0, ("--", ":")), (0.2, ("-", "-."))):
    torch.manual_seed(0)
    network, tanh = TorchNetwork(MMCNetwork(damping=2.5)), torch.nn.Tanh()
    layers = [torch.nn.Linear(*sizes) for sizes in ((10, 64), (64, 64), (64, 3))]
    controller = torch.nn.Sequential(layers[0], tanh, layers[1], tanh, layers[2])
    optimizer = torch.optim.Adam(controller.parameters(), lr=0.01)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS)
    for _ in range(STEPS):  # in imagination
        network.segment_lengths.data.uniform_(1 - spread, 1 + spread)
        angles, others = torch.pi * (2 * torch.rand(2, 256, 3) - 1)
        state, loss = network.state_from_joint_angles(angles), 0
        hand, target = state.end_effector, network.state_from_joint_angles(others).end_effector
        for _ in range(5):  # it corrects itself; R follows the segments
            posture = torch.cat([angles.cos(), angles.sin(), 0 * angles], -1)
            seen = {"observation": posture, "achieved_goal": hand, "desired_goal": target}
            angles = angles + controller(layout.flatten(seen, torch)[:, SEEN])
            segments = network.state_from_joint_angles(angles).segments
            state = network(state, {(i, i + 1): segments[:, i] for i in range(3)}, iterations=5)
            hand = state.vectors[:, -1]
            distance = (target - hand).norm(dim=-1)
            loss += (distance - 0.05 / (0.05 + distance)).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    for name, line in zip(("random", "longer-20"), lines):
        arms, shares = mmc_gym.make_vec(name, 300, engine="analytic"), [0]
        observations, _ = arms.reset(seed=0)
        for _ in range(99):  # on simulated arms
            turns = controller(torch.from_dlpack(observations)[:, SEEN]).detach()
            observations, _, _, _, info = arms.step((turns * 6 / torch.pi).clip(-1, 1))
            shares.append(100 * info["is_success"].mean())
        label = f"{name}, segments imagined: 1 ± {spread}"
        plt.plot(shares, line, color="black", label=label)
        print(f"{label}: {shares[-1]:.0f} % of the targets")
plt.gca().set(xlabel="control steps of 0.02 s", ylabel="hands at their targets [%]")
plt.legend(loc="center right")
plt.show()
