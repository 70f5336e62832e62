"""The MMC network as a policy: target → internal model → joint targets.

At the start of an episode the network is set to the observed posture.  Then it runs without
sensing the arm, a few iterations per control step, with its end effector clamped to the target.
The servos follow the joint angles of its segments.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from typing_extensions import override

from mmc_gym._errors import UserError, require, require_whole
from mmc_gym.agents.base import JointTargetAgent, State, where
from mmc_gym.agents.inverse_kinematics import leave_line
from mmc_gym.agents.planners import (
    MovementTiming,
    begin_movement,
    follow_target,
    one_step_later,
)
from mmc_gym.geometry import Floats, nearest_reachable, segments_from_joint_angles, wrap_angle
from mmc_gym.interface import CannotActError, ReachInterface, Sensed
from mmc_gym.network import (
    Clamps,
    EuclideanNormalizer,
    LearnedNormalizer,
    MMCNetwork,
    MMCState,
    Normalizer,
)
from mmc_gym.network.embodied import Embodiment, embodied_run
from mmc_gym.network.time_base import share, timed_step


def network_of_arm(interface: ReachInterface, **settings: Any) -> MMCNetwork:
    """Return an MMC network of an environment's arm; `settings` are arguments of `MMCNetwork`.

    Raise a `CannotActError` if the arm has fewer than two segments.
    """
    lengths = interface.segment_lengths
    if len(lengths) < 2:
        raise CannotActError(f"env must have two segments or more for MMC, got {len(lengths)}")
    return MMCNetwork(lengths, **settings)


class NetworkAgent(JointTargetAgent[State]):
    """An agent whose internal model of the arm is an MMC network."""

    def __init__(
        self, interface: ReachInterface, network: MMCNetwork, iterations_per_step: int = 1
    ) -> None:
        """Make the agent; the network must have as many segments as the environment's arm."""
        require_whole("iterations_per_step", iterations_per_step)
        super().__init__(interface)
        require(isinstance(network, MMCNetwork), "network", network, "an MMCNetwork")
        arm_count, network_count = len(interface.segment_lengths), network.segment_count
        if network_count != arm_count:
            accepted = f"of {arm_count} segments, as the environment's arm"
            raise UserError(f"network must be {accepted}, got one of {network_count}")
        self.network = network
        self.iterations_per_step = iterations_per_step


class MMCAgent(NetworkAgent[MMCState]):
    """An MMC network that drives the arm; the agent's state is that of the network."""

    @override
    def start(self, sensed: Sensed) -> MMCState:
        return self.network.state_from_joint_angles(sensed.joint_angles)

    @override
    def advance(self, state: MMCState, sensed: Sensed) -> tuple[Floats, MMCState]:
        network, count = self.network, self.iterations_per_step
        clamps = network.inverse(sensed.target)
        state = bend_where_stuck(network, state, clamps)
        if self.interface.joint_limits is None:
            state = network.run(state, clamps, count)
        else:
            state = run_within_limits(self.interface, network, state, clamps, count)
        return state.joint_angles, state


def run_within_limits(
    interface: ReachInterface, network: MMCNetwork, state: MMCState, clamps: Clamps, iterations: int
) -> MMCState:
    """Return the state after iterations that pull joints back within their limits.

    A joint limit acts like a sensed posture (`network.embodied`).  If a joint is beyond a limit,
    the nearest posture within the limits enters the mean as one more computation, with the weight
    N + 1.  So the other joints take over what that joint cannot do.  Some targets need a detour,
    which the network does not look for.
    """
    weight = network.segment_count + 1.0
    for _ in range(iterations):
        joint_angles = state.joint_angles
        within = interface.within_limits(joint_angles)
        is_beyond = np.asarray((np.abs(wrap_angle(joint_angles - within)) > 1e-9).any(axis=-1))
        before, state = state, network.step(state, clamps)
        if is_beyond.any():
            allowed = segments_from_joint_angles(within, network.segment_lengths)
            body = Embodiment(sensed=allowed, weight=weight)
            state = where(is_beyond, embodied_run(network, before, clamps, body), state)
    return state


