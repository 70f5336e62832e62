"""Facts about cursors that stand for the hand: clamped to a direction, or jumping in flight."""

import math

import numpy as np
import pytest

from mmc_gym._errors import UserError
from mmc_gym.agents import make_agent
from mmc_gym.envs.perturbations import CursorJump, ErrorClamp
from mmc_gym.envs.reach import MMCReachEnv
from mmc_gym.envs.vector import MMCReachVectorEnv

Points = tuple[np.ndarray, np.ndarray, np.ndarray]


def movement(perturbation: str, trial: int) -> Points:
    """Offsets of hand and cursor from the start, and of the target, in a centre-out trial."""
    env = MMCReachEnv(task="centre-out", perturbations=[perturbation])
    agent, state = make_agent("mmc", env), None
    observation, info = env.reset(seed=0, options={"trial": trial})
    start, infos = info["end_effector"], [info]
    for _ in range(40):
        action, state = agent.predict(observation, state)
        observation, *_, info = env.step(action)
        infos.append(info)
    hands, cursors = (np.array([one[name] for one in infos]) for name in ("end_effector", "cursor"))
    return hands - start, cursors - start, info["target"] - start


@pytest.mark.parametrize("trial", [0, 3])
def test_a_clamped_cursor_keeps_its_direction_and_follows_the_hand_in_distance(trial: int) -> None:
    hands, cursors, target = movement("clamp-20", trial)
    assert np.hypot(*cursors.T) == pytest.approx(np.hypot(*hands.T))
    turns = (cursors @ (target[0] - 1j * target[1], target[1] + 1j * target[0]))[5:]
    assert np.degrees(np.angle(turns)) == pytest.approx(20.0)


def test_a_cursor_jumps_to_the_left_once_the_hand_has_made_a_share_of_the_way() -> None:
    hands, cursors, target = movement("cursor-jump-10", 3)
    has_jumped = hands @ target >= 0.25 * target @ target
    assert 0 < has_jumped.sum() < len(hands)
    assert cursors[~has_jumped] == pytest.approx(hands[~has_jumped], abs=1e-12)
    left = np.array([-target[1], target[0]])
    assert cursors[has_jumped] - hands[has_jumped] == pytest.approx(
        np.tile(0.1 * left, (has_jumped.sum(), 1))
    )


@pytest.mark.parametrize("name", ["clamp-15", "cursor-jump-10"])
@pytest.mark.parametrize("task", ["random", "centre-out", "double-step-100"])
def test_many_arms_see_the_cursors_that_single_arms_see(name: str, task: str) -> None:
    arguments = {"task": task, "perturbations": [name]}
    single = MMCReachEnv(**arguments)
    many = MMCReachVectorEnv(2, **arguments)
    seen, _ = many.reset(seed=[3, 4])
    assert np.array_equal(single.reset(seed=4)[0], seen[1])
    for step in range(12):
        action = np.full((2, 3), math.sin(step), np.float32)
        seen, _, _, _, infos = many.step(action)
        expected, _, _, _, info = single.step(action[1])
        assert np.array_equal(expected, seen[1])
        assert np.array_equal(info["cursor"], infos["cursor"][1])


def test_a_cursor_at_a_target_that_waits_at_the_start_stays_there() -> None:
    assert ErrorClamp(15.0, (0.0, 1.0)).cursor(1.0, 1.0, (0.0, 1.0)) == (0.0, 1.0)
    assert CursorJump(10.0, 0.2, (0.0, 1.0)).cursor(1.0, 1.0, (0.0, 1.0)) == (1.0, 1.0)


def test_a_clamp_excludes_a_rotation() -> None:
    with pytest.raises(UserError, match="at most one rotation or other cursor"):
        MMCReachEnv(perturbations=["clamp-15", "rotation-30"])
