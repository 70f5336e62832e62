"""Kinds of networks, and what iterates them, behind one call."""

from itertools import product

import numpy as np
import pytest
import torch

from mmc_gym.network import EuclideanNormalizer, LearnedNormalizer, MMCNetwork, MMCState, chain
from mmc_gym.network.differentiable import TorchNetwork, TorchState

DYNAMICS = ("kinematic", "paper", "reference")


@pytest.fixture(params=list(product(DYNAMICS, ("synchronous", "delayed"))), ids="-".join)
def kind(request):
    """Arguments that make a network of every dynamics and schedule."""
    return dict(zip(("dynamics", "schedule"), request.param, strict=True))


@pytest.fixture(params=[EuclideanNormalizer(), LearnedNormalizer.shipped()], ids=repr)
def normalizer(request):
    return request.param


def iterate_torch(network, state, clamps, iterations):
    values = torch.from_numpy(state.values)
    twin = TorchNetwork(network, dtype=values.dtype)
    # Pending segments are held along with the segments.
    pairs = dict(enumerate(chain.vector_pairs(network.segment_count)))
    held = {
        pairs[row]: torch.from_numpy(np.moveaxis(value, 0, -1))
        for row, value in zip(clamps.rows, clamps.values)
        if row in pairs
    }
    with torch.no_grad():
        end = twin(TorchState(values, state.segment_count), held, iterations)
    return MMCState(end.values.numpy(), state.segment_count)


@pytest.fixture(params=[MMCNetwork.run, iterate_torch], ids=["numpy", "torch"])
def iterate(request):
    """A function of network, state, clamps and number of iterations."""
    return request.param