def bend_where_stuck(network: MMCNetwork, state: MMCState, clamps: Clamps) -> MMCState:
    """Return the state; arms that could not move to their targets are bent (`leave_line`)."""
    (hand_row,) = clamps.rows  # the end effector alone
    (hand,) = clamps.values  # (2, ...)
    if hand.tobytes() == state.values[hand_row].tobytes():  # arms are only stuck at a new target
        return state
    joint_angles, lengths = state.joint_angles, network.segment_lengths
    bent = leave_line(joint_angles, nearest_reachable(np.moveaxis(hand, 0, -1), lengths), lengths)
    is_stuck = np.asarray((bent != joint_angles).any(axis=-1))
    if not is_stuck.any():
        return state
    return where(is_stuck, network.state_from_joint_angles(bent), state)


def classical_mmc(interface: ReachInterface) -> MMCAgent:
    """Return an agent of the classical network: the paper's constants, one iteration per step."""
    return MMCAgent(interface, network_of_arm(interface))


def neural_mmc(interface: ReachInterface) -> MMCAgent:
    """Return the agent of `dynamic_mmc` with the learned normalizer of this package."""
    return dynamic_mmc(interface, LearnedNormalizer.shipped())


def dynamic_mmc(interface: ReachInterface, normalizer: Normalizer | None = None) -> MMCAgent:
    """Return an agent of the dynamic network at its best setting.

    The default normalizer is Euclidean.

    With d = N + 1 the linear part converges fastest without oscillation.  The other constants are
    the paper's.  With three iterations per control step it misses about one in a thousand random
    targets within the 2 s of an episode.  Longer chains converge more slowly: with ten segments it
    reaches 41 % in these 300 iterations, and 85 % in 600.
    """
    network = network_of_arm(
        interface,
        damping=len(interface.segment_lengths) + 1,
        normalizer=normalizer or EuclideanNormalizer(),
        dynamics="paper",
    )
    return MMCAgent(interface, network, iterations_per_step=3)


class TimedMMCState(NamedTuple):
    """State of a `TimedMMCAgent`: that of its network, and the movement under way."""

    arm: MMCState  # state of the network, which is the internal model of the arm
    movement: MovementTiming


class TimedMMCAgent(NetworkAgent[TimedMMCState]):
    """A kinematic MMC network on a time base, which drives the arm with a bell-shaped speed.

    Unlike in `MMCAgent`, the gain varies from iteration to iteration, so that the hand covers the
    same share of its way as in a minimum-jerk movement (`network.time_base`).  `planners` defines
    when a movement begins and how long it takes.
    """

    @override
    def start(self, sensed: Sensed) -> TimedMMCState:
        arm = self.network.state_from_joint_angles(sensed.joint_angles)
        control_step = self.interface.control_step
        return TimedMMCState(arm, begin_movement(arm.end_effector, sensed.target, control_step))

    @override
    def advance(self, state: TimedMMCState, sensed: Sensed) -> tuple[Floats, TimedMMCState]:
        arm, iterations = state.arm, self.iterations_per_step
        hand, control_step = arm.end_effector, self.interface.control_step
        movement = follow_target(state.movement, hand, sensed.target, control_step)
        arm = bend_where_stuck(self.network, arm, self.network.inverse(movement.target))
        for iteration in range(1, iterations + 1):
            elapsed = iterations * movement.elapsed + iteration
            way = share(elapsed, iterations * movement.duration)
            arm = self._within_limits(timed_step(self.network, arm, movement.target, way))
        return arm.joint_angles, TimedMMCState(arm, one_step_later(movement))

    def _within_limits(self, arm: MMCState) -> MMCState:
        """Return the network's state with joints beyond their limits moved half of the way back."""
        if self.interface.joint_limits is None:
            return arm
        joint_angles = arm.joint_angles
        back = wrap_angle(self.interface.within_limits(joint_angles) - joint_angles) / 2
        is_beyond = np.asarray((np.abs(back) > 1e-9).any(axis=-1))
        nearer = self.network.state_from_joint_angles(joint_angles + back)
        return where(is_beyond, nearer, arm)


def bell_mmc(interface: ReachInterface) -> TimedMMCAgent:
    """Return an agent of the classical network on a time base, two iterations per control step."""
    return TimedMMCAgent(interface, network_of_arm(interface), iterations_per_step=2)
