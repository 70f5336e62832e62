"""From observations to beliefs about the body, for agents in closed loop.

Four loops, each of which can be left open:

- *posture*: how far the joints are from where the servo model expects them, a deviation that the
  agent takes over into its internal model (in the network as one more computation in the mean).
- *hand*: the hand is seen elsewhere than where the posture says, because of other lengths or a
  turned cursor.  The difference, x(q) − x seen, is averaged and added to the target: for the hand
  to be seen at the target, the posture must say that it is beside it.  (A correction of the clamp,
  not a computation in the mean.)  Both are seen at the same time, so delays do no harm.
- *delay*: it is estimated, and the old posture is run forward with the commands sent since.
- *lengths* and *locks*: they are identified.

The last three are in `identification`.

What they buy the network, in success of 200 episodes (`python benchmarks/closed_loop.py` prints
a row for every perturbation, and the times):

=================================  ========  ============  ===========  ========  ==========
body                               mmc       mmc-feedback  mmc-lengths  mmc-lock  mmc-closed
=================================  ========  ============  ===========  ========  ==========
as told                            100 %     99.5 %        100 %        100 %     99.5 %
last segment longer by half        0 %       99.5 %        100 %        0 %       98 %
cursor turned by 30°               0 %       100 %         0.5 %        0 %       99.5 %
cursor turned by 45°               0 %       95.5 %        0 %          0 %       94 %
second joint locked                7.5 %     55.5 %        7.5 %        99.5 %    99 %
it locks on the way                12 %      47.5 %        12 %         66.5 %    66.5 %
force field                        100 %     100 %         100 %        96.5 %    95.5 %
=================================  ========  ============  ===========  ========  ==========

Position servos reach what they are sent to whatever the agent sees, so in open loop delays and
noise do no harm under `--control joint_position`; feedback then costs time (at a delay of 0.2 s it
takes 0.75 s for 0.50 s), which bridging the delay wins back.  Deltas and speeds start from where
the joints are, and need the bridge: by `joint_delta` and with a delay of 0.2 s, success of 100
episodes is 0 % in open loop and with feedback, and 96 % with the delay bridged; by `joint_velocity`
and with 0.1 s it is 7 %, 65 % and 98 %.
A force field that holds the arm up may be taken for a locked joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import require_not_negative, require_number, spelt
from mmc_gym.agents.body_model.drive import command_of, commanded_turn, expected_turn
from mmc_gym.agents.closed_loop.identification import Delay, Lengths, Locks
from mmc_gym.agents.ik.agent import hand_position
from mmc_gym.interface import ReachInterface, Sensed
from mmc_gym.network.chain import Floats, wrap_angle


@spelt
@dataclass(frozen=True)
class Loops:
    """Which loops are closed; the default is none.

    Attributes:
        posture_weight: w, weight of the sensed posture as one more computation in the mean.
        hand_rate: share by which the difference between hand seen and hand felt is averaged in a
            control step; 0: it is not corrected.
        bridges_delay: whether the delay of the senses is estimated and bridged.
        identifies_lengths: whether the segment lengths are identified.
        detects_locks: whether locked joints are detected.

    Raises:
        UserError: if a weight is negative or a rate not between 0 and 1.
    """

    posture_weight: float = 0.0
    hand_rate: float = 0.0
    bridges_delay: bool = False
    identifies_lengths: bool = False
    detects_locks: bool = False

    def __post_init__(self) -> None:
        weight, rate = self.posture_weight, self.hand_rate
        require_not_negative(posture_weight=weight)
        require_number("hand_rate", rate, "between 0 and 1", lambda share: 0 <= share <= 1)


@dataclass(frozen=True, eq=False)
class Belief:
    """The beliefs of an agent about its body; arrays lead with the batch.

    Attributes:
        sensed: the posture as it should be now, and the target.
        deviation: by how much the joints are from where they were expected, radians, (..., N).
        offset: what is added to the target, segment lengths, (..., 2).
        segment_lengths: (..., N), or None if they are taken as told.
        locked: which joints are locked, (..., N), or None if that is not looked for.
    """

    sensed: Sensed
    deviation: Floats
    offset: Floats
    segment_lengths: Floats | None
    locked: NDArray[np.bool_] | None


class Memory(NamedTuple):
    """The memory of an observer.

    Attributes:
        expected: posture by the servo model, radians, (..., N).
        offset: averaged difference between hand felt and hand seen, segment lengths, (..., 2).
        delay: of the senses, and the commands that bridge it.
        lengths: of the segments.
        locks: of the joints.
    """

    expected: Floats
    offset: Floats
    delay: Delay
    lengths: Lengths
    locks: Locks


class BodyObserver:
    """Turns observations into beliefs; what it remembers is handed to it, and handed back."""

    def __init__(self, interface: ReachInterface, loops: Loops) -> None:
        """Make an observer that closes these loops."""
        self.interface, self.loops = interface, loops

    def start(self, sensed: Sensed) -> Memory:
        """Return the memory of arms that are seen for the first time."""
        joint_angles = sensed.joint_angles
        return Memory(
            joint_angles,
            np.zeros_like(sensed.target),
            Delay.unknown(self.interface, joint_angles),
            Lengths.told(self.interface.segment_lengths, joint_angles.shape[:-1]),
            Locks.none(joint_angles),
        )

    def observe(self, memory: Memory, sensed: Sensed, hand: Floats) -> tuple[Belief, Memory]:
        """Return belief and memory after an observation of posture, target and hand (..., 2)."""
        interface, loops, told = self.interface, self.loops, self.interface.segment_lengths
        expected, offset, delay, lengths, locks = memory
        seen = sensed.joint_angles
        steps = np.zeros(seen.shape[:-1], dtype=np.intp)
        if loops.bridges_delay:
            delay = delay.observed(seen, expected)
            steps = delay.steps
        now = delay.run_forward(interface, seen, steps)
        if loops.detects_locks:
            turn = commanded_turn(interface, locks.last, delay.command_before(steps))
            locks = locks.observed(seen, turn, interface.lockable_joints)
            now = np.where(locks.is_locked > 0, locks.place, now)
            expected = np.where(locks.is_locked > 0, locks.place, expected)
        known = None
        if loops.identifies_lengths:
            lengths = lengths.observed(seen, hand, told)
            known = lengths.best(told)
        if loops.hand_rate:
            felt = hand_position(seen, told if known is None else known)
            offset = offset + loops.hand_rate * (felt - hand - offset)
        belief = Belief(
            Sensed(now, sensed.target),
            wrap_angle(now - expected),
            offset,
            known,
            locks.is_locked > 0 if loops.detects_locks else None,
        )
        return belief, Memory(expected, offset, delay, lengths, locks)

    def sent(self, memory: Memory, believed: Floats, joint_targets: Floats) -> Memory:
        """Return the memory once joints believed at these angles were sent to targets (..., N)."""
        turn = expected_turn(self.interface, memory.expected, joint_targets)
        delay = memory.delay.sent(command_of(self.interface, believed, joint_targets))
        return memory._replace(expected=memory.expected + turn, delay=delay)
