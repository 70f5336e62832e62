"""The MMC network: its algebra, its rules, batches, and the time base of its movements."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmc_gym import UserError
from mmc_gym.geometry import segments_from_joint_angles
from mmc_gym.network import LearnedNormalizer, MMCNetwork, MMCState, chain
from mmc_gym.network.chain import linear_operator
from mmc_gym.network.model import NO_CLAMPS
from mmc_gym.network.time_base import minimum_jerk, share, timed_step
from tests.conftest import by_night

counts = st.integers(2, 8)


def network_of(count, **settings):
    return MMCNetwork(segment_lengths=(1.0,) * count, **settings)


def random_segments(shape, seed=0):
    angles = np.random.default_rng(seed).uniform(-np.pi, np.pi, shape)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def random_targets(*shape):
    return np.random.default_rng(1).uniform(-2, 2, (*shape, 2))


def moved(network, segments, target, iterations):
    """The state after so many iterations from these segments towards the target."""
    state = network.state_from_segments(segments)
    return network.run(state, network.inverse(target), iterations)


def written_out(network, segments, clamped, iterations):
    """The equations of the paper as loops over nodes; returns the segments of each chain.

    `clamped` maps node pairs to vectors.  Independent of the package but for the normalizer.
    """
    count, d = len(network.segment_lengths), network.damping
    nodes = [sum(segments[:i], np.zeros(2)) for i in range(count + 1)]
    vectors = {(i, j): nodes[j] - nodes[i] for i in range(count) for j in range(i + 1, count + 1)}
    velocity = {pair: np.zeros(2) for pair in vectors}
    pending = {(i, i + 1): vectors[i, i + 1] for i in range(count)}
    delayed = network.schedule == "delayed"
    vectors.update(clamped)
    d_v, decay = network.velocity_damping, network.velocity_decay
    history = []

    def normalized(pair, vector):
        return network.normalizer(vector, network.segment_lengths[pair[0]])

    for _ in range(iterations):
        newest = dict(vectors)
        if delayed:
            newest.update({pair: normalized(pair, v) for pair, v in pending.items()})
            newest.update(clamped)

        def read(a, b, values=vectors):
            return values[a, b] if a < b else -values[b, a]

        following = {}
        for i, j in vectors:
            others = [k for k in range(count + 1) if k not in (i, j)]
            mean = sum(read(i, k) + read(k, j) for k in others) / d
            mean = mean + (d - len(others)) / d * newest[i, j]
            if j == i + 1 and network.dynamics != "kinematic":
                change = mean - newest[i, j]
                if network.dynamics == "paper":
                    v = change / d_v + decay * (d_v - 1) / d_v * velocity[i, j]
                else:
                    v = decay * (change + d_v * velocity[i, j]) / (d_v + 1)
                velocity[i, j] = v
                mean = newest[i, j] + v
            following[i, j] = mean
        for pair in pending:
            if delayed:
                pending[pair], following[pair] = following[pair], newest[pair]
            else:
                following[pair] = normalized(pair, following[pair])
        following.update(clamped)
        vectors = following
        history.append(np.array([vectors[i, i + 1] for i in range(count)]))
    return np.array(history)


@given(count=counts, excess=st.floats(0.01, 50))
def test_the_linear_core_is_the_identity_less_the_products_of_the_triangles(count, excess):
    damping = (count + 1) / 2 + excess
    core = linear_operator(network_of(count, damping=damping))
    incidence = chain.triangle_incidence(count)
    expected = np.eye(len(core)) - incidence @ incidence.T / damping
    np.testing.assert_allclose(core, expected, atol=1e-15)


@pytest.mark.parametrize("count", range(2, 9))
def test_with_the_end_effector_clamped_the_slowest_mode_has_eigenvalue_two(count):
    network = network_of(count)
    target = len(chain.vector_pairs(count)) - 1
    free = linear_operator(network, [target])[:target, :target]
    eigenvalues = np.sort(network.damping * (1 - np.linalg.eigvals(free).real))
    np.testing.assert_allclose(eigenvalues[: count - 1], 0, atol=1e-11)  # the consistent postures
    np.testing.assert_allclose(eigenvalues[count - 1], 2.0, atol=1e-11)


@pytest.mark.parametrize("count", by_night([2, 3, 5], daily=[3]))
def test_the_network_computes_the_equations_as_written(kind, count, normalizer, iterate):
    lengths = tuple(np.linspace(0.6, 1.4, count))
    settings = {"velocity_damping": 4, "velocity_decay": 0.9, "normalizer": normalizer, **kind}
    network = MMCNetwork(lengths, damping=count + 4, **settings)
    segments = random_segments(count) * np.array(network.segment_lengths)[:, None]
    for vectors in (
        {},
        {(0, count): np.array([0.4, 0.9])},
        {(i, i + 1): v for i, v in enumerate(random_segments(count, 1))},
        {(1, 2): np.array([0.0, 0.8]), (0, count): np.array([0.4, 0.9])},
    ):
        expected = written_out(network, segments, vectors, 12)
        state, clamps = network.state_from_segments(segments), network.clamp(vectors)
        for iterations in (1, 2, 12):
            iterated = iterate(network, state, clamps, iterations).segments
            np.testing.assert_allclose(iterated, expected[iterations - 1], atol=1e-12)


@pytest.mark.parametrize("task", ["inverse", "forward", "mixed"])
def test_every_task_ends_in_a_consistent_posture(kind, normalizer, task):
    lengths = (1.0, 0.7, 1.3, 0.9)
    network = MMCNetwork(lengths, normalizer=normalizer, **kind)
    goal = segments_from_joint_angles(np.array([0.2, 0.5, 0.4, 0.6]), lengths)
    clamps = {
        "inverse": network.inverse(goal.sum(axis=0)),
        "forward": network.forward(goal),
        "mixed": network.clamp({(0, 4): goal.sum(axis=0), (1, 2): goal[1]}),
    }[task]
    state = network.run(network.state_from_joint_angles([0.5, 0.3, 0.2, 0.3]), clamps, 1500)
    allowed = 5e-3 if isinstance(normalizer, LearnedNormalizer) else 1e-4
    np.testing.assert_allclose(np.linalg.norm(state.segments, axis=-1), lengths, rtol=allowed)
    np.testing.assert_allclose(state.vectors, chain.chain_vectors(state.segments), atol=allowed)
    np.testing.assert_allclose(state.end_effector, goal.sum(axis=0), atol=allowed)
    if task == "forward":
        np.testing.assert_array_equal(state.segments, goal)


def test_a_posture_that_satisfies_the_task_stays_and_a_target_out_of_reach_is_pointed_at(kind):
    network = MMCNetwork(**kind)
    state = network.state_from_joint_angles([0.3, 0.6, 0.6])
    later = network.run(state, network.inverse(state.end_effector), 50)
    np.testing.assert_allclose(later.values, state.values, atol=1e-14)
    far = network.run(state, network.inverse([-3.0, 4.0]), 1000)
    np.testing.assert_allclose(far.end_effector, [-1.8, 2.4], atol=1e-2)


def test_batches_have_any_axes_and_broadcast():
    network = MMCNetwork(schedule="delayed", dynamics="paper")
    segments, targets = random_segments((4, 1, 3)), random_targets(2, 1, 5)
    state = moved(network, segments, targets, 20)
    shapes = [array.shape for array in (state.vectors, state.joint_angles, state.end_effector)]
    assert shapes == [(2, 4, 5, 6, 2), (2, 4, 5, 3), (2, 4, 5, 2)]
    for index in np.ndindex(*state.batch_shape):
        alone = moved(network, segments[index[1], 0], targets[index[0], 0, index[2]], 20)
        np.testing.assert_array_equal(state.segments[index], alone.segments)


@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_an_arm_has_the_same_bits_in_any_batch(count, normalizer):
    network = MMCNetwork((1.0,) * count, normalizer=normalizer, dynamics="paper")
    timed = MMCNetwork((1.0,) * count, normalizer=normalizer)
    size = 2 * chain._BLOCK + 3
    segments, targets = random_segments((size, count)), random_targets(size)
    values = moved(network, segments, targets, 5).values
    rest = timed.state_from_segments(segments).values
    steps = timed_step(timed, MMCState(rest, count), targets, 0.1).values
    for part in (slice(1), slice(2), slice(3), slice(13), slice(-7, None)):
        part_values = moved(network, segments[part], targets[part], 5).values
        np.testing.assert_array_equal(part_values, values[..., part])
        step = timed_step(timed, MMCState(rest[..., part], count), targets[part], 0.1)
        np.testing.assert_array_equal(step.values, steps[..., part])


def test_single_precision_is_kept_and_close(normalizer, iterate):
    network = MMCNetwork(schedule="delayed", dynamics="reference", normalizer=normalizer)
    segments, targets = random_segments((6, 3)), np.ones((6, 2), np.float32)
    double = moved(network, segments, targets, 1)
    single = MMCState(double.values.astype(np.float32), 3)
    clamps = network.inverse(targets)
    end = iterate(network, single, clamps, 30)
    assert end.values.dtype == end.segments.dtype == np.float32
    np.testing.assert_allclose(end.values, network.run(double, clamps, 30).values, atol=1e-4)


def test_vectors_of_no_length_get_a_direction_too_and_an_empty_batch_stays_empty(iterate):
    network = MMCNetwork(segment_lengths=(1.0, 2.0, 0.5))
    state = network.state_from_segments(np.zeros((3, 2)))
    end = iterate(network, state, NO_CLAMPS, 3)
    np.testing.assert_allclose(end.values, network.run(state, iterations=3).values, atol=1e-12)
    empty = network.state_from_joint_angles(np.empty((0, 3)))
    assert iterate(network, empty, network.inverse([1.0, 1.0]), 3).batch_shape == (0,)


def test_nothing_that_is_passed_in_changes():
    network = MMCNetwork(schedule="delayed", dynamics="reference")
    segments, targets = random_segments((4, 3)), np.ones((4, 2))
    state, clamps = network.state_from_segments(segments), network.inverse(targets)
    arrays = segments, targets, state.values, clamps.values
    assert not np.shares_memory(clamps.values, targets)
    copies = [array.copy() for array in arrays]
    network.run(state, clamps, 3)
    network.trajectory(state, clamps, 3)
    for array, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("iterations", [0, 7])
@pytest.mark.parametrize("target", [None, [1.0, 1.5]])
def test_steps_one_by_one_are_a_run_and_a_trajectory(iterations, target):
    network = MMCNetwork(schedule="delayed", dynamics="paper")
    begin = network.state_from_segments(random_segments((4, 3)))
    clamps = NO_CLAMPS if target is None else network.inverse(target)
    state, postures = network.run(begin, clamps, 0), []
    for _ in range(iterations):
        state = network.step(state, clamps)
        postures.append(state.segments)
    last, trajectory = network.trajectory(begin, clamps, iterations)
    for end in (last, network.run(begin, clamps, iterations)):
        np.testing.assert_array_equal(end.values, state.values)
    np.testing.assert_array_equal(trajectory, np.reshape(postures, (iterations, 4, 3, 2)))


@pytest.mark.parametrize("bearing", [0.0, 0.7, 3.0])
def test_an_arm_in_one_line_with_its_target_gets_there(kind, bearing):
    network = MMCNetwork(damping=4, **kind)
    for joints, part in (([0, 0], 2.0), ([0, 0], -1.0), ([0, 0], 0.0), ([np.pi, np.pi], 2.0)):
        target = [part * np.cos(bearing), part * np.sin(bearing)]
        state = network.state_from_joint_angles([bearing, *joints])
        end = network.run(state, network.inverse(target), 300)
        np.testing.assert_allclose(end.end_effector, target, atol=0.02)


def test_no_other_arm_is_bent_in_numpy_or_torch(kind, iterate):
    network = MMCNetwork((1.5, 1.0, 0.3), damping=4, **kind)
    straight, folded, nearly = [0, 0, 0], [0, np.pi, 0], [0, 1e-6, 0]
    postures = [[0.7, 0, 0], straight, straight, folded, nearly, straight, [1, 2, 3]]
    targets = [[0, 0], [2.0, 0], [2.0, 1e-6], [0.9, 0], [2.0, 0], [4.0, 0], [1.0, 1.0]]
    state, clamps = network.state_from_joint_angles(postures), network.inverse(targets)
    start = iterate(network, state, clamps, 0)
    is_bent = (start.segments != state.segments).any(axis=(1, 2))
    np.testing.assert_array_equal(is_bent, [True, True, False, True, False, False, False])
    for iterations in (0, 40):
        end = iterate(network, state, clamps, iterations)
        expected = network.run(state, clamps, iterations)
        np.testing.assert_allclose(end.values, expected.values, atol=1e-12)


LONGER, PAPER = MMCNetwork((1.0,) * 4), MMCNetwork(dynamics="paper")
DELAYED = MMCNetwork(schedule="delayed")


def at_rest(network):
    return network.state_from_joint_angles([0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda n: MMCNetwork((1.0,)), "segment_lengths .* two or more"),
        (lambda n: MMCNetwork(damping=2.0), r"damping .* \(N \+ 1\) / 2 = 2"),
        (lambda n: MMCNetwork(normalizer="paper"), "normalizer .* 'paper'"),
        (lambda n: MMCNetwork(dynamics="paper", velocity_damping=0.5), "velocity_damping .* 0.5"),
        (lambda n: MMCNetwork(velocity_decay=1.1), "velocity_decay .* 1.1"),
        (lambda n: MMCNetwork(dampening=4), "did you mean 'damping'"),
        (lambda n: MMCNetwork(dynamics="dynamic"), "did you mean 'paper'"),
        (lambda n: n.inverse([1.0, 2.0, 3.0]), r"target .* \(3,\)"),
        (lambda n: n.inverse([np.nan, 1.0]), "target .* finite"),
        (lambda n: n.trajectory(at_rest(n), n.inverse([1, 1]), -1), "iterations .* -1"),
        (lambda n: n.clamp({(3, 0): [1, 1]}), r"clamp \(3, 0\) .* '\(0, 3\) with the opposite"),
        (lambda n: n.clamp([(0, 3)]), "vectors .* pairs of nodes"),
        (lambda n: n.clamp({(0, 1): np.ones((2, 2)), (0, 3): np.ones((3, 2))}), "batch axes"),
        (lambda n: n.step([0.3, 0.6, 0.6]), "state .* MMCState"),
        (lambda n: n.run(LONGER.state_from_joint_angles([0.0] * 4)), "state .* 3 segments"),
        (lambda n: DELAYED.run(at_rest(n)), "state .* 6 rows"),
        (lambda n: n.run(at_rest(n), [1.0, 1.0]), "clamps .* Clamps"),
        (lambda n: DELAYED.run(at_rest(DELAYED), n.clamp({(0, 1): [1, 0]})), "clamps .* 'delayed'"),
        (lambda n: moved(n, random_segments((2, 3)), np.ones((3, 2)), 1), "clamps .* batch axes"),
        (lambda n: timed_step(DELAYED, at_rest(DELAYED), [1, 1], 0.1), "network .* synchronous"),
        (lambda n: timed_step(PAPER, at_rest(PAPER), [1, 1], 0.1), "network .* kinematic"),
        (lambda n: timed_step(n, at_rest(n), [1, 1], 1.5), "share .* between 0 and 1"),
        (lambda n: share(1, np.inf), "duration .* finite"),
    ],
)
def test_an_impossible_network_or_call_is_refused(call, named):
    with pytest.raises(UserError, match=named):
        call(MMCNetwork())


NETWORK = MMCNetwork()
POSTURE = [0.3, 0.6, 0.6]
START = NETWORK.state_from_joint_angles(POSTURE)


@given(duration=st.floats(1, 500))
def test_taking_each_share_of_what_remains_follows_the_time_base(duration):
    iterations = np.arange(1, int(np.ceil(duration)) + 1)
    remaining = np.cumprod(1 - share(iterations, duration))
    np.testing.assert_allclose(1 - remaining, minimum_jerk(iterations / duration), atol=1e-9)


@pytest.mark.parametrize("part", [1e-4, 0.01, 0.1, 0.3])
def test_the_hand_takes_the_share_of_its_distance(normalizer, part):
    network = MMCNetwork(normalizer=normalizer)
    before = network.run(START, iterations=5)
    target = np.array([-1.0, 1.5])
    after = timed_step(network, before, target, part)
    step = np.linalg.norm(after.end_effector - before.end_effector)
    distance = np.linalg.norm(target - before.end_effector)
    assert step == pytest.approx(part * distance, rel=1e-3)


def test_no_share_is_no_movement_and_the_gain_is_bounded_whatever_the_network_s_own_damping():
    rest = timed_step(NETWORK, START, [-1.0, 1.5], 0.0)
    np.testing.assert_allclose(rest.segments, START.segments, atol=1e-15)
    # With all of the share the damping is (N + 3)/2, the least there is.
    fastest = timed_step(NETWORK, START, [-1.0, 1.5], 1.0)
    damped = MMCNetwork(damping=3.0)
    expected = damped.step(START, damped.inverse([-1.0, 1.5]))
    np.testing.assert_allclose(fastest.values, expected.values, atol=1e-14)
    same = timed_step(MMCNetwork(damping=4.0), START, [-1.0, 1.5], 1.0)
    np.testing.assert_array_equal(same.values, fastest.values)


def test_a_hand_that_does_not_get_anywhere_is_no_division_by_next_to_nothing():
    network = MMCNetwork((2.0, 0.5, 0.5))
    for angle in (0.0, 1e-160, 1e-20):
        state = network.state_from_joint_angles([0.0, angle, 0.0])
        for target in ([-3.0, 0.0], [2.0, 0.0], state.end_effector):
            with np.errstate(all="raise", under="ignore"):
                for _ in range(3):
                    state = timed_step(network, state, target, 1.0)
            assert np.isfinite(state.values).all()
