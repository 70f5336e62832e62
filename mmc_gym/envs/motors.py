"""The motors: what becomes of an action on its way to the servos, in this order.

    action ─ dropped ─ held ─ repeated ─ late ─ gain, offset, noise ─ dead zone ─ backlash ─
    stuck ─ clipped ─ servo

Actions are shares of the largest.  A motor whose action is dropped, or lies in the dead zone,
rests: its action is 0, or under position control the one before.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mmc_gym.envs.arms import ACTION_NOISE, MISSED, Arms, Bools, Floats
from mmc_gym.envs.buffers import Indices, Late, Noise, Spells, combined

MOTORS = frozenset(
    (
        *(*MISSED, "action_delay", "motor_gain", "motor_offset"),
        *(*ACTION_NOISE, "dead_zone", "backlash", "motor_stuck"),
    )
)
"""The columns of `Arms` that say what becomes of actions."""


def are_failing(arms: Arms) -> Bools:
    """Return which motors are not as they would be without perturbations, (n, N)."""
    plain, names = Arms.of(arms.base), (*MOTORS, "servo_gain", "torque_limit")
    columns = [getattr(arms, name) != getattr(plain, name) for name in names]
    rows = [column.reshape(len(arms), -1) for column in columns]
    return np.logical_or.reduce(np.broadcast_arrays(arms.motor_stuck, *rows))


class Motors:
    """The motors of n arms of N joints, with the actions that are on their way."""

    def __init__(
        self, count: int, joints: int, delay: int, touched: frozenset[str], holds: bool
    ) -> None:
        """Prepare for n arms, given the names of the columns that perturbations touch.

        `delay` is the longest of actions, control steps.  Motors at rest `holds` say whether they
        keep their action, as under position control, instead of 0.
        """
        self._touched, self._holds = touched, holds
        self.sent = np.zeros((count, joints))  #: the last actions as they arrived, (n, N)
        self.commanded = np.zeros((count, joints))  #: these actions as they were commanded, (n, N)
        self._before = np.zeros((count, joints))  # the action that may be held or repeated
        sizes = zip(MISSED, (joints, joints, 1), strict=True)
        self._spells = {name: Spells(name, count, size) for name, size in sizes if name in touched}
        self._late = Late(np.zeros((count, joints)), delay)

    def grow(self, delay: int) -> None:
        """Make room for longer delays of actions, control steps."""
        self._late.grow(delay)

    def begin(self, arms: Indices, rest: Floats) -> None:
        """Begin episodes of some arms, (k,) indices, whose motors rest, (k, N)."""
        self.sent[arms] = self.commanded[arms] = self._before[arms] = rest
        for spells in self._spells.values():
            spells.begin(arms)
        self._late.fill(arms, rest)

    def send(self, actions: Any, arms: Arms, noise: Noise, steps: Indices) -> Floats:
        """Return the actions that arrive at the servos of all arms, (n, N), within ±1.

        `actions` are (n, N), `arms` have the present columns, and `steps`, (n,), are those before.
        """
        touched, self.commanded = self._touched, np.array(actions, np.float64)
        values = self.commanded.copy()
        for name, spells in self._spells.items():
            places, happens = spells.now(arms, noise, steps)
            stays = self._holds or name != "action_dropped"
            instead = self._before[places] if stays else 0.0
            values[places] = np.where(happens, instead, values[places])
        self._before = values
        if "action_delay" in touched:
            self._late.send(values)
            values = self._late.arrived(arms.steps_of("action_delay"))
        if "motor_gain" in touched:
            values = arms.motor_gain * values
        if "motor_offset" in touched:
            values = values + arms.motor_offset
        if touched & ACTION_NOISE:
            noisy = np.flatnonzero(arms.action_noise + arms.action_noise_size)
            std, increase = arms.action_noise[noisy, None], arms.action_noise_size[noisy, None]
            std = combined(std, increase * np.abs(values[noisy]))
            values = values.copy()
            values[noisy] += std * noise.normal("action_noise", steps[noisy], noisy)
        if "dead_zone" in touched:
            is_small = np.abs(values) < arms.dead_zone[:, None]
            values = np.where(is_small, self.sent if self._holds else 0.0, values)
        if "backlash" in touched:
            play = arms.backlash[:, None] / 2
            values = np.minimum(np.maximum(self.sent, values - play), values + play)
        if "motor_stuck" in touched:
            values = np.where(arms.motor_stuck, self.sent, values)
        self.sent = np.minimum(np.maximum(values, -1.0), 1.0)
        return self.sent
