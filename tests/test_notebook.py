"""What a notebook shows of episodes and networks; figures of movements."""

import matplotlib.figure
import numpy as np
import pytest

import mmc_gym
from mmc_gym._plotting import PlottedMovement, paths_and_profiles
from mmc_gym.network import MMCNetwork


def test_an_episode_says_what_it_is(env):
    (episode,) = mmc_gym.run_episodes(mmc_gym.make_agent("mmc", env), env, [5])
    assert repr(episode) == "<Episode of seed 5, 100 steps, 0.000 from the target at the end>"


def test_the_movement_of_a_network_can_be_drawn():
    network = MMCNetwork()
    start = network.state_from_joint_angles([0.3, 0.6, 0.6])
    way = network.trajectory(start, network.inverse([-1.0, 1.5]), 60)
    figure = way.plot()
    (axes,) = figure.axes
    lines = [line.get_xydata() for line in axes.lines]
    np.testing.assert_allclose(lines[0][1:], np.cumsum(way.segments[0], axis=0))
    assert any(len(line) == 60 and np.allclose(line, way.segments.sum(axis=1)) for line in lines)
    assert any(np.array_equal(line, [[-1.0, 1.5]]) for line in lines)
    assert figure._repr_png_().startswith(b"\x89PNG")
    # Of many networks the first four are drawn, on given axes.
    targets = np.random.default_rng(0).uniform(-1, 1, (2, 3, 2))
    axes = matplotlib.figure.Figure().add_subplot()
    figure = network.trajectory(start, network.inverse(targets), 5).plot(axes)
    assert figure is axes.figure
    crosses = [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "+"]
    np.testing.assert_array_equal(crosses, targets.reshape(-1, 2)[:4])


def draw(names):
    """Draw three movements of each agent, each faster than the one before."""
    times = 0.02 * np.arange(101)
    speeds = [factor * np.sin(np.linspace(0, np.pi, 100)) for factor in (1, 2, 3)]
    hands = [np.stack([times * number, 0 * times], axis=-1) for number in (1, 2, 3)]
    movements = [*map(PlottedMovement, hands, np.ones((3, 2)), speeds)]
    agents = dict.fromkeys(names, movements)
    return movements, paths_and_profiles(agents, reach=3.0, tolerance=0.05, control_step=0.02)


def test_paths_differ_without_colour_and_the_profile_is_their_median_speed():
    movements, figure = draw(["oracle", "frozen"])
    above, _, below, _ = figure.axes
    paths = [line for line in above.lines if len(line.get_xdata()) > 1]
    assert len({line.get_linestyle() for line in paths}) == 3
    assert [text.get_text() for text in above.texts] == ["1", "2", "3"]
    assert np.array_equal(paths[0].get_xydata(), movements[0].hands)
    (line,) = below.lines
    assert line.get_xdata() == pytest.approx(0.01 + 0.02 * np.arange(100))
    assert line.get_ydata() == pytest.approx(movements[1].speeds)


def test_at_most_six_agents_are_side_by_side_at_one_scale():
    names = [f"agent {number}" for number in range(10)]
    _, figure = draw(names)
    assert figure.get_figwidth() * 150 < 1400
    shown = [axes for axes in figure.axes if axes.axison]
    above = [axes for axes in shown if axes.get_title()]
    assert [axes.get_title() for axes in above] == names
    tops = [axes.get_position().y0 for axes in above]
    assert tops[:5] == pytest.approx([tops[0]] * 5) and max(tops[5:]) < min(tops[:5])
    assert len({axes.get_ylim() for axes in shown if not axes.get_title()}) == 1
