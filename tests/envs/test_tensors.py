"""Tensors of torch share the memory of the vector environment's arrays."""

import gymnasium as gym
import numpy as np
import pytest
import torch

every_engine = pytest.mark.parametrize("engine", ["pymunk", "analytic"])


def made(engine, **arguments):
    return gym.make_vec("MMCReach-v0", 5, engine=engine, **arguments)


def seen_values(returned):
    """All arrays that `reset` or `step` hands out."""
    *arrays, infos = returned
    return [*arrays, *infos.values()]


@every_engine
def test_what_the_environment_hands_out_becomes_tensors_without_a_copy(engine):
    arms = made(engine)
    for returned in (arms.reset(seed=0), arms.step(np.zeros((5, 3), np.float32))):
        for array in seen_values(returned):
            tensor = torch.from_dlpack(array)
            assert tensor.data_ptr() == array.ctypes.data and tensor.is_contiguous()


def test_without_copies_one_tensor_shows_every_observation():
    arms = made("analytic", copy=False)
    observation, _ = arms.reset(seed=0)
    tensor = torch.from_dlpack(observation)
    before = tensor.clone()
    for _ in range(3):
        now, *_ = arms.step(torch.ones(5, 3))  # a tensor is an action like an array
        np.testing.assert_array_equal(tensor, now)
    assert (tensor != before).any()


def test_actions_that_need_a_gradient_are_refused_and_nothing_moves():
    arms = made("pymunk")
    observation, _ = arms.reset(seed=0)
    with pytest.raises(RuntimeError, match="detach"):
        arms.step(torch.zeros(5, 3, requires_grad=True))
    np.testing.assert_array_equal(arms.arms.joint_velocities, 0)
    np.testing.assert_allclose(np.cos(arms.arms.joint_angles), observation[:, :3], atol=1e-6)
