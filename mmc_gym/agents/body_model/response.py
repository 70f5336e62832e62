"""How joints respond to the actions of an interface with an `act` of its own, seen late or not.

The agent knows no servo there.  From what it sees it fits, for each joint, how the speed of one
control step follows from the speed and the action of the step before,

    s′ = a s + b u,

by least squares; until a movement is seen, a = 1 and b = 0.  With the actions that were sent since,
angles and speeds that are seen late give those of now.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mmc_gym.agents.body_model.forward_model import Bools
from mmc_gym.geometry import Floats

RIDGE = 1e-6  # weight of a = 1 and b = 0
STEADY = np.array([1.0, 0.0])


class Response(NamedTuple):
    """What was seen of the response of n arms with N joints."""

    actions: Floats  # those sent, the latest last, (n, longest delay + 1, N)
    speeds: Floats  # as last seen, (n, N)
    squares: Floats  # Σ x xᵀ of x = (s, u), (n, N, 2, 2)
    products: Floats  # Σ x (s′ − s), (n, N, 2)

    @classmethod
    def start(cls, speeds: Floats, longest: int) -> Response:
        """Return the response before any action."""
        arms, joints = speeds.shape
        actions, sums = np.zeros((arms, longest + 1, joints)), np.zeros((arms, joints, 2))
        return cls(actions, speeds, np.zeros((arms, joints, 2, 2)), sums)

    def observe(self, speeds: Floats, late: Floats, counts: Bools) -> Response:
        """Return the response after speeds were seen, `late` control steps (n,); some count."""
        steps, arms = late.astype(np.intp), np.arange(len(late))
        x = np.stack([self.speeds, self.actions[arms, -1 - steps]], axis=-1) * counts[:, None, None]
        squares = self.squares + x[..., :, None] * x[..., None, :]
        products = self.products + x * (speeds - self.speeds)[..., None]
        return self._replace(speeds=speeds, squares=squares, products=products)

    def record(self, action: Floats) -> Response:
        """Return the response after actions were sent, if there is one for each joint."""
        if np.shape(action) != self.speeds.shape:
            return self
        return self._replace(actions=np.concatenate([self.actions[:, 1:], action[:, None]], axis=1))

    def run_forward(
        self, joint_angles: Floats, speeds: Floats, late: Floats, control_step: float
    ) -> tuple[Floats, Floats]:
        """Return angles and speeds of now, from those of `late` control steps (n,) ago."""
        fit = np.linalg.solve(self.squares + RIDGE * np.eye(2), self.products[..., None])[..., 0]
        keep, push = np.moveaxis(STEADY + fit, -1, 0)
        for back in range(int(late.max()), 0, -1):
            is_due = (back <= late)[:, None]
            after = np.where(is_due, keep * speeds + push * self.actions[:, -back], speeds)
            turn = np.where(is_due, control_step / 2 * (speeds + after), 0.0)
            joint_angles, speeds = joint_angles + turn, after
        return joint_angles, speeds
