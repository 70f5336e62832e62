import numpy as np
import pytest

from mmc_gym._plotting import PlottedMovement, paths_and_profiles


def movement(number, steps=100):
    speeds = np.sin(np.linspace(0, np.pi, steps)) * (1 + number)
    hands = np.stack([np.cumsum([0.0, *speeds]) * 0.02, np.full(steps + 1, 0.1 * number)], axis=-1)
    return PlottedMovement(hands, hands[-1] + 0.1, speeds)


@pytest.fixture
def movements():
    return {name: [movement(number) for number in range(3)] for name in ("oracle", "frozen")}


def draw(movements):
    return paths_and_profiles(movements, reach=3.0, tolerance=0.05, control_step=0.02)


def test_paths_are_told_apart_without_colour(movements):
    axes = draw(movements).axes[0]
    paths = [line for line in axes.lines if len(line.get_xdata()) > 1]
    assert len({line.get_linestyle() for line in paths}) == 3
    assert [text.get_text() for text in axes.texts] == ["1", "2", "3"]
    assert np.array_equal(paths[0].get_xydata(), movements["oracle"][0].hands)


def test_the_profile_is_the_median_speed_in_the_middle_of_the_steps(movements):
    (line,) = draw(movements).axes[2].lines
    assert line.get_xdata() == pytest.approx(0.01 + 0.02 * np.arange(100))
    assert line.get_ydata() == pytest.approx(movements["oracle"][1].speeds)


def test_at_most_six_agents_stand_side_by_side_at_one_scale():
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
