"""What a notebook shows of environments and networks; figures of movements."""

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
    first, last = np.cumsum(way.segments[0], axis=0), np.cumsum(way.segments[-1], axis=0)
    np.testing.assert_allclose(lines[0][1:], first)
    assert any(np.allclose(line[1:], last) for line in lines if line.shape == (4, 2))
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


def movement(number, steps=100):
    speeds = np.sin(np.linspace(0, np.pi, steps)) * (1 + number)
    hands = np.stack([np.cumsum([0.0, *speeds]) * 0.02, np.full(steps + 1, 0.1 * number)], axis=-1)
    return PlottedMovement(hands, hands[-1] + 0.1, speeds)


def draw(movements):
    return paths_and_profiles(movements, reach=3.0, tolerance=0.05, control_step=0.02)


def test_paths_differ_without_colour_and_the_profile_is_their_median_speed():
    movements = {name: [movement(number) for number in range(3)] for name in ("oracle", "frozen")}
    above, _, below, _ = draw(movements).axes
    paths = [line for line in above.lines if len(line.get_xdata()) > 1]
    assert len({line.get_linestyle() for line in paths}) == 3
    assert [text.get_text() for text in above.texts] == ["1", "2", "3"]
    assert np.array_equal(paths[0].get_xydata(), movements["oracle"][0].hands)
    (line,) = below.lines
    assert line.get_xdata() == pytest.approx(0.01 + 0.02 * np.arange(100))
    assert line.get_ydata() == pytest.approx(movements["oracle"][1].speeds)


def test_at_most_six_agents_are_side_by_side_at_one_scale():
    ten = {f"agent {number}": [movement(number)] for number in range(10)}
    figure = draw(ten)
    assert figure.get_figwidth() * 150 < 1400
    shown = [axes for axes in figure.axes if axes.axison]
    above = [axes for axes in shown if axes.get_title()]
    assert [axes.get_title() for axes in above] == list(ten)
    tops = [axes.get_position().y0 for axes in above]
    assert tops[:5] == pytest.approx([tops[0]] * 5) and max(tops[5:]) < min(tops[:5])
    below = [axes for axes in shown if not axes.get_title()]
    assert len({axes.get_ylim() for axes in below}) == 1 and below[0].get_ylim()[1] >= 10
