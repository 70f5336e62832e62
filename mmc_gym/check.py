"""Check a `ReachInterface` that you wrote, against its environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import UserError, require
from mmc_gym.geometry import Floats, segments_from_joint_angles, wrap_angle
from mmc_gym.interface import InterfacedEnv, InterfaceLike, ReachInterface, Seen

TURN, STEPS = 0.2, 25  # radians that each joint is asked to turn, and in how many steps
EPISODES = 3  # that are begun
CLOSE = 0.02  # shares of the reach, or of what is compared
FAR_TURN = 1.0  # radians, a turn whose action may be beyond the action space
BEYOND = 0.05  # radians that an angle may be seen beyond a limit: noise


def check_interface(env: gym.Env[Any, Any], interface: InterfaceLike, seed: int = 0) -> list[str]:
    r"""Return what seems to be wrong with an interface, a line each; an empty list if nothing is.

    Some episodes are begun in the environment, and each joint is asked to turn a little.

    Args:
        env: a single environment.
        interface: as `InterfacedEnv` takes it.
        seed: of the first episode; others follow.

    >>> import gymnasium as gym
    >>> from dataclasses import replace
    >>> from examples.reacher import INTERFACE
    >>> env = gym.make("Reacher-v5")
    >>> check_interface(env, INTERFACE)
    []
    >>> print(*check_interface(env, replace(INTERFACE, segment_lengths=(0.1, 0.11))), sep="\n")
    segment_lengths should be near 1, got (0.1, 0.11): choose another unit of length in see
    hand of see is 10 times where segment_lengths and joint_angles put it: check the units
    """
    contract = InterfacedEnv(env, interface).parameters
    observations = [env.reset(seed=seed + number)[0] for number in range(EPISODES)]
    try:
        sights = [contract.look(observation) for observation in observations]
        space = _action_space(contract, env, sights)
        lines = [*_batches(contract, observations, sights), *_hand(contract, sights)]
        turns = _turns(contract, env, seed, sights)
        return [*lines, *space, *turns, *([] if lines else _limits(contract, sights))]
    except UserError as error:
        return [str(error)]


def _action(contract: ReachInterface, seen: Seen, targets: Floats) -> NDArray[Any]:
    return contract.checked_action(contract.act(targets, seen), seen.joint_angles.shape[:-1])


def _rows(arms: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Return what several arms have under the same names as batches."""
    return {name: np.stack([arm[name] for arm in arms]) for name in arms[0]}


def _batches(
    contract: ReachInterface, observations: Sequence[Any], sights: Sequence[Seen]
) -> list[str]:
    """Compare what is seen and done in a batch with what is in each of its rows."""
    rows = _rows([vars(seen) for seen in sights])
    del rows["lost"]
    actions = np.stack([_action(contract, seen, seen.joint_angles) for seen in sights])
    is_mapping = isinstance(observations[0], dict)
    batch = _rows(observations) if is_mapping else np.stack(observations)
    try:
        together = contract.look(batch)
        action = _action(contract, together, together.joint_angles)
    except Exception as error:  # of any kind: see and act are the user's
        return [f"see or act fails for a batch of observations: {error}"]
    wrong = [name for name, row in rows.items() if not np.allclose(vars(together)[name], row)]
    lines = [f"{name} of see differs between a batch and its rows" for name in wrong]
    if not np.allclose(action, actions, atol=1e-6):
        lines.append("what act returns differs between a batch and its rows")
    return lines


def _hand(contract: ReachInterface, sights: Sequence[Seen]) -> list[str]:
    """Compare the hand with forward kinematics, and lengths with 1."""
    angles = np.stack([seen.joint_angles for seen in sights])
    hands = np.stack([seen.hand for seen in sights])
    lengths, lines = contract.segment_lengths, []
    if contract.arm is None and not 0.2 <= np.mean(lengths) <= 5:
        message = f"segment_lengths should be near 1, got {lengths}"
        lines.append(f"{message}: choose another unit of length in see")

    def places(angles: Floats) -> Floats:
        if contract.arm is not None:
            return contract.arm.forward(angles)[:, :3, 3]
        return segments_from_joint_angles(angles, np.array(lengths)).sum(axis=-2)

    expected, near = places(angles), CLOSE * sum(lengths)
    if np.abs(hands - expected).max() <= near:
        return lines
    ratio = float((hands * expected).sum() / (expected**2).sum())
    shift = (hands - expected).mean(axis=0)
    about = "where segment_lengths and joint_angles put it"
    if np.abs(hands - ratio * expected).max() <= near * abs(ratio):
        return [*lines, f"hand of see is {ratio:.3g} times {about}: check the units"]
    if np.abs(hands - expected - shift).max() <= near:
        at = shift.round(3).tolist()
        return [*lines, f"hand of see is {at} from {about}: the base is the origin"]
    for change, turned in {
        "absolute, and should be relative to the segment before": np.diff(angles, prepend=0),
        "in degrees, and should be in radians": np.radians(angles),
    }.items():
        if np.abs(hands - places(turned)).max() <= near:
            return [*lines, f"joint_angles of see are {change}"]
    farthest = np.linalg.norm(hands - expected, axis=-1).max()
    return [*lines, f"hand of see is up to {farthest:.3g} from {about}"]


