"""What bends or turns the line of sight: velocity aberration, light time, refraction.

Each is named and switchable; a product's reader sets what the product's maker used.

*Source.* Aberration and light time: the direction seen on board is that of the incoming light
in the moving frame. With S the camera, P the ground point, V the Earth-fixed velocity of the
camera and w the Earth's rotation, the true direction is u = unit(u_app − v / c), where
v = V + w x S (aberration alone), − w x P (light time alone), or V + w x (S − P) (both).
Refraction: the ground point lies nearer to the satellite's foot than the straight line says,
by (n0 − 1) H exp(−h / H) sin z / cos^3 z, for an exponential atmosphere of scale height H over
a flat Earth, z being the zenith angle of the satellite at the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

from geoposition.errors import ArgumentError


@dataclass(frozen=True, slots=True)
class Refraction:
    """Exponential atmosphere: `refractivity` n0 − 1 at the ellipsoid, `scale_height_m` H."""

    refractivity: float = 2.77e-4
    scale_height_m: float = 8435.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.refractivity < 0.1:
            raise ArgumentError(f"refraction: n0 - 1 in 0 .. 0.1 expected, {self.refractivity}")
        if not 0.0 < self.scale_height_m < 1e6:
            raise ArgumentError(f"refraction: scale height in m expected, {self.scale_height_m}")


@dataclass(frozen=True, slots=True)
class Corrections:
    """Which corrections the model applies to the camera's apparent directions."""

    velocity_aberration: bool = False
    light_time: bool = False
    refraction: Refraction | None = None

    def describe(self) -> dict[str, object]:
        """Corrections by name, for people and provenance."""
        refraction: object = False
        if self.refraction is not None:
            refraction = {
                "refractivity": self.refraction.refractivity,
                "scale_height_m": self.refraction.scale_height_m,
            }
        return {
            "velocity_aberration": self.velocity_aberration,
            "light_time": self.light_time,
            "refraction": refraction,
        }


NO_CORRECTIONS = Corrections()
"""For products whose attitude and look angles already contain everything."""

ALL_CORRECTIONS = Corrections(True, True, Refraction())
"""For products that describe the bare camera and its true attitude."""
