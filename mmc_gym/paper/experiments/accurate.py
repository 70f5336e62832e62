"""The normalization network bettered: one that turns vectors so little that the arm arrives.

Ships as the default beside the one trained by the paper's recipe; both are 2-16-16-2 tanh
networks f, and the MMC network is the same.  How it is trained: `network.fitting`.  Why: at rest
the free segments satisfy L̃ = L + e/d with e the sum of the triangles' contradictions (Eq. 2), and
L = f(L̃).  An f that turns vectors of length near 1 by ε leaves a contradiction of about d·ε, and
with it a distance of about 1.5·d·ε to the target.  The MSE over lengths in ]0, 2] says little
about ε.

The worst angle error over ]0, 3] is measured over lengths down to 10⁻⁶; below 90° an output never
points the wrong way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mmc_gym.network.chain import Floats
from mmc_gym.network.model import MMCNetwork
from mmc_gym.network.normalizers import (
    EuclideanNormalizer,
    LearnedNormalizer,
    Normalizer,
    angle_errors,
)
from mmc_gym.paper.experiment import Captioned, Result, Row, Settings, mean_and_deviation
from mmc_gym.paper.figures import look, make_panels, styled
from mmc_gym.paper.protocol import EUCLIDEAN, FAR, record_movements
from mmc_gym.paper.published import KINEMATIC_PUBLISHED, NORMALIZATION_PUBLISHED

NEAR_ONE: Floats = np.linspace(0.9, 1.1, 41)
"""Lengths at which an arm at rest asks for its segments, segment lengths."""

LENGTHS: Floats = np.concatenate([np.geomspace(1e-6, 0.05, 60), np.linspace(0.06, 3, 295)])
"""Lengths in ]0, 3], segment lengths."""

RECIPE = "paper's recipe"


class Measured(NamedTuple):
    """Errors of a normalizer alone, and its distances in the MMC network.

    Attributes:
        near_error: mean angle error at lengths 0.9 to 1.1, degrees.
        mean_error: mean angle error by length, at `LENGTHS`, degrees.
        worst_error: largest angle error by length, at `LENGTHS`, degrees.
        output_length: smallest and largest length of an output for inputs longer than 0.05.
        distance: normalized distance in the 420 movements, (420, 100).
    """

    near_error: float
    mean_error: Floats
    worst_error: Floats
    output_length: tuple[float, float]
    distance: Floats


def measure(normalizer: Normalizer, directions: int) -> Measured:
    """Measure a normalizer at so many directions on the circle."""
    errors = np.degrees(angle_errors(normalizer, LENGTHS, directions))
    angles = np.arange(directions) * (2 * np.pi / directions)
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    outputs = normalizer(LENGTHS[LENGTHS > 0.05, None, None] * unit)
    lengths = np.linalg.norm(outputs, axis=-1)
    network = MMCNetwork(normalizer=normalizer, schedule="delayed")
    return Measured(
        near_error=float(np.degrees(angle_errors(normalizer, NEAR_ONE, directions)).mean()),
        mean_error=errors.mean(axis=1),
        worst_error=errors.max(axis=1),
        output_length=(float(lengths.min()), float(lengths.max())),
        distance=record_movements(network).distance,
    )


def run(settings: Settings) -> Result:
    """Measure the shipped networks, accurate and by the paper's recipe, beside the Euclidean."""
    normalizers: dict[str, Normalizer] = {
        EUCLIDEAN: EuclideanNormalizer(),
        RECIPE: LearnedNormalizer.shipped("paper"),
        "accurate": LearnedNormalizer.shipped("accurate"),
    }
    directions = 720 if settings.quick else 3600
    measured = {
        name: measure(normalizers[name], directions) for name in settings.tracked([*normalizers])
    }
    errors = {
        f"{name}: {kind} [deg]": values
        for name, found in measured.items()
        for kind, values in (("mean", found.mean_error), ("worst", found.worst_error))
    }
    return Result(
        rows=_rows(measured),
        figures={
            "accurate": Captioned(
                draw_errors_and_distances(measured),
                "Left: angle error by length of the input, mean (line) and worst (thin) over all "
                "directions. Right: normalized distance to the target, mean over the 420 "
                "movements; the accurate network's curve lies on the Euclidean one.",
            )
        },
        data={
            "angle_errors": pd.DataFrame({"length": LENGTHS, **errors}),
            "distance": {name: found.distance for name, found in measured.items()},
        },
    )


def _rows(measured: Mapping[str, Measured]) -> list[Row]:
    exact = measured[EUCLIDEAN].distance[:, -1]
    angle_error = NORMALIZATION_PUBLISHED["[16, 16]"].angle_error
    final_distance, ending_far = KINEMATIC_PUBLISHED["[16, 16]"]
    note = "its data: the [16, 16] network of the paper"
    rows = []
    for name, (near, distance, ratio, far), notes in (
        (RECIPE, (angle_error, final_distance, 2.03, float(ending_far)), (note, note)),
        ("accurate", (None,) * 4, ("sought: at most 0.01", "sought: at most 1.02")),
    ):
        found = measured[name]
        final = found.distance[:, -1]
        rows += [
            Row(
                f"{name}: mean angle error at lengths 0.9 to 1.1",
                data=near,
                ours=found.near_error,
                unit="°",
                note=notes[0],
            ),
            Row(
                f"{name}: normalized distance after 100 iterations",
                data=distance,
                ours=mean_and_deviation(final, 5),
                note=f"Euclidean {mean_and_deviation(exact, 5)}",
            ),
            Row(
                f"{name}: the same, as a multiple of the Euclidean",
                data=ratio,
                ours=final.mean() / exact.mean(),
                note=notes[1],
            ),
            Row(
                f"{name}: movements that end above {FAR}",
                data=far,
                ours=float((final > FAR).sum()),
                note=f"of 420; Euclidean {(exact > FAR).sum()}",
            ),
            Row(
                f"{name}: worst angle error at lengths in ]0, 3]",
                ours=float(found.worst_error.max()),
                unit="°",
                note=f"at length {LENGTHS[found.worst_error.argmax()]:.2g}; below 90° no output "
                "points the wrong way",
            ),
            Row(
                f"{name}: lengths of the outputs for lengths in ]0.05, 3]",
                ours="{:.4f} to {:.4f}".format(*found.output_length),
                note="exact: 1",
            ),
        ]
    return rows


@styled
def draw_errors_and_distances(measured: Mapping[str, Measured]) -> Figure:
    """Draw the errors of all but the exact normalizer, and the distances of all."""
    figure, (left, right) = make_panels(2, 7.2, 3.2)
    for number, (name, found) in enumerate(measured.items()):
        style = look(number)
        width = 1.3
        if name == EUCLIDEAN:
            # Wide below, so that curves that coincide are both seen.
            style, width = style | {"color": "0.75"}, 3.5
        else:
            left.plot(
                LENGTHS,
                found.worst_error,
                color=style["color"],
                linewidth=0.6,
                label=f"{name}, worst",
            )
            left.plot(LENGTHS, found.mean_error, linewidth=1.5, label=f"{name}, mean", **style)
        mean = found.distance.mean(axis=0)
        right.plot(np.arange(1, len(mean) + 1), mean, linewidth=width, label=name, **style)
    left.set(yscale="log", xlim=(0, 3), xlabel="length of input [segment lengths]")
    left.set_ylabel("angle error [°]")
    right.set(yscale="log", xlabel="iteration", ylabel="normalized distance to target")
    for axes in (left, right):
        axes.legend(frameon=False)
    return figure
