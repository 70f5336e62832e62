"""An agent that is given the truth about its body: the yardstick of `mmc-body`, not a rival.

It has the drive, the imagination, the filters and the contacts of `mmc-body`, but identifies
nothing: it is given the true lengths, the rotation of the cursor, the delays, the locked joints,
the control step in which further joints lock, the gain of the servos, by how much joint sensors
are off, and what becomes of actions: it inverts their gain, offset, dead zone and backlash, and
takes a stuck motor for a locked joint.  What happens by chance is not given.

    mmc-gym benchmark --agents known-body=studies.body_model.known_body:KnownBody
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym.agents.body_model.agent import BodyAgent, BodyState, network_of_body
from mmc_gym.agents.body_model.body import Body, Locks
from mmc_gym.agents.body_model.forward_model import RATE
from mmc_gym.agents.body_model.imagination import settle_network
from mmc_gym.agents.body_model.parts import ALL_PARTS, Parts
from mmc_gym.agents.body_model.senses import LONGEST_DELAY
from mmc_gym.envs.setup import Episode
from mmc_gym.geometry import Floats, wrap_angle
from mmc_gym.interface import ReachInterface, Seen, Sensed


@dataclass(frozen=True, kw_only=True)
class KnownServos(ReachInterface):
    """An interface with the true servo gain, but the largest joint delta of the nominal servos."""

    largest_delta: float

    @property
    @override
    def max_joint_delta(self) -> float:
        return self.largest_delta


class KnownBody(BodyAgent):
    """`mmc-body` with the truth in place of the estimates of three of its parts."""

    def __init__(self, env: Any, parts: Parts = ALL_PARTS) -> None:
        """Make the agent for an environment that draws nothing, and give it its only episode."""
        self.episode: Episode = env.unwrapped.setup.first
        given = ReachInterface.of(env)
        facts = {field.name: getattr(given, field.name) for field in fields(given)}
        facts["servo_gain"] = self.episode.body.servo_gain
        interface = KnownServos(**facts, largest_delta=given.max_joint_delta)
        switches = ("identifies_body", "bridges_delay", "finds_locks", "finds_motors")
        parts = replace(parts, **dict.fromkeys(switches, False))
        super().__init__(interface, partial(settle_network, network_of_body(interface)), parts)
        delays = self.episode.delays
        self.late = min(delays["delay"] + delays["action_delay"], LONGEST_DELAY)
        stuck = np.flatnonzero(self.episode.arms.motor_stuck[0])
        self.lock_step = 0 if len(stuck) else self.episode.lock_step
        self.locked = [*stuck] or list(self.episode.body.lockable_joints)
        self._arrived: Any = 0.0  # the last actions as they arrived

    @override
    def start(self, sensed: Sensed) -> BodyState:
        sensed = replace(sensed, joint_angles=self._true_angles(sensed.joint_angles, 0.0))
        state, arms = super().start(sensed), len(sensed.joint_angles)
        shift, turn, is_mirrored = 0j, 1 + 0j, False
        if (cursor := self.episode.cursor) is not None:
            shift, x, y = (complex(*cursor.at(*hand, (0, 0))) for hand in ((0, 0), (1, 0), (0, 1)))
            turn = x - shift
            is_mirrored = ((y - shift) / turn).imag < 0
            if is_mirrored:
                turn, shift = turn.conjugate(), shift.conjugate()
        lengths = np.tile(self.episode.body.segment_lengths, (arms, 1))
        body = Body(lengths, *(np.full(arms, value) for value in (turn, shift, is_mirrored)))
        delay = state.senses.delay._replace(late=np.full(arms, float(self.late)))
        return state._replace(
            evidence=state.evidence._replace(body=body, best=body),
            senses=state.senses._replace(delay=delay),
        )

    @override
    def respond(self, state: BodyState, seen: Seen) -> tuple[NDArray[np.float32], BodyState]:
        steps = np.maximum(state.looks - self.episode.delays["delay"], 0.0)[:, None]
        angles = self._true_angles(seen.joint_angles, steps * self.interface.control_step)
        action, state = super().respond(state, replace(seen, joint_angles=angles))
        return self._inverted(action, state.looks == 1), state

    def _true_angles(self, felt: Floats, seconds: Any) -> Floats:
        arms = self.episode.arms
        return wrap_angle(felt - arms.joint_offset - arms.joint_drift * seconds)

    def _inverted(self, action: NDArray[np.float32], is_first: Any) -> NDArray[np.float32]:
        """Return the actions that arrive as these, as far as motors allow."""
        arms = self.episode.arms
        zone, play = arms.dead_zone[:, None], arms.backlash[:, None] / 2
        before = np.where(is_first[:, None], 0.0, self._arrived)
        size = np.where(np.abs(action) > zone / 2, np.maximum(np.abs(action), zone), 0.0)
        actual = np.copysign(size, action)
        pulled = actual + np.copysign(play, actual - before)
        self._arrived = np.clip(actual, -1.0, 1.0)
        gain = np.where(arms.motor_gain == 0.0, 1.0, arms.motor_gain)
        return np.clip((pulled - arms.motor_offset) / gain, -1.0, 1.0).astype(np.float32)

    @override
    def _observe(self, state: BodyState, seen: Seen) -> BodyState:
        state = super()._observe(state, seen)
        if self.lock_step < 0:
            return state
        return state._replace(locks=self._true_locks(state))

    def _true_locks(self, state: BodyState) -> Locks:
        """Return the locks in this control step; delayed senses show the locked angles later."""
        since = state.looks - 1 - self.lock_step
        late, seen = self.late, state.senses.posture.joint_angles
        by_now, _ = state.senses.delay.run_forward(
            self.interface, seen, state.senses.posture.turn, state.motors
        )
        place = state.locks.place
        place = np.where((since <= 0)[:, None], by_now, place)
        place = np.where((since == late)[:, None], seen, place)
        place = np.where((since > late)[:, None], place + RATE * (seen - place), place)
        is_locked = np.zeros(place.shape, bool)
        is_locked[:, self.locked] = (since >= 0)[:, None]
        changed = is_locked & ((since == 0) | (since == late))[:, None]
        return state.locks._replace(place=place, is_locked=is_locked, has_changed=changed)
