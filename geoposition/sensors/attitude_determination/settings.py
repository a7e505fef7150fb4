"""What a fusion is told beside the telemetry: noise, priors, gyro model, gate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from geoposition.errors import ArgumentError
from geoposition.sensors.telemetry import GyroNoise

GyroModel: TypeAlias = Literal["bias", "general"]
"""6 states (attitude, bias: T 2.24) or 15 (and scale factors, six misalignments: T 2.26)."""


@dataclass(frozen=True, slots=True)
class FusionSettings:
    """Gyro noise, priors (standard deviations per axis) and the measurement gate.

    The attitude's prior is the first star fix with that sample's own noise, used once. A star
    sample whose normalised squared innovation exceeds the chi-squared quantile (3 degrees of
    freedom) of `gate_probability` is left out; None takes them all.
    """

    noise: GyroNoise
    model: GyroModel = "bias"
    bias_sigma_rad_s: float = 9.7e-6  # 2 deg/h
    scale_sigma: float = 2e-3
    misalignment_sigma: float = 2e-3
    gate_probability: float | None = None

    def __post_init__(self) -> None:
        values = (
            self.noise.angle_random_walk,
            self.noise.rate_random_walk,
            self.bias_sigma_rad_s,
            self.scale_sigma,
            self.misalignment_sigma,
        )
        if not all(0.0 <= value < float("inf") for value in values):
            raise ArgumentError("fusion: noise and priors expected, finite and not negative")
        if self.noise.angle_random_walk == 0.0:
            raise ArgumentError("fusion: the gyro's angle random walk must be positive")
        if self.model not in ("bias", "general"):
            raise ArgumentError(f"fusion: gyro model bias or general expected, got {self.model!r}")
        if self.gate_probability is not None and not 0.0 < self.gate_probability < 1.0:
            raise ArgumentError("fusion: a gate probability between 0 and 1 expected")

    @property
    def states(self) -> int:
        """Length of the error state."""
        return 6 if self.model == "bias" else 15
