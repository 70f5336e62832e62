"""Published values, computed from the data that were published with the paper.

Distances and velocities are normalized; the schedule is "delayed" unless one is named.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

from mmc_gym.network.model import Dynamics, Schedule

MeanAndDeviation: TypeAlias = "tuple[float, float]"


class PublishedErrors(NamedTuple):
    """Published errors of an architecture; means and standard deviations are of five runs.

    Attributes:
        validation: validation MSE after 400 epochs.
        training: training MSE after 400 epochs.
        angle_error: mean absolute angle error at lengths 0.9 to 1.1 of one network, degrees.
        text: validation MSE in the paper's text.
    """

    validation: MeanAndDeviation
    training: MeanAndDeviation
    angle_error: float
    text: float | None = None


# The MSEs are from the training histories published with the paper; the angle errors were measured
# on the networks published with it, one for each architecture.
NORMALIZATION_PUBLISHED: dict[str, PublishedErrors] = {
    "[2]": PublishedErrors((0.03399, 0.00012), (0.03013, 0.00003), 2.23),
    "[4]": PublishedErrors((0.01433, 0.00106), (0.01262, 0.00104), 3.34),
    "[8]": PublishedErrors((0.00552, 0.00068), (0.00452, 0.00061), 2.64),
    "[16]": PublishedErrors((0.00427, 0.00015), (0.00336, 0.00010), 0.62, text=0.0042),
    "[32]": PublishedErrors((0.00399, 0.00010), (0.00309, 0.00007), 0.76),
    "[64]": PublishedErrors((0.00399, 0.00022), (0.00313, 0.00018), 0.61),
    "[128]": PublishedErrors((0.00414, 0.00035), (0.00329, 0.00030), 0.74),
    "[2, 2]": PublishedErrors((0.01621, 0.00016), (0.01417, 0.00002), 4.02),
    "[4, 4]": PublishedErrors((0.00360, 0.00022), (0.00322, 0.00023), 1.55),
    "[8, 8]": PublishedErrors((0.00116, 0.00024), (0.00123, 0.00016), 0.43),
    "[16, 16]": PublishedErrors((0.00035, 0.00006), (0.00062, 0.00010), 0.25, text=0.0003),
    "[32, 32]": PublishedErrors((0.00030, 0.00009), (0.00059, 0.00005), 0.56),
}

KINEMATIC_PUBLISHED: dict[str, tuple[str, int]] = {
    "[2]": ("0.2715 ± 0.2685", 279),
    "[4]": ("0.4098 ± 0.3014", 395),
    "[8]": ("0.3634 ± 0.2791", 392),
    "[16]": ("0.0940 ± 0.1159", 135),
    "[32]": ("0.1070 ± 0.0889", 157),
    "[64]": ("0.0953 ± 0.1083", 122),
    "[128]": ("0.1165 ± 0.1197", 172),
    "[2, 2]": ("0.6151 ± 0.4262", 393),
    "[4, 4]": ("0.2663 ± 0.3137", 302),
    "[8, 8]": ("0.0696 ± 0.0735", 79),
    "[16, 16]": ("0.0458 ± 0.0658", 30),
    "[32, 32]": ("0.0806 ± 0.0901", 89),
    "Euclidean": ("0.0226 ± 0.0320", 7),
}
"""By normalizer (one trained network each): distance after 100 iterations; ends above 0.1."""

KINEMATIC_COURSE: dict[int, float] = {10: 0.42478, 20: 0.22386, 40: 0.09712, 100: 0.02264}
"""Mean distance with the Euclidean normalization, by iteration."""


class PublishedDynamics(NamedTuple):
    """Published results of one rule and decay (schedule "delayed").

    Attributes:
        distances: mean distance by iteration.
        deviation: standard deviation of the distance after 40 iterations.
        peak: height and iteration of the peak of the mean velocity.
        overshoots: number of the 420 movements that overshoot.
        second_peaks: number of those with a second velocity peak.
        example: distance after 40 iterations of the example movement.
        example_in_text: that distance in the paper's text.
    """

    distances: Mapping[int, float]
    deviation: float
    peak: str
    overshoots: int
    second_peaks: int
    example: str
    example_in_text: str | None = None


CLASSICAL_PUBLISHED = PublishedDynamics(
    {10: 0.405, 20: 0.213, 40: 0.0930}, 0.0856, "0.1082 at 2", 0, 16, "0.00977"
)
DYNAMIC_PUBLISHED: dict[tuple[Dynamics, float], PublishedDynamics] = {
    ("reference", 0.92): PublishedDynamics(
        {10: 0.611, 20: 0.280, 40: 0.1412}, 0.1180, "0.0599 at 9", 34, 137, "0.0251", "0.025"
    ),
    ("reference", 1.0): PublishedDynamics(
        {10: 0.523, 20: 0.224, 40: 0.0899}, 0.0830, "0.0820 at 9", 155, 247, "0.0300", "0.030"
    ),
    ("paper", 0.92): PublishedDynamics(
        {10: 0.544, 20: 0.247, 40: 0.1253}, 0.1113, "0.0686 at 8", 37, 111, "0.0270"
    ),
    ("paper", 1.0): PublishedDynamics(
        {10: 0.483, 20: 0.214, 40: 0.0921}, 0.0880, "0.0846 at 8", 122, 215, "0.0115"
    ),
}
DYNAMIC_EUCLIDEAN: dict[tuple[Dynamics, float, Schedule], dict[int, float]] = {
    ("reference", 0.92, "delayed"): {10: 0.59338, 20: 0.26474, 40: 0.12478},
    ("reference", 1.0, "delayed"): {10: 0.51373, 20: 0.22146, 40: 0.07740},
    ("paper", 0.92, "delayed"): {10: 0.52885, 20: 0.23581, 40: 0.10964},
    ("paper", 1.0, "delayed"): {10: 0.47481, 20: 0.20799, 40: 0.07741},
    ("paper", 0.92, "synchronous"): {10: 0.48200, 20: 0.22089, 40: 0.09736},
    ("reference", 0.92, "synchronous"): {10: 0.54623, 20: 0.24937, 40: 0.11499},
}
"""Mean distances with the Euclidean normalization; without learned weights, ours must be equal."""


class Point(NamedTuple):
    """A subject: what the paper says about it, and what the published data show."""

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
