"""The MMC network as a policy: target → internal model → joint targets.

At the start of an episode the network is set to the observed posture.  From then on it runs by
itself, a few iterations per control step with its end effector clamped to the target, and the
servos follow the joint angles of its segments.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import JointTargetAgent, ReachInterface, Sensed, State
from mmc_gym.agents.dead_end import leave_line, nearest_reachable
from mmc_gym.network import MMCNetwork, MMCState, Normalizer
from mmc_gym.network.chain import Floats


class NetworkAgent(JointTargetAgent[State]):
    """An agent whose internal model of the arm is an MMC network."""

    def __init__(
        self, interface: ReachInterface, network: MMCNetwork, iterations_per_step: int = 1
    ) -> None:
        """Make the agent.

        Args:
            interface: of the environment.
            network: the internal model; of the environment's segment lengths.
            iterations_per_step: iterations of the network in a control step.

        Raises:
            ValueError: if `iterations_per_step` is less than one, or under torque control.
        """
        if iterations_per_step < 1:
            raise ValueError(f"iterations_per_step must be at least 1, got {iterations_per_step}")
        super().__init__(interface)
        self.network = network
        self.iterations_per_step = iterations_per_step


class MMCAgent(NetworkAgent[MMCState]):
    """An MMC network that drives the arm; its state is the network's."""

    def start(self, sensed: Sensed) -> MMCState:
        """Networks at rest in the sensed postures."""
        return self.network.state_from_joint_angles(sensed.joint_angles)

    def restart(self, state: MMCState, fresh: MMCState, started: NDArray[np.bool_]) -> MMCState:
        """The networks' states, new where an episode started."""
        return restarted(state, fresh, started)

    def advance(self, state: MMCState, sensed: Sensed) -> tuple[Floats, MMCState]:
        """Joint angles of the networks after the iterations of one control step."""
        state = out_of_line(self.network, state, sensed.target)
        clamps = self.network.inverse(sensed.target)
        state = self.network.run(state, clamps, self.iterations_per_step)
        return state.joint_angles, state


def restarted(state: MMCState, fresh: MMCState, started: NDArray[np.bool_]) -> MMCState:
    """The networks of `state`, or of `fresh` where an episode `started` (batch axes)."""
    return MMCState(np.where(started, fresh.values, state.values), state.segment_count)


def out_of_line(network: MMCNetwork, state: MMCState, target: Floats) -> MMCState:
    """The networks of `state`, bent a little where they could not get to their targets (..., 2).

    An arm gets into such a dead end (see `dead_end`) with its target, so it is looked for only
    where that is another one than the end effector of `state` was held at last.
    """
    held = state.values[network.segment_count * (network.segment_count + 1) // 2 - 1]
    if np.moveaxis(target, -1, 0).tobytes() == held.tobytes():
        return state
    lengths, joint_angles = network.segment_lengths, state.joint_angles
    bent = leave_line(joint_angles, nearest_reachable(target, lengths), lengths)
    is_stuck = (bent != joint_angles).any(axis=-1)
    return restarted(state, network.state_from_joint_angles(bent), is_stuck)


def dynamic_mmc(interface: ReachInterface, normalizer: Normalizer) -> MMCAgent:
    """The dynamic network at its best setting.

    d = N + 1 is where the linear part converges fastest without oscillation; the rest are the
    paper's constants.  With three iterations per control step all but about one in a thousand
    random targets are reached within the 2 s of an episode.
    """
    lengths = interface.segment_lengths
    network = MMCNetwork(lengths, len(lengths) + 1, normalizer, dynamics="paper")
    return MMCAgent(interface, network, iterations_per_step=3)
