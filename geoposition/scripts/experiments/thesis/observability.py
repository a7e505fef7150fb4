"""What a pass tells of a gyro: at a constant rate nothing of scale factors and misalignments.

Three combinations of them act on each axis like a drift; only the sum with the drift is seen.
*Source*: T 5.2.2, figure 5.7.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.scripts.experiments.monte_carlo import without_noise
from geoposition.scripts.experiments.thesis_ch4 import (
    BIAS_SIGMA_RAD_S,
    GENERAL,
    TRUTH,
    scene,
    turning,
)
from geoposition.scripts.experiments.thesis_tables import PARAMETER_NAMES, parameter_vector
from geoposition.sensors.attitude_determination.filters.forward import run_forward
from geoposition.sensors.kinematics import RateCurve

ORBIT_RAD_S: Final = 2.0 * np.pi / 5680.0
"""A nadir-pointing body at 506 km turns once per revolution, about its pitch axis."""
SPAN_S: Final = 5400.0

_SEEN: Final = 0.5


@dataclass(frozen=True, slots=True)
class Observability:
    """Gyro parameters after 90 minutes: posterior over prior sigma, by motion.

    `rank` counts the combinations whose variance fell to less than half; `drift_deg_h` is the
    sigma of drift and of drift with all that acts like one.
    """

    motion: str
    sigma_ratio: dict[str, float]
    rank: int
    drift_deg_h: float
    effective_drift_deg_h: float


def nadir(t: FloatArray) -> FloatArray:
    """Body rate (..., 3) of a nadir-pointing satellite."""
    return np.broadcast_to(np.array([0.0, -ORBIT_RAD_S, 0.0]), (*np.shape(t), 3)).copy()


def observabilities() -> tuple[Observability, Observability]:
    """ZY-3's constant rate, and T 4.2.1's manoeuvre."""
    return _of("constant orbital rate", nadir), _of("manoeuvre of T 4.2.1", turning)


def _of(motion: str, rate: RateCurve) -> Observability:
    truth = parameter_vector(TRUTH)
    done = run_forward(without_noise(scene(rate, SPAN_S), TRUTH), GENERAL, truth)
    covariance = np.array(done.covariance[-1][3:, 3:])
    walk = GENERAL.noise.rate_random_walk * np.sqrt(SPAN_S)
    prior = np.repeat([np.hypot(BIAS_SIGMA_RAD_S, walk), 2e-3], (3, 9))
    scaled = covariance / np.outer(prior, prior)
    ratio = np.sqrt(np.diagonal(scaled))
    # The drift about Y with what scale and misalignment make of the rate about the axes.
    w = rate(np.zeros(()))
    acts = np.zeros(12)
    acts[1] = 1.0
    acts[[9, 4, 8]] = w[0], w[1], w[2]
    return Observability(
        motion,
        dict(zip((_plain(name) for name in PARAMETER_NAMES), ratio.tolist(), strict=True)),
        int(np.sum(np.linalg.eigvalsh(scaled) < _SEEN)),
        float(np.sqrt(covariance[1, 1]) * 180.0 / np.pi * 3600.0),
        float(np.sqrt(acts @ covariance @ acts) * 180.0 / np.pi * 3600.0),
    )


def _plain(name: str) -> str:
    return name.removesuffix("_deg_h").removesuffix("_ppm")
