"""The MMC network on a time base: movements with a bell-shaped speed.

As `mmc`, but the gain of every iteration is such that the hand covers the share of its way that a
minimum-jerk movement would (`network.time_base`).  `movement` says when a movement begins and how
long it takes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import Sensed
from mmc_gym.agents.mmc import NetworkAgent, out_of_line, restarted
from mmc_gym.agents.movement import Movement, begin, follow, step, where
from mmc_gym.network import MMCState
from mmc_gym.network.chain import Floats, wrap_angle
from mmc_gym.network.time_base import share, timed_step


class TimedMMCState(NamedTuple):
    """State of the agent: the network's, and the movement."""

    network: MMCState
    movement: Movement


class TimedMMCAgent(NetworkAgent[TimedMMCState]):
    """A kinematic MMC network on a time base that drives the arm."""

    def start(self, sensed: Sensed) -> TimedMMCState:
        """Networks in the sensed postures, about to move."""
        state = self.network.state_from_joint_angles(sensed.joint_angles)
        hand = state.segments.sum(axis=-2)
        return TimedMMCState(state, begin(hand, sensed.target, self.interface.control_step))

    def restart(
        self, state: TimedMMCState, fresh: TimedMMCState, started: NDArray[np.bool_]
    ) -> TimedMMCState:
        """The networks' states and the movements, new where an episode started."""
        return TimedMMCState(
            restarted(state.network, fresh.network, started),
            where(started, fresh.movement, state.movement),
        )

    def batch_shape(self, state: TimedMMCState) -> tuple[int, ...]:
        """Those of the networks."""
        return state.network.batch_shape

    def advance(self, state: TimedMMCState, sensed: Sensed) -> tuple[Floats, TimedMMCState]:
        """Joint angles of the networks after the iterations of one control step."""
        network, count = state.network, self.iterations_per_step
        hand = network.segments.sum(axis=-2)
        movement = follow(state.movement, hand, sensed.target, self.interface.control_step)
        network = out_of_line(self.network, network, self.network.inverse(movement.target))
        for part in range(1, count + 1):
            way = share(count * movement.elapsed + part, count * movement.duration)
            network = self._within_limits(timed_step(self.network, network, movement.target, way))
        return network.joint_angles, TimedMMCState(network, step(movement))

    def _within_limits(self, network: MMCState) -> MMCState:
        """The networks, those with a joint beyond its limit halfway back within."""
        if self.interface.joint_limits is None:
            return network
        joint_angles = network.joint_angles
        back = wrap_angle(self.interface.within_limits(joint_angles) - joint_angles) / 2
        is_beyond = np.asarray((np.abs(back) > 1e-9).any(axis=-1))
        nearer = self.network.state_from_joint_angles(joint_angles + back)
        return restarted(network, nearer, is_beyond)
