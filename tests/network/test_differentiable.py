"""The network in torch: its gradients, what it learns, and where its tensors are."""

import numpy as np
import pytest
import torch

from mmc_gym import UserError
from mmc_gym.network import LearnedNormalizer, MMCNetwork
from mmc_gym.network.differentiable import TorchNetwork


def twin(**arguments):
    """A network and its like in torch."""
    network = MMCNetwork((1.0, 0.7, 1.3), damping=5, **arguments)
    return network, TorchNetwork(network, dtype=torch.float64)


def doubles(*numbers):
    return torch.tensor(numbers, dtype=torch.float64, requires_grad=True)


@pytest.mark.parametrize("pairs", [[(0, 3)], [(0, 1), (1, 3)]], ids=["inverse", "mixed"])
def test_gradients_flow_through_iterations_to_all_that_they_depend_on(kind, normalizer, pairs):
    _, network = twin(normalizer=normalizer, **kind)
    network.requires_grad_(True)

    def end(angles, targets, *parameters):
        named = dict(zip(dict(network.named_parameters()), parameters, strict=True))
        state = network.state_from_joint_angles(angles)
        clamps = dict(zip(pairs, targets))
        state = torch.func.functional_call(network, named, (state, clamps, 3))
        return state.values, state.joint_angles

    angles, targets = doubles([0.3, 0.6, 0.9], [2.5, -2.0, 1.0]), doubles([[1.0, 0.9]], [[-1, 0.4]])
    parameters = tuple(network.parameters())
    assert torch.autograd.gradcheck(end, (angles, targets, *parameters), fast_mode=True)
    unused = ("velocity_damping", "velocity_decay") if kind["dynamics"] == "kinematic" else ()
    used = [tensor for name, tensor in network.named_parameters() if name not in unused]
    sum(tensor.sum() for tensor in end(angles, targets, *parameters)).backward()
    assert all(tensor.grad.abs().sum() > 0 for tensor in (angles, targets, *used))


def test_an_arm_that_was_bent_has_gradients_too():
    network = TorchNetwork(MMCNetwork(damping=4), dtype=torch.float64)
    angles, target = doubles([0.0, 0.0, 0.0], [0.3, 0.6, 0.6]), doubles(2.0, 0.0)
    state = network(network.state_from_joint_angles(angles), network.inverse(target), 300)
    torch.testing.assert_close(state.end_effector, target.expand(2, 2), atol=0.02, rtol=0)
    state.end_effector.square().sum().backward()
    assert torch.isfinite(angles.grad).all() and torch.isfinite(target.grad).all()


def test_the_network_of_numpy_comes_back_as_it_was(kind, normalizer):
    network, same = twin(normalizer=normalizer, **kind)
    back = same.to_numpy()
    for name in ("segment_lengths", "damping", "velocity_damping", "velocity_decay", *kind):
        assert getattr(back, name) == getattr(network, name)
    vectors = np.random.default_rng(0).normal(size=(5, 2))
    np.testing.assert_array_equal(back.normalizer(vectors), network.normalizer(vectors))


def test_a_learned_normalizer_learns_and_stays_odd_and_the_rest_learns_when_asked_to():
    assert not any(layer.requires_grad for layer in twin()[1].parameters())
    network = TorchNetwork(MMCNetwork(normalizer=LearnedNormalizer.shipped("accurate")))
    assert all(layer.requires_grad == (layer.ndim > 1) for layer in network.normalizer.parameters())
    network.damping.requires_grad_()
    optimizer = torch.optim.SGD(network.normalizer.parameters(), lr=0.1)
    state = network.state_from_joint_angles([0.3, 0.6, 0.6])
    network(state, network.inverse([1.0, 1.0]), 5).end_effector.sum().backward()
    assert network.damping.grad.abs() > 0 and network.segment_lengths.grad is None
    optimizer.step()
    learned = network.to_numpy().normalizer
    assert np.abs(learned.weights[0] - LearnedNormalizer.shipped().weights[0]).max() > 1e-4
    vectors = np.random.default_rng(0).normal(size=(50, 2))
    np.testing.assert_allclose(learned(-vectors), -learned(vectors), atol=1e-15)


def test_every_tensor_is_on_the_device_and_none_is_asked_for_its_value(kind, normalizer):
    """Tensors on "meta" have no values: asking for one is an error, as is one elsewhere."""
    described = MMCNetwork(normalizer=normalizer, **kind)
    network = TorchNetwork(described, device="meta").requires_grad_(True)
    angles, targets = torch.ones(5, 3, device="meta"), torch.ones(4, 1, 2, device="meta")
    state = network.state_from_joint_angles(angles)
    state = network(state, {(0, 3): targets, (1, 2): targets}, 3)
    (state.joint_angles.sum() + state.end_effector.sum()).backward()
    assert network.damping.grad.device.type == state.values.device.type == "meta"
    assert state.segments.shape == (4, 5, 3, 2)


def at_rest(network):
    return network.state_from_joint_angles([0.1, 0.2, 0.3])


def test_what_is_given_is_brought_to_the_module():
    network = TorchNetwork(device="cpu", dtype=torch.float32)
    state = network(at_rest(network), network.inverse(torch.ones(5, 2, dtype=torch.float64)))
    assert state.values.dtype == torch.float32 and state.segments.shape == (5, 3, 2)
    assert at_rest(network.double()).values.dtype == torch.float64


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda n: n.state_from_joint_angles("ab"), "joint_angles must .* 'ab'"),
        (lambda n: n(at_rest(twin(dynamics="paper")[1])), "TorchState"),
        (lambda n: n(at_rest(n), {(0, 3): [1.0]}), r"clamp \(0, 3\) .* shape"),
        (lambda n: n(at_rest(n), {(0, 1): torch.ones(3, 2), (0, 3): torch.ones(2, 2)}), "batch"),
        (lambda n: n.damping.data.fill_(1.0) and n.to_numpy(), r"damping .* 1\.0"),
        (lambda n: setattr(n, "normalizer", torch.nn.Tanh()) or n.to_numpy(), "the original one"),
    ],
)
def test_impossible_calls_are_refused(call, message):
    with pytest.raises(UserError, match=message):
        call(twin()[1])
