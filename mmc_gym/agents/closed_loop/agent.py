"""The MMC network in closed loop: on a body that it does not know exactly.

`mmc` sets its network to the observed posture once, and never looks again.  Here what is observed
of the body enters the network in every control step, by the loops of `observer`:

- the sensed posture as one more computation in the mean, of weight w.  The damping is less by w, so
  that all weights still add up to N + 1, and an arm that moves as expected moves as with `mmc`;
- the difference between where the hand is felt and where it is seen, as a correction of the clamp;
- lengths of the segments as they are identified, in the normalization;
- locked joints as clamps on their angles, in the normalization too (`network.embodied`).

What counts as the sensed posture is the model's own, less what the body deviates from the one it
should have come to: the model is ahead of the body, which follows by servos, and that is no error
(von Holst and Mittelstaedt 1950 called it the principle of reafference).

An agent by inverse kinematics has the first two of these loops, for a fair comparison.

Literature: E. von Holst, H. Mittelstaedt (1950), Das Reafferenzprinzip, Naturwissenschaften 37,
464–476.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import UserError, require, require_whole
from mmc_gym.agents.base import InternalModelAgent, Started
from mmc_gym.agents.closed_loop.observer import Belief, BodyObserver, Loops, Memory
from mmc_gym.agents.ik.agent import InverseKinematicsAgent, Solver
from mmc_gym.agents.mmc import network_of_arm, out_of_line, run_within_limits
from mmc_gym.interface import Observation, ReachInterface, Sensed
from mmc_gym.network import MMCNetwork, MMCState
from mmc_gym.network.chain import Floats, segments_from_joint_angles
from mmc_gym.network.embodied import Embodiment

POSTURE_WEIGHT = 0.25
"""w of the agents by name."""
HAND_RATE = 0.3
"""Share of the averaging of the hand's offset, of the agents by name.

Of five weights and four rates, the pair of the highest mean success, over none and 14
perturbations, with which nowhere more than two points are lost on the open loop; the same for the
network and for inverse kinematics.
`python benchmarks/closed_loop.py --tune` prints the table, on seeds of its own.
"""

_FEEDBACK = Loops(posture_weight=POSTURE_WEIGHT, hand_rate=HAND_RATE)

LOOPS: dict[str, Loops] = {
    "feedback": _FEEDBACK,
    "delay": replace(_FEEDBACK, bridges_delay=True),
    "lengths": Loops(identifies_lengths=True),
    "lock": Loops(detects_locks=True),
    "closed": replace(_FEEDBACK, bridges_delay=True, identifies_lengths=True, detects_locks=True),
}
"""Loops by name, as the agents that close them are called: `mmc-feedback` and so on.

