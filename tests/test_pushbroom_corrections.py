"""The corrections against physics written a second time: relativity, a turning Earth, bisection.

The reference takes position and attitude from the interpolants, not the tables; aberration is
the exact Lorentz transformation in an inertial frame; the ground point is where the photon left
the Earth as it was turned at t − range / c; heights are exact, in extended precision.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import JITTERED, Grid, Scene, build

from geoposition.constants import EARTH_RATE_RAD_S, SPEED_OF_LIGHT_M_S, WGS84_A_M, WGS84_E2
from geoposition.corrections import ALL_CORRECTIONS, NO_CORRECTIONS, Corrections, Refraction
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ArgumentError
from geoposition.flags import Flag

EXTENDED = np.longdouble
VACUUM = Corrections(velocity_aberration=True, light_time=True, refraction=None)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.sqrt(np.sum(v * v, axis=-1, keepdims=True))


def height_and_normal(ecef: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Geodetic height and normal by fixed point in the latitude, to extended rounding."""
    p = np.hypot(ecef[..., 0], ecef[..., 1])
    z = ecef[..., 2]
    tan = z / (p * (1 - EXTENDED(WGS84_E2)))
    for _ in range(12):
        radius = WGS84_A_M * np.sqrt(1 + tan**2) / np.sqrt(1 + (1 - EXTENDED(WGS84_E2)) * tan**2)
        tan = (z + EXTENDED(WGS84_E2) * radius * tan / np.sqrt(1 + tan**2)) / p
    cos = 1 / np.sqrt(1 + tan**2)
    sin = tan * cos
    normal = np.stack([cos * ecef[..., 0] / p, cos * ecef[..., 1] / p, sin], axis=-1)
    height = cos * p + sin * z - WGS84_A_M * np.sqrt(1 - EXTENDED(WGS84_E2) * sin**2)
    return height, normal


def turn_z(angle: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Components in a frame turned by `angle` about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack(
        [c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0], v[..., 2]], axis=-1
    )


