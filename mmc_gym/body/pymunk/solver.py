"""What Chipmunk's solver needs to hold an arm together, and which arms it cannot.

In every physics step the solver sweeps over the joints, one after the other, and repeats that.  A
servo or a pivot acts on the two segments it joins as if they were alone; the sweeps pass it on to
the rest of the arm.  The heavier what hangs on a segment, measured by that segment, the more
sweeps it takes.
"""

from __future__ import annotations

from mmc_gym.body.parameters import ArmParameters

_SWEEPS_PER_RATIO = 10 / 27
_MOST_SWEEPS = 500  # a step of three segments then takes 0.1 ms instead of 0.01
_LARGEST_RATIO = _MOST_SWEEPS / _SWEEPS_PER_RATIO
_LARGEST_RATIO_OF_NEIGHBOURS = 100.0
_FEWEST_SWEEPS, _FEWEST_SWEEPS_FOR_LOCKS = 10, 60
_STRONG = 1e4  # rad/s that a servo could give a segment alone in a physics step


def solver_iterations(parameters: ArmParameters) -> int:
    """Sweeps of the solver in a physics step.

    With too few, an arm buzzes around its joint targets instead of coming to rest, and its pivots
    give way.  Three equal rods (a ratio of inertias of 27) need pymunk's 10; in random arms of two
    to five segments, four times lighter and heavier, the need was seen to grow in proportion to
    that ratio.  Servos out of all proportion to the segments need ten times as many.  A lock, which
    must bear whatever the servos and the other segments do, slips by 0.7 rad in 2 s of abrupt
    commands with 10 sweeps, and by less than 0.005 with 60.

    Raises:
        ValueError: if they would be too many.  Of 30,000 random arms of one to ten segments, with
            lengths and masses over six decades, pivots gaped by more than a twentieth of the reach
            only in such arms.
    """
    ratio = inertia_ratio(parameters)
    neighbours = inertia_ratio(parameters, among=2)
    if ratio > _LARGEST_RATIO and neighbours > _LARGEST_RATIO_OF_NEIGHBOURS:
        raise ValueError(
            "segment_lengths, segment_masses and hand_mass must make an arm that pymunk can hold "
            f"together: what hangs on a segment may have up to {_LARGEST_RATIO:.0f} times its "
            f"inertia, or the next segment up to {_LARGEST_RATIO_OF_NEIGHBOURS:.0f} times, "
            f"got {ratio:.3g} and {neighbours:.3g} times"
        )
    moments = [segment_inertia(parameters, index)[2] for index in range(len(parameters.masses))]
    strong = parameters.torque_limit * parameters.substep / min(moments) > _STRONG
    sweeps = _SWEEPS_PER_RATIO * min(ratio, _LARGEST_RATIO) * (10 if strong else 1)
    fewest = _FEWEST_SWEEPS_FOR_LOCKS if parameters.lockable_joints else _FEWEST_SWEEPS
    return min(max(fewest, round(sweeps)), 3 * _MOST_SWEEPS if strong else _MOST_SWEEPS)


def inertia_ratio(parameters: ArmParameters, among: int | None = None) -> float:
    """Largest ratio of what turns about a joint to what the solver turns: 27 for three equal rods.

    What turns about a joint is the stretched arm beyond it, or its next `among` segments.  The
    solver turns the first of them alone about its own centre of gravity: the ratio is to four
    times that moment, which is the inertia of a uniform rod about its end.
    """
    lengths, ratio = parameters.segment_lengths, 0.0
    segments = [segment_inertia(parameters, index) for index in range(len(lengths))]
    for joint, (_, _, own_moment) in enumerate(segments):
        inertia = start = 0.0
        beyond = slice(joint, None if among is None else joint + among)
        for length, (mass, centre, moment) in zip(lengths[beyond], segments[beyond]):
            inertia += moment + mass * (start + centre) ** 2
            start += length
        ratio = max(ratio, inertia / (4 * own_moment))
    return ratio


def segment_inertia(parameters: ArmParameters, index: int) -> tuple[float, float, float]:
    """Mass of a segment, how far its centre of gravity is from its joint, and moment about it."""
    mass, length = parameters.masses[index], parameters.segment_lengths[index]
    held = parameters.hand_mass if index == len(parameters.masses) - 1 else 0.0
    total = mass + held
    centre = length / 2 * (1 + held / total)
    return total, centre, mass * length**2 / 12 + mass * held / total * (length / 2) ** 2
