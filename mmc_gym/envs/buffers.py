"""What n arms remember: numbers drawn in blocks, spells that last, and values on their way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmc_gym.envs.arms import (
    ACTION_NOISE,
    JOINT_NOISE,
    MISSED,
    NOISE,
    SPELLS,
    VISION_NOISE,
    Arms,
    Bools,
    Floats,
)

Indices = NDArray[np.intp]
Randoms = Sequence[np.random.Generator]
_BLOCK = 50  # control steps for which numbers are drawn at once


class Noise:
    """The random numbers of motors and senses of n arms, drawn for many steps at once.

    Each arm's own generator draws its numbers; an arm that needs none draws none.
    """

    def __init__(self, count: int, joints: int, size: int, touched: frozenset[str]) -> None:
        """Prepare for n arms, given the names of the columns that perturbations touch.

        `size` is that of an observation.
        """
        normal = {"joint_noise": (JOINT_NOISE, 2 * joints), "vision_noise": (VISION_NOISE, 4)}
        normal |= {"action_noise": (ACTION_NOISE, joints)}
        normal |= {"observation_noise": (frozenset(["observation_noise"]), size)}
        counts = (joints, joints, 1, size, size, 1)
        sizes = dict(zip((*MISSED, *SPELLS), counts, strict=True))
        uniform = {name: (frozenset([name]), size) for name, size in sizes.items()}
        self._names = touched & {*NOISE, *MISSED, *SPELLS}
        self._normal, self._normals = _blocks(count, normal, touched, np.float64)
        self._uniform, self._uniforms = _blocks(count, uniform, touched, np.float32)
        self._is_noisy = np.zeros(count, dtype=bool)
        self.is_drawn = bool(self._names)  #: whether any arm may need numbers

    def begin(self, indices: Indices, arms: Arms) -> None:
        """Begin episodes of k arms, given their columns at full strength."""
        if not self._names:
            return
        columns = [getattr(arms, name) != 0.0 for name in self._names]
        self._is_noisy[indices] = is_noisy = np.any(columns, axis=0)
        # Those of the others are drawn in the first step.
        self._normals[indices[~is_noisy]] = 0.0
        self._uniforms[indices[~is_noisy]] = 1.0

    def draw(self, indices: Indices, steps: Indices, randoms: Randoms) -> None:
        """Draw the numbers of k arms from their generators in `randoms`, (n,), once a block."""
        for arm in indices[(steps % _BLOCK == 0) & self._is_noisy[indices]].tolist():
            if self._normal:
                randoms[arm].standard_normal(out=self._normals[arm])
            if self._uniform:
                randoms[arm].random(dtype=np.float32, out=self._uniforms[arm])

    def normal(self, name: str, steps: Indices, arms: Indices) -> Floats:
        """Return normally distributed numbers of k arms for a step, (k, …)."""
        return _taken(self._normals, arms, steps)[:, self._normal[name]]

    def uniform(self, name: str, steps: Indices, arms: Indices) -> NDArray[np.float32]:
        """Return numbers within [0, 1) of k arms for a step, (k, …)."""
        return _taken(self._uniforms, arms, steps)[:, self._uniform[name]]


def _taken(blocks: NDArray[Any], arms: Indices, steps: Indices) -> Any:
    """Return the numbers of a step, (k, m), of arms with blocks (n, steps, m)."""
    rows = blocks.reshape(len(blocks) * _BLOCK, blocks.shape[2])
    return rows.take(arms * _BLOCK + steps % _BLOCK, axis=0)  # quicker than two indices


def _blocks(
    count: int, columns: dict[str, tuple[frozenset[str], int]], touched: frozenset[str], dtype: Any
) -> tuple[dict[str, slice], Any]:
    """Return where the numbers of each name are in a block, and the blocks of n arms."""
    places, end = {}, 0
    for name, (names, size) in columns.items():
        if names & touched:
            places[name] = slice(end, end + size)
            end += size
    return places, np.zeros((count, _BLOCK, end), dtype)


def combined(std: Floats, more: Floats) -> Floats:
    """Return the standard deviation of the sum of two independent noises."""
    return np.sqrt(std * std + more * more)


class Spells:
    """What happens to m numbers of n arms by chance, and then lasts for some control steps."""

    def __init__(self, name: str, count: int, size: int) -> None:
        """Prepare for n arms, given the name of the column of its probability."""
        self._name = name
        self._left = np.zeros((count, size), np.float32)

    def begin(self, arms: Indices) -> None:
        """Begin episodes of some arms, in which nothing happens yet."""
        self._left[arms] = 0.0

    def now(
        self,
        arms: Arms,
        noise: Noise,
        steps: Indices,
        rows: Indices | slice = slice(None),
        may_be: Bools | bool = True,
    ) -> tuple[Indices, Bools]:
        """Return the places of j of k arms, and to which of their numbers it happens now, (j, m).

        It never happens to the others.  `arms` have the present columns of all.  It begins only
        where it `may_be`, (k,), and ends where it has no probability any more.  What is repeated
        was there once before, so it begins after this step, and a spell never follows another at
        once.
        """
        probability = np.where(may_be, getattr(arms, self._name)[rows], 0.0)
        places = np.flatnonzero(probability)
        indices = np.arange(len(self._left))[rows][places]
        duration = getattr(arms, f"{self._name}_steps")[indices, None]
        begins_after = self._name.endswith("_repeated")
        chances = noise.uniform(self._name, steps[places], indices)
        before = self._left[indices]
        begins = (before == 0.0) & (chances < probability[places, None].astype(np.float32))
        left = np.where(begins, (duration + begins_after).astype(np.float32), before)
        self._left[rows] = 0.0
        self._left[indices] = np.maximum(left - np.float32(1.0), np.float32(0.0))
        return places, np.asarray((before if begins_after else left) > 0.0)


class Late:
    """The last values of n arms, of which each arm's arrives so many steps late."""

    def __init__(self, value: NDArray[Any], most: int) -> None:
        """Make room for delays of at most so many steps; `value` is an array (n, …)."""
        self._value = value
        if most:
            self._values = np.repeat(value[None], most + 1, axis=0)
        self._most, self._newest = most, 0

    def grow(self, most: int) -> None:
        """Make room for longer delays; the oldest value fills it."""
        if most > self._most:
            order = (self._newest - np.arange(self._most, -1, -1)) % (self._most + 1)
            values = self._values[order] if self._most else self._value[None]
            more = np.repeat(values[:1], most - self._most, axis=0)
            self._values = np.concatenate([more, values])
            self._most, self._newest = most, most

    @property
    def oldest(self) -> NDArray[Any]:
        """The value that the next one replaces; it may be overwritten and sent."""
        return self._values[(self._newest + 1) % (self._most + 1)] if self._most else self._value

    def send(self, value: NDArray[Any]) -> None:
        """Send a value on its way, in place of the oldest."""
        if not self._most:
            self._value = value
            return
        oldest = self.oldest
        self._newest = (self._newest + 1) % (self._most + 1)
        if not np.may_share_memory(value, oldest):  # else it was written into this place
            oldest[...] = value

    def fill(self, arms: Indices, value: NDArray[Any]) -> None:
        """Let the value of some arms be all that is on its way."""
        if self._most:
            self._values[:, arms] = value
        else:
            self._value[arms] = value

    def take(self, arms: Indices, steps: Indices, values: NDArray[Any]) -> None:
        """Send the values of all arms, or of some that are at their start.

        Of an arm at its start, (k,) `steps` of 0, nothing else is on its way.
        """
        starts = np.arange(len(arms))
        if len(arms) == len(self._value):
            self.send(values)
            starts = np.flatnonzero(steps == 0)
        if len(starts):
            self.fill(arms[starts], values[starts])

    def arrived(self, delays: Any) -> NDArray[Any]:
        """Return the value of each arm that arrives now, given its delay, (n,)."""
        if not self._most:
            return self._value
        slots, count = self._values.shape[:2]
        rows = (self._newest - delays) % slots * count + np.arange(count)
        return self._values.reshape(slots * count, *self._values.shape[2:]).take(rows, axis=0)


def pick(values: Any, arms: Any) -> Any:
    """Return the rows of some arms from an array, or from each array of a mapping."""
    if isinstance(values, dict):
        return {name: column[arms] for name, column in values.items()}
    return values[arms]


def put(values: Any, arms: Any, rows: Any) -> None:
    """Write rows of some arms into an array, or into each array of a mapping."""
    if isinstance(values, dict):
        for name in rows:
            values[name][arms] = rows[name]
    else:
        values[arms] = rows