def camera_pose(scene: Scene, line: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Perspective centre, its Earth-fixed velocity by differences, matrix R_ecef_camera."""
    camera, step = scene.camera, 1e-3

    def centre(t: np.ndarray) -> np.ndarray:
        arm = scene.attitude.rotation(t).apply(np.array(camera.lever_arm_body_m))
        return scene.ephemeris.position_m(t) + arm

    t = camera.timing.time_s(line)
    velocity = (centre(t + step) - centre(t - step)) / (2 * step)
    rotation = scene.attitude.rotation(t) * camera.R_body_camera
    return centre(t), velocity, rotation.as_matrix()


def reference(scene: Scene, grid: Grid) -> np.ndarray:
    """Ground points, ECEF (n, 3), with the corrections of `scene`, in extended precision."""
    line, sample = grid.image_px[:, 0], grid.image_px[:, 1]
    centre, velocity, matrix = (a.astype(EXTENDED) for a in camera_pose(scene, line))
    ends = [d.last_sample + 0.5 for d in scene.camera.detectors[:-1]]
    number = np.searchsorted(ends, sample, side="right")
    tangents = np.empty((len(line), 2), dtype=EXTENDED)
    for i in range(len(scene.camera.detectors)):
        tangents[number == i] = scene.camera.tangents(i, sample[number == i])
    apparent = unit(
        np.einsum("nij,nj->ni", matrix, np.concatenate([tangents, np.ones((len(line), 1))], axis=1))
    )
    # The inertial frame has the Earth-fixed axes of the instant of exposure.
    omega = np.array([0, 0, EARTH_RATE_RAD_S], dtype=EXTENDED)
    beta = (velocity + np.cross(omega, centre)) / SPEED_OF_LIGHT_M_S
    if not scene.corrections.velocity_aberration:
        beta = 0 * beta
    gamma = 1 / np.sqrt(1 - np.sum(beta * beta, axis=-1, keepdims=True))
    along = np.sum(apparent * beta, axis=-1, keepdims=True)
    inertial = apparent / gamma - beta + gamma / (gamma + 1) * along * beta
    inertial /= 1 - along
    assert np.abs(np.sum(inertial**2, axis=-1) - 1).max() < 1e-14

    def photon(distance: np.ndarray) -> np.ndarray:
        at = centre + distance[:, None] * inertial
        if not scene.corrections.light_time:
            return at
        # At emission the Earth was turned back by omega range / c.
        return turn_z(-EARTH_RATE_RAD_S * distance / SPEED_OF_LIGHT_M_S, at)

    # Bisection between the camera and the point nearest to the Earth's centre.
    low = np.zeros(len(line), dtype=EXTENDED)
    high = -np.sum(centre * inertial, axis=-1)
    for _ in range(75):
        middle = 0.5 * (low + high)
        above = height_and_normal(photon(middle))[0] > grid.height_m
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    ground = photon(low)
    refraction = scene.corrections.refraction
    if refraction is None:
        return ground
    _, normal = height_and_normal(ground)
    sight = unit(centre - ground)
    cos_z = np.sum(sight * normal, axis=-1, keepdims=True)
    level = sight - cos_z * normal
    sin_z = np.sqrt(np.sum(level**2, axis=-1, keepdims=True))
    shift = refraction.refractivity * refraction.scale_height_m
    shift = shift * np.exp(-grid.height_m[:, None] / refraction.scale_height_m) * sin_z / cos_z**3
    moved = ground + shift * level / np.maximum(sin_z, EXTENDED(1e-30))
    for _ in range(4):
        height, normal = height_and_normal(moved)
        moved = moved - (height - grid.height_m)[:, None] * normal
    return moved


def model_ecef(scene: Scene, grid: Grid) -> np.ndarray:
    located = scene.model().image_to_ground(grid.image_px, grid.height_m)
    assert np.all(located.flag <= Flag.OUTSIDE_IMAGE)
    return geodetic_to_ecef(located.geodetic)


def miss_m(scene: Scene, n: int = 7) -> float:
    grid = scene.grid(n, margin=60)
    gap = (model_ecef(scene, grid) - reference(scene, grid)).astype(float)
    return float(np.linalg.norm(gap, axis=-1).max())


SCENES = {
    "nadir": build(),
    "roll 35": build(roll_deg=35.0, pitch_deg=10.0, yaw_deg=20.0),
    "roll 55": build(roll_deg=-55.0),
    "reverse": build(timing="reverse", roll_deg=-20.0, camera="collinear"),
    "jitter": build(jitter=JITTERED, attitude_step_s=1e-3, timing="table", camera="table"),
}


@pytest.mark.parametrize("name", SCENES)
def test_bare_geometry_is_exact(name: str) -> None:
    # Tables, kernels and the height surface alone: what is left is rounding.
    assert miss_m(SCENES[name].with_corrections(NO_CORRECTIONS)) < 1e-7


@pytest.mark.parametrize("name", SCENES)
def test_vacuum_physics(name: str) -> None:
    # The formula is of first order in beta = v/c = 2.5e-5. Neglected is beta^2 / 4 sin 2a, with a
    # between the velocity and the line of sight: 3e-11 rad where that lies 10 degrees ahead of
    # the perpendicular, 0.1 mm from 900 km with the slant on the ground; without pitch, nothing.
    assert miss_m(SCENES[name].with_corrections(VACUUM)) < (2e-4 if name == "roll 35" else 1e-6)


def test_neglected_second_order_at_large_pitch() -> None:
    # beta^2 / 4 sin 2a = 1.1e-10 rad, from 840 km, slanted by 45 degrees.
    assert 1e-5 < miss_m(build(pitch_deg=40.0, corrections=VACUUM), 3) < 4e-4


@pytest.mark.parametrize("part", ["velocity_aberration", "light_time"])
def test_each_alone(part: str) -> None:
    scene = SCENES["roll 35"].with_corrections(replace(NO_CORRECTIONS, **{part: True}))
    assert miss_m(scene) < 2e-4
    bare = SCENES["roll 35"].with_corrections(NO_CORRECTIONS)
    grid = scene.grid(5)
    effect = np.linalg.norm(model_ecef(scene, grid) - model_ecef(bare, grid), axis=-1)
    # 20 m at 700 km for aberration; the Earth turns by 465 m/s cos(latitude) x 2.4 ms or more.
    low, high = (15.0, 40.0) if part == "velocity_aberration" else (0.6, 1.5)
    assert low < effect.min() < effect.max() < high


@pytest.mark.parametrize("name", SCENES)
def test_refraction_formula(name: str) -> None:
    scene = SCENES[name].with_corrections(Corrections(refraction=Refraction()))
    assert miss_m(scene) < 1e-6


@pytest.mark.parametrize("name", SCENES)
def test_all_together(name: str) -> None:
    assert miss_m(SCENES[name]) < (2e-4 if name == "roll 35" else 2e-6)


def test_refraction_moves_towards_the_satellite_by_the_known_amount() -> None:
    # An atmosphere of 2.77e-4 x 8435 m bends a ray at 45 degrees by 2.3364 m x sin z / cos^3 z.
    scene = SCENES["roll 35"].with_corrections(Corrections(refraction=Refraction()))
    bare = scene.with_corrections(NO_CORRECTIONS)
    grid = Grid(np.array([[1000.0, 750.0]]), np.array([0.0]))
    straight, bent = model_ecef(bare, grid), model_ecef(scene, grid)
    centre = camera_pose(scene, grid.image_px[:, 0])[0]
    _, normal = height_and_normal(straight.astype(EXTENDED))
    sight = unit(centre - straight)
    cos_z = float(np.sum(sight * normal))
    shift = 2.77e-4 * 8435.0 * np.sqrt(1 - cos_z**2) / cos_z**3
    assert np.linalg.norm(bent - straight) == pytest.approx(shift, rel=1e-4)
    assert np.linalg.norm(bent - centre) < np.linalg.norm(straight - centre)


def test_refraction_against_ray_tracing() -> None:
    # Snell's law through the exponential atmosphere of a flat Earth, n cos(elevation) constant,
    # integrated from the ground up: the offset of the outgoing asymptote along the ground.
    refraction = Refraction()
    heights = np.linspace(0, 200e3, 400_001)
    index = 1 + refraction.refractivity * np.exp(-heights / refraction.scale_height_m)
    for zenith_deg in (20.0, 45.0, 60.0):
        sin_z = np.sin(np.deg2rad(zenith_deg))
        # In vacuum the ray has sin z; below, by Snell, sin z / n.
        tan_inside = sin_z / index / np.sqrt(1 - (sin_z / index) ** 2)
        tan_outside = np.tan(np.deg2rad(zenith_deg))
        shift = np.trapezoid(tan_outside - tan_inside, heights)
        z = np.deg2rad(zenith_deg)
        formula = refraction.refractivity * refraction.scale_height_m * sin_z / np.cos(z) ** 3
        assert shift == pytest.approx(formula, rel=2e-3)


def test_height_dependence_of_refraction() -> None:
    scene = SCENES["roll 35"].with_corrections(Corrections(refraction=Refraction()))
    bare = scene.with_corrections(NO_CORRECTIONS)
    px = np.array([[1000.0, 750.0]] * 2)
    grid = Grid(px, np.array([0.0, 8435.0]))
    shift = np.linalg.norm(model_ecef(scene, grid) - model_ecef(bare, grid), axis=-1)
    assert shift[1] / shift[0] == pytest.approx(np.exp(-1.0), rel=5e-3)


def test_describe_names_all() -> None:
    assert ALL_CORRECTIONS.describe() == {
        "velocity_aberration": True,
        "light_time": True,
        "refraction": {"refractivity": 2.77e-4, "scale_height_m": 8435.0},
    }
    assert NO_CORRECTIONS.describe() == {
        "velocity_aberration": False,
        "light_time": False,
        "refraction": False,
    }


@pytest.mark.parametrize(
    ("refractivity", "scale_height_m"),
    [(np.nan, 8435.0), (2.77e-4, 0.0), (2.77e-4, -1.0), (2.77e-4, np.inf), (-1e-4, 8435.0)],
)
def test_nonsense_atmosphere_is_refused(refractivity: float, scale_height_m: float) -> None:
    with pytest.raises(ArgumentError):
        Refraction(refractivity, scale_height_m)
