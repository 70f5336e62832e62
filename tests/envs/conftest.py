"""What the tests of environments share: results compared to the bit, and rough actions."""

import numpy as np

from mmc_gym.envs.perturbations import FAMILIES

LIMITS = ((-2.0, 2.5), (-2.5, 2.0), (0.1, 2.9))
RANGES = ["rotation--60..60-at-0.1-over-0.1"] + [
    f"{name}-{family.default / 2:g}..{family.default:g}"
    for name, family in FAMILIES.items()
    if family.has_strength and name != "channel"
]


def same(first, second):
    """Whether results are the same to the bit and of the same types; NaN equals NaN."""
    if type(first) is not type(second):
        return False
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(same(first[k], second[k]) for k in first)
    if isinstance(first, list | tuple) or getattr(first, "dtype", None) == np.object_:
        return len(first) == len(second) and all(map(same, first, second))
    first, second = np.asarray(first), np.asarray(second)
    is_equal = np.array_equal(first, second, equal_nan=first.dtype.kind == "f")
    return is_equal and first.dtype == second.dtype


def random_actions(env, steps, seed=0, hold=1):
    """Draw actions of an environment, (steps, ...), each held for some steps."""
    shape = steps // hold, *env.action_space.shape
    actions = np.random.default_rng(seed).uniform(-1, 1, shape)
    return actions.astype(np.float32).repeat(hold, axis=0)
