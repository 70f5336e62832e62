"""The paper's example movement: from the starting posture to (−1.8, 1.8) in 40 iterations.

Drawn with the kinematic and the dynamic network, as in the paper's figures of it; the learned
normalizer is the first of the [16, 16] networks trained by the paper's recipe.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import find_peaks

from mmc_gym.network.model import MMCNetwork
from mmc_gym.network.normalizers import EuclideanNormalizer, Normalizer
from mmc_gym.paper.experiment import (
    Captioned,
    Result,
    Row,
    Settings,
    experiment,
    how_many,
    over_runs,
)
from mmc_gym.paper.figures import draw_postures, draw_profiles
from mmc_gym.paper.networks import trained_architectures
from mmc_gym.paper.protocol import SECOND_PEAK, Recording, record_example

CLASSICAL = "kinematic (Euclidean)"
NETWORKS: Mapping[str, MMCNetwork] = {
    CLASSICAL: MMCNetwork(schedule="delayed"),
    **{
        f"dynamic [16, 16], rule “{dynamics}”, decay {decay:g}": MMCNetwork(
            schedule="delayed", dynamics=dynamics, velocity_decay=decay
        )
        for dynamics in ("reference", "paper")
        for decay in (0.92, 1.0)
    },
}
PUBLISHED: Mapping[str, str] = dict(
    zip(NETWORKS, ("0.00977", "0.0251", "0.0300", "0.0270", "0.0115"), strict=True)
)
"""Normalized distance after 40 iterations."""

_IN_THE_TEXT: Mapping[str, str] = dict(zip(list(NETWORKS)[1:3], ("0.025", "0.030"), strict=True))


@experiment("example", "the example movement, kinematic and dynamic")
def run(settings: Settings) -> Result:
    """Make the example movement with every network."""
    hidden = trained_architectures(settings, ((16, 16),))["[16, 16]"].normalizers
    movements = {
        name: record_movement(network, [EuclideanNormalizer()] if name == CLASSICAL else hidden)
        for name, network in NETWORKS.items()
    }
    first = {name: recordings[0] for name, recordings in movements.items()}
    first["kinematic [16, 16]"] = record_example(replace(NETWORKS[CLASSICAL], normalizer=hidden[0]))
    _, decayed, undecayed, *_ = NETWORKS
    return Result(
        rows=[
            *(_row(name, recordings) for name, recordings in movements.items()),
            _second_peak_row(undecayed, movements[undecayed]),
        ],
        figures={
            "example_postures": Captioned(
                draw_postures(
                    {
                        CLASSICAL: first[CLASSICAL],
                        "kinematic [16, 16]": first["kinematic [16, 16]"],
                        "dynamic [16, 16], decay 0.92": first[decayed],
                    }
                ),
                "Example movement: a posture every two iterations, the hand as dots.",
            ),
            "example_velocity": Captioned(
                draw_profiles(
                    {
                        "": {
                            CLASSICAL: first[CLASSICAL].velocity,
                            "dynamic [16, 16], decay 0.92": first[decayed].velocity,
                            "dynamic [16, 16], decay 1": first[undecayed].velocity,
                        }
                    }
                ),
                "Velocity of the hand in the example movement: classical network, and dynamic "
                "network with and without velocity decay (rule “reference”).",
            ),
        },
        data={
            "example": {
                f"{part} {name}": getattr(recording, part)
                for name, recording in first.items()
                for part in ("segments", "distance", "velocity")
            }
        },
    )


def record_movement(network: MMCNetwork, normalizers: Sequence[Normalizer]) -> list[Recording]:
    """Record the example movement with each of the normalizers."""
    return [record_example(replace(network, normalizer=normalizer)) for normalizer in normalizers]


def _row(name: str, recordings: Sequence[Recording]) -> Row:
    return Row(
        f"{name}: distance after 40 iterations",
        paper=_IN_THE_TEXT.get(name),
        data=PUBLISHED[name],
        ours=over_runs([float(recording.distance[-1]) for recording in recordings], ".5f"),
        unit="of start to target",
        note=how_many(len(recordings)),
    )


def second_peak(velocity: ArrayLike) -> tuple[float, int] | None:
    """Return height and iteration, from 1, of the highest peak after the highest; None without.

    A peak stands out by more than 5 % of the highest velocity (`SECOND_PEAK`).

    >>> second_peak([0.1, 1.0, 0.2, 0.3, 0.1]), second_peak([0.1, 1.0, 0.2])
    ((0.3, 4), None)
    """
    velocity = np.asarray(velocity, dtype=np.float64)
    first = int(velocity.argmax())
    after = velocity[first:]
    peaks, _ = find_peaks(after, prominence=SECOND_PEAK * velocity[first])
    if not peaks.size:
        return None
    second = int(peaks[after[peaks].argmax()])
    return float(after[second]), first + second + 1


def _second_peak_row(name: str, recordings: Sequence[Recording]) -> Row:
    found = [second_peak(recording.velocity) for recording in recordings]
    return Row(
        f"{name}: second velocity peak, at iteration",
        data="0.0139 at 28",
        ours=", ".join(f"{peak[0]:.4f} at {peak[1]}" if peak else "none" for peak in found),
        unit="of start to target / iteration",
        note="each network" if len(found) > 1 else "",
    )
