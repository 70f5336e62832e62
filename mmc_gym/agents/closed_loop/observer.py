"""What an agent in closed loop makes of its observations: where its body is now, and what it is.

Four loops, each of which can be left open:

- *posture*: how far the joints are from where the servo model expects them, a deviation that the
  agent takes over into its internal model (in the network as one more computation in the mean).
- *hand*: the hand is seen elsewhere than where the posture says, because of other lengths or a
  turned cursor.  The difference, x(q) − x seen, is averaged, and added to the target: for the hand
  to be seen at the target, the posture must say that it is beside it.  (A correction of the clamp,
  not a computation in the mean.)  Both are seen at the same time, so delays do no harm.
- *delay*: `delay_bridge`.
- *lengths*: `length_identification`.
- *locks*: `lock_detection`.

What they buy the network, in success of 200 episodes (`python benchmarks/closed_loop.py` prints
a row for every perturbation, and the times):

=================================  ========  ============  ===========  ========  ==========
body                               mmc       mmc-feedback  mmc-lengths  mmc-lock  mmc-closed
=================================  ========  ============  ===========  ========  ==========
as told                            100 %     99.5 %        100 %        100 %     99.5 %
last segment longer by half        0 %       99 %          100 %        0 %       98.5 %
cursor turned by 30°               0 %       100 %         0.5 %        0 %       99.5 %
cursor turned by 45°               0 %       95 %          0 %          0 %       95 %
second joint locked                7.5 %     57 %          7.5 %        99.5 %    99.5 %
it locks on the way                12.5 %    48 %          12.5 %       67 %      67 %
force field                        98.5 %    99.5 %        98.5 %       97 %      96.5 %
=================================  ========  ============  ===========  ========  ==========

Position servos reach what they are sent to whatever the agent sees, so in open loop delays and
noise do no harm; feedback then costs time (at a delay of 0.2 s it takes 0.75 s for 0.50 s), which
bridging the delay wins back.  Velocity control needs the bridge: with `--control joint_velocity`
and a delay of 0.1 s success is 6 % in open loop, 53 % with feedback, 99.5 % with the delay bridged.
A force field that holds the arm up may be taken for a locked joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.closed_loop import delay as delay_bridge
from mmc_gym.agents.closed_loop import lengths as length_identification
from mmc_gym.agents.closed_loop import locks as lock_detection
from mmc_gym.agents.closed_loop.delay import expected_turn
from mmc_gym.agents.planners import where
from mmc_gym.interface import ReachInterface, Sensed
from mmc_gym.network.chain import Floats, segments_from_joint_angles, wrap_angle


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
        ValueError: if a weight is negative or a rate not between 0 and 1.
    """

    posture_weight: float = 0.0
    hand_rate: float = 0.0
    bridges_delay: bool = False
    identifies_lengths: bool = False
    detects_locks: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.posture_weight < np.inf:
            raise ValueError(
                f"posture_weight must be finite and not negative, got {self.posture_weight!r}"
            )
        if not 0 <= self.hand_rate <= 1:
            raise ValueError(f"hand_rate must lie between 0 and 1, got {self.hand_rate!r}")


@dataclass(frozen=True, eq=False)
class Belief:
    """What an agent believes of its body; arrays lead with the batch.

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


class Motion(NamedTuple):
    """Where the body was expected, and where the hand was not.

    Attributes:
        expected: posture by the servo model, radians, (..., N).
        offset: averaged difference between hand felt and hand seen, segment lengths, (..., 2).
    """

    expected: Floats
    offset: Floats


class Memory(NamedTuple):
    """What an observer remembers."""

    motion: Motion
    delay: delay_bridge.Delay
    lengths: length_identification.Lengths
    locks: lock_detection.Locks


class BodyObserver:
    """Turns observations into beliefs; what it remembers is handed to it, and handed back."""

    def __init__(
        self, interface: ReachInterface, loops: Loops, lockable: tuple[int, ...] = ()
    ) -> None:
        """Make an observer.

        Args:
            interface: of the environment.
            loops: which are closed.
            lockable: joints that the agent was told to be ones that lock.
        """
        self.interface, self.loops, self.lockable = interface, loops, lockable

    def start(self, joint_angles: Floats, target: Floats) -> Memory:
        """What there is to remember of arms first seen in these postures (..., N)."""
        return Memory(
            Motion(joint_angles, np.zeros_like(target)),
            delay_bridge.start(joint_angles),
            length_identification.start(self.interface.segment_lengths, joint_angles.shape[:-1]),
            lock_detection.start(joint_angles),
        )

    def observe(self, memory: Memory, sensed: Sensed, hand: Floats) -> tuple[Belief, Memory]:
        """What to believe after an observation of posture, target and hand (..., 2)."""
        interface, loops, told = self.interface, self.loops, self.interface.segment_lengths
        (expected, offset), delay, lengths, locks = memory
        seen = sensed.joint_angles
        steps = np.zeros(seen.shape[:-1], dtype=np.intp)
        if loops.bridges_delay:
            delay = delay_bridge.watch(delay, seen, expected)
            steps = delay_bridge.steps_late(delay)
        now = delay_bridge.run_forward(interface, delay, seen, steps)
        if loops.detects_locks:
            command = delay_bridge.command_before(delay, steps)
            turn = expected_turn(interface, locks.last, command)
            locks = lock_detection.observe(locks, seen, turn, self.lockable)
            now = np.where(locks.is_locked > 0, locks.place, now)
            expected = np.where(locks.is_locked > 0, locks.place, expected)
        if loops.identifies_lengths:
            lengths = length_identification.observe(lengths, seen, hand, told)
        known = length_identification.best(lengths, told) if loops.identifies_lengths else None
        if loops.hand_rate:
            felt = segments_from_joint_angles(seen, told if known is None else known).sum(axis=-2)
            offset = offset + loops.hand_rate * (felt - hand - offset)
        belief = Belief(
            Sensed(now, sensed.target),
            wrap_angle(now - expected),
            offset,
            known,
            locks.is_locked > 0 if loops.detects_locks else None,
        )
        return belief, Memory(Motion(expected, offset), delay, lengths, locks)

    def sent(self, memory: Memory, joint_targets: Floats) -> Memory:
        """What there is to remember when the joints were sent to these targets (..., N)."""
        expected = memory.motion.expected
        expected = expected + expected_turn(self.interface, expected, joint_targets)
        return memory._replace(
            motion=memory.motion._replace(expected=expected),
            delay=delay_bridge.sent(memory.delay, joint_targets),
        )


def restarted(memory: Memory, fresh: Memory, started: NDArray[np.bool_]) -> Memory:
    """`memory`, with the `fresh` one where an episode `started` (batch axes)."""
    return Memory(
        where(started, fresh.motion, memory.motion),
        where(started, fresh.delay, memory.delay),
        where(started, fresh.lengths, memory.lengths),
        where(started, fresh.locks, memory.locks),
    )
