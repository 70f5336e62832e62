"""An agent that is given the truth about its body: the yardstick of `mmc-body`, not a rival.

It has the drive, the imagination, the filters and the contacts of `mmc-body`, but identifies
nothing: it is given the true lengths, the rotation of the cursor, the delay, the locked joints, and
the control step in which further joints lock.

    mmc-gym benchmark --agents known-body=studies.body_model.known_body:KnownBody
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from typing_extensions import override

from mmc_gym.agents.body_model.agent import BodyAgent, BodyState, network_of_body
from mmc_gym.agents.body_model.body import PLACE_RATE, Body, Locks
from mmc_gym.agents.body_model.imagination import settle_network
from mmc_gym.agents.body_model.parts import ALL_PARTS, Parts
from mmc_gym.agents.body_model.senses import LONGEST_DELAY
from mmc_gym.envs.setup import Episode
from mmc_gym.interface import ReachInterface, Seen, Sensed


class KnownBody(BodyAgent):
    """`mmc-body` with the truth in place of the estimates of three of its parts."""

    def __init__(self, env: Any, parts: Parts = ALL_PARTS) -> None:
        """Make the agent for an environment that draws nothing, and give it its only episode."""
        interface = ReachInterface.of(env)
        parts = replace(parts, identifies_body=False, bridges_delay=False, finds_locks=False)
        super().__init__(interface, partial(settle_network, network_of_body(interface)), parts)
        self.episode: Episode = env.unwrapped.setup.first
        self.late = min(self.episode.delays["delay"], LONGEST_DELAY)

    @override
    def start(self, sensed: Sensed) -> BodyState:
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
    def _observe(self, state: BodyState, seen: Seen) -> BodyState:
        state = super()._observe(state, seen)
        if self.episode.lock_step < 0:
            return state
        return state._replace(locks=self._true_locks(state))

    def _true_locks(self, state: BodyState) -> Locks:
        """Return the locks in this control step; delayed senses show the locked angles later."""
        since = state.looks - 1 - self.episode.lock_step
        late, seen = self.late, state.senses.posture.joint_angles
        by_now = state.senses.delay.run_forward(self.interface, seen)
        place = state.locks.place
        place = np.where((since <= 0)[:, None], by_now, place)
        place = np.where((since == late)[:, None], seen, place)
        place = np.where((since > late)[:, None], place + PLACE_RATE * (seen - place), place)
        is_locked = np.zeros(place.shape, bool)
        is_locked[:, list(self.episode.body.lockable_joints)] = (since >= 0)[:, None]
        changed = is_locked & ((since == 0) | (since == late))[:, None]
        return state.locks._replace(place=place, is_locked=is_locked, has_changed=changed)