def _action_space(
    contract: ReachInterface, env: gym.Env[Any, Any], sights: Sequence[Seen]
) -> list[str]:
    """Compare actions for far targets with the action space."""
    space = env.action_space
    if not isinstance(space, gym.spaces.Box):
        return []
    for seen, way in product(sights, (FAR_TURN, -FAR_TURN)):
        action = _action(contract, seen, contract.within_limits(seen.joint_angles + way))
        accepted = f"of shape {space.shape}, as the actions of env are"
        require(action.shape == space.shape, "what act returns", action.shape, accepted)
        beyond = np.abs(action - action.clip(space.low, space.high))
        place = np.unravel_index(beyond.argmax(), beyond.shape)
        if beyond[place] > 1e-6 * max(1, np.abs(action[place])):  # float32 rounds
            ends = f"{space.low[place]:.3g} to {space.high[place]:.3g}"
            return [f"what act returns, {action[place]:.3g}, is not of the action space, {ends}"]
    return []


def _limits(contract: ReachInterface, sights: Sequence[Seen]) -> list[str]:
    """Compare angles with the limits that the interface or its arm has."""
    limits, lines = contract.joint_limits, []
    if limits is None:
        limits = getattr(contract.arm, "limits", ())
    for joint, (low, high) in enumerate(limits):
        angles = np.array([seen.joint_angles[joint] for seen in sights])
        over = np.maximum(low - angles, angles - high)
        if over.max() > BEYOND:
            angle, turns = angles[over.argmax()], np.ceil(over.max() / (2 * np.pi))
            turned = angle + 2 * np.pi * turns * np.sign(low - angle)
            remedy = f": {turned:.3g} is the same" if low <= turned <= high else ""
            about = f"{angle:.3g} for joint {joint}, beyond its limits {low:.3g} and {high:.3g}"
            lines.append(f"joint_angles of see are {about}{remedy}")
    return lines


def _turns(
    contract: ReachInterface, env: gym.Env[Any, Any], seed: int, sights: list[Seen]
) -> list[str]:
    """Ask each joint to turn, and compare speeds with how fast angles change.

    What is seen meanwhile is added to `sights`.
    """
    lines, ratios = [], []
    for joint in range(len(contract.look(env.reset(seed=seed)[0]).joint_angles)):
        best = np.zeros(2)
        for side, way in enumerate((TURN, -TURN)):
            seen = start = contract.look(env.reset(seed=seed)[0])
            targets = start.joint_angles.copy()
            targets[joint] += way
            for _ in range(STEPS):
                before, (observation, *_) = seen, env.step(_action(contract, seen, targets))
                seen = contract.look(observation)
                sights.append(seen)
                change = wrap_angle(seen.joint_angles - before.joint_angles) / contract.control_step
                mean = (seen.joint_speeds + before.joint_speeds) / 2
                ratios += [(change @ mean, change @ change)]
                turned = wrap_angle(seen.joint_angles - start.joint_angles)[joint] / way
                best[side] = max(best[side], turned, key=abs)
        if best.max() < 0.3:
            which = "away from" if best.min() < -0.3 else "hardly toward"
            lines.append(f"act turns joint {joint} {which} its target")
    product, square = np.sum(ratios, axis=0)
    if square > 0 and not 0.5 < product / square < 2:
        ratio = f"{product / square:.3g} times the change of joint_angles per control_step"
        lines.append(f"joint_speeds of see are {ratio}, {contract.control_step:g} s")
    return lines
