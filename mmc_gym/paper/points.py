"""Seven points on which the paper's text and the data published with it part.

The data were re-measured from the files that the paper's author published with it.  What is
measured here comes from the experiments (`Result.points`).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """A statement of the paper and what its data give.

    Attributes:
        subject: what it is about.
        paper: what the text says, and where.
        data: what the published data give.
    """

    subject: str
    paper: str
    data: str


POINTS: dict[int, Point] = {
    1: Point(
        "When the dynamic network catches up with the classical one",
        "“caught up after around 10 iterations” (Sect. Results, Dynamics)",
        "decay 0.92: not within 40 iterations, where the distances have the ratio 1.5; "
        "decay 1: at iteration 29",
    ),
    2: Point(
        "Overshoot with velocity decay 0.92",
        "“there was no overshoot” (Sect. Results, Dynamics; said of the example movement)",
        "34 of 420 movements overshoot (their distance rises more than 0.01 above its minimum "
        "so far)",
    ),
    3: Point(
        "Running the network longer",
        "“the result is not further improving when letting the network run for a longer time” "
        "(Sect. Results, MMC network)",
        "so with learned normalizers, which have a floor; with the Euclidean normalization the "
        "mean distance falls from 0.0226 at 100 iterations to 0.0028 at 500",
    ),
    4: Point(
        "Distance of the neural network from the classical solution",
        "two hidden layers come “close to the performance of the exact classical solution” "
        "(Sect. Results, MMC network)",
        "final distance, as a multiple of the classical network's: [16, 16] 2.0, [16] 4.2",
    ),
    5: Point(
        "Shape of the velocity profile",
        "“a nice bell-shaped velocity profile” (Sect. Results, Dynamics)",
        "so for the mean over all movements; in single movements (targets at radius 1 and 2) peak "
        "over mean is 3.4 and time to peak 0 for the classical network, 2.6 and 0.15 for the "
        "dynamic one; a minimum-jerk movement has 1.875 and 0.5",
    ),
    6: Point(
        "The velocity equation, and what an iteration reads",
        "v = 1/d_v (L̃ − L) + decay (d_v − 1)/d_v v (Eq. 3), every variable from the values of "
        "the iteration before (Eq. 2)",
        "made with v = decay ((L̃ − L) + d_v v)/(d_v + 1); the triangles read the segments of one "
        "iteration before those that the self term reads",
    ),
    7: Point(
        "Which networks the figures show",
        "the vector field is of a network with eight hidden units (caption), the hidden units of "
        "networks with 4 and 8",
        "the vector field is of the network with 16 hidden units; the hidden units in three "
        "dimensions are of an [8, 8] network trained with weight decay 0.0005",
    ),
}