Without feedback there is nothing that a delay could harm, so `delay` has feedback too.
"""


class ClosedLoopState(NamedTuple):
    """State of an agent in closed loop: its internal model, and what it remembers of its body."""

    model: Any
    memory: Memory


class ClosedLoopAgent(InternalModelAgent[ClosedLoopState]):
    """An agent whose internal model of the arm is corrected by what it observes."""

    def __init__(self, interface: ReachInterface, loops: Loops) -> None:
        """Make an agent with these loops closed.

        Raises:
            CannotActError: under torque control.
        """
        super().__init__(interface)
        self.observer = BodyObserver(interface, loops)

    @abstractmethod
    def start_model(self, joint_angles: Floats) -> Any:
        """Return internal models in these postures (..., N)."""

    @abstractmethod
    def advance(self, model: Any, belief: Belief) -> tuple[Floats, Any]:
        """Return joint targets (..., N) in radians, and the models after one control step."""

    @override
    def start(self, sensed: Sensed) -> ClosedLoopState:
        return ClosedLoopState(self.start_model(sensed.joint_angles), self.observer.start(sensed))

    @override
    def predict(
        self,
        observation: Observation,
        state: ClosedLoopState | None = None,
        episode_start: Started = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], ClosedLoopState]:
        sensed = self.interface.sense(observation)
        hand = self.interface.seen_hand(observation)
        model, memory = self.resumed(state, sensed, episode_start)
        belief, memory = self.observer.observe(memory, sensed, hand)
        joint_targets, model = self.advance(model, belief)
        memory = self.observer.sent(memory, belief.sensed.joint_angles, joint_targets)
        return self.interface.act(joint_targets, belief.sensed), ClosedLoopState(model, memory)


class ClosedLoopMMCAgent(ClosedLoopAgent):
    """The dynamic MMC network in closed loop."""

    def __init__(
        self,
        interface: ReachInterface,
        loops: Loops,
        network: MMCNetwork,
        iterations_per_step: int = 1,
    ) -> None:
        """Make the agent.

        The network is synchronous, and of the environment's segment lengths.

        Raises:
            UserError: if `iterations_per_step` is less than one; as `CannotActError`, under torque
                control.
        """
        require_whole("iterations_per_step", iterations_per_step)
        super().__init__(interface, loops)
        self.network, self.iterations_per_step = network, iterations_per_step

    @override
    def start_model(self, joint_angles: Floats) -> MMCState:
        return self.network.state_from_joint_angles(joint_angles)

    @override
    def advance(self, model: MMCState, belief: Belief) -> tuple[Floats, MMCState]:
        clamps = self.network.inverse(belief.sensed.target + belief.offset)
        model = out_of_line(self.network, model, clamps)
        lengths, weight = belief.segment_lengths, self.observer.loops.posture_weight
        sensed = None
        if weight:
            known = self.network.segment_lengths if lengths is None else lengths
            sensed = segments_from_joint_angles(model.joint_angles + belief.deviation, known)
        posture = belief.sensed.joint_angles
        body = Embodiment(lengths, sensed, weight, belief.locked, posture)
        count = self.iterations_per_step
        model = run_within_limits(self.interface, self.network, model, clamps, body, count)
        return model.joint_angles, model


class ClosedLoopInverseKinematicsAgent(ClosedLoopAgent):
    """Inverse kinematics in closed loop: posture and hand are fed back, nothing is identified.

    Of a deviation, an iteration takes w/(N + 1) over into the internal posture, the share that it
    has in the mean of the network.
    """

    def __init__(self, interface: ReachInterface, loops: Loops, solver: Solver) -> None:
        """Make the agent, of three iterations of the solver per control step.

        Raises:
            UserError: for loops that only the network can close; as `CannotActError`, under torque
                control.
        """
        if loops.identifies_lengths or loops.detects_locks:
            raise UserError(f"loops must be feedback and delay alone, got {loops}")
        super().__init__(interface, loops)
        self.open_loop = InverseKinematicsAgent(interface, solver, iterations_per_step=3)

    @override
    def start_model(self, joint_angles: Floats) -> Floats:
        return joint_angles

    @override
    def advance(self, model: Floats, belief: Belief) -> tuple[Floats, Floats]:
        count = self.open_loop.iterations_per_step
        share = self.observer.loops.posture_weight / (model.shape[-1] + 1)
        model = model + min(count * share, 1.0) * belief.deviation
        aim = Sensed(model, belief.sensed.target + belief.offset)
        return self.open_loop.advance(model, aim)


def closed_loop_mmc(interface: ReachInterface, loops: Loops) -> ClosedLoopMMCAgent:
    """Return the network of `mmc` with some loops closed.

    Raises:
        UserError: if the weight of the posture is (N + 1) / 2 or more; as `CannotActError`, under
            torque control, or for an arm of a single segment.
    """
    require(isinstance(loops, Loops), "loops", loops, "Loops, such as LOOPS['feedback']")
    weight, total = loops.posture_weight, len(interface.segment_lengths) + 1
    accepted = f"less than (N + 1) / 2 = {total / 2:g}"
    require(weight < total / 2, "posture_weight", weight, accepted)
    network = network_of_arm(interface, damping=total - weight, dynamics="paper")
    return ClosedLoopMMCAgent(interface, loops, network, iterations_per_step=3)
