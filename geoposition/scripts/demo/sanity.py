"""What one arcsecond and one pixel are on the ground: sanity figures of the demo's scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geoposition.accuracy import point_statistics
from geoposition.arrays import FloatArray
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.demo.data import DemoOptions, Measured, Sensitivity
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.simulate import ARCSEC_RAD, SimulatedScene
from geoposition.triangulate import triangulate


def ground_sample_m(model: PushbroomModel) -> tuple[float, float]:
    """Metres a pixel along rows' and columns' counting, at the middle height.

    The median over the image: a step across the seam of two CCDs tells nothing of the size.
    """
    lines, samples = model.shape
    part = np.linspace(0.1, 0.9, 9)
    middle = np.stack(np.meshgrid(part * lines, part * samples), axis=-1).reshape(-1, 1, 2)
    steps = middle + np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
    ground = model.image_to_ground(steps, 0.5 * sum(model.height_range_m))
    ecef = geodetic_to_ecef(ground.geodetic)
    row = np.linalg.norm(ecef[:, 0] - ecef[:, 1], axis=-1)
    col = np.linalg.norm(ecef[:, 2] - ecef[:, 3], axis=-1)
    return float(np.nanmedian(row)), float(np.nanmedian(col))


def zenith_deg(model: PushbroomModel) -> float:
    """Zenith angle of the satellite, seen from the ground at the image's centre."""
    lines, samples = model.shape
    centre, height = [0.5 * (lines - 1), 0.5 * (samples - 1)], 0.5 * sum(model.height_range_m)
    up = enu_axes(model.image_to_ground(centre, height).geodetic)[:, 2]
    cosine = -float(np.dot(model.rays(centre, height).direction_ecef, up))
    return float(np.degrees(np.arccos(min(cosine, 1.0))))


def sensitivity(
    scene: SimulatedScene, points: Measured, options: DemoOptions
) -> tuple[Sensitivity, ...]:
    """Turn the nadir camera by 1" about each axis, the forward one in pitch, and look."""
    nadir = scene.true["nadir"]
    height = 0.5 * sum(nadir.height_range_m)
    lines, samples = nadir.shape
    centre = np.array([0.5 * (lines - 1), 0.5 * (samples - 1)])
    edge = np.array([0.5 * (lines - 1), 0.0])
    rays = nadir.rays(np.stack([centre, edge]), height)
    ground = geodetic_to_ecef(nadir.image_to_ground(np.stack([centre, edge]), height).geodetic)
    reach = np.linalg.norm(ground - rays.origin_ecef_m, axis=1)
    aside = float(np.linalg.norm(ground[1] - ground[0]))

    def moved(axis: str, pixel: FloatArray) -> float:
        turned = _turned(nadir, axis)
        there = geodetic_to_ecef(turned.image_to_ground(pixel, height).geodetic)
        here = geodetic_to_ecef(nadir.image_to_ground(pixel, height).geodetic)
        return float(np.linalg.norm(there - here))

    forward = {**scene.true, "forward": _turned(scene.true["forward"], "y")}
    pair = ("forward", "backward")
    exact = Measured(
        points.ids,
        points.geodetic,
        {name: scene.true[name].ground_to_image(points.geodetic).image_px for name in pair},
    )
    found = triangulate([forward[name] for name in pair], exact.ties(), options.image_sigma_px)
    up = point_statistics(found.geodetic, points.geodetic).u.mean
    return (
        Sensitivity("roll, on the ground", moved("x", centre), float(reach[0]) * ARCSEC_RAD),
        Sensitivity("pitch, on the ground", moved("y", centre), float(reach[0]) * ARCSEC_RAD),
        Sensitivity("yaw, at the image's edge", moved("z", edge), aside * ARCSEC_RAD),
        Sensitivity(
            "pitch of the forward camera, in the height from forward and backward",
            abs(up),
            _height_change_m(scene),
        ),
    )


def _turned(model: PushbroomModel, axis: str) -> PushbroomModel:
    camera = model.camera
    assert isinstance(camera, LineCamera)
    return replace(model, camera=camera.with_parameters({f"mounting_{axis}_rad": ARCSEC_RAD}))


def _height_change_m(scene: SimulatedScene) -> float:
    """R 1" cos(b) / sin(a + b) for rays at angles a, b to up, the forward one of range R.

    The forward ray turned by 1" passes the point at the distance R 1"; they meet again where the
    backward ray has gone R 1" / sin(a + b), of which cos(b) is up.
    """
    centre = geodetic_to_ecef(scene.centre_geodetic)
    up = centre / np.linalg.norm(centre)
    zenith, reach = {}, {}
    for name in ("forward", "backward"):
        model = scene.true[name]
        pixel = model.ground_to_image(scene.centre_geodetic).image_px
        rays = model.rays(pixel, scene.centre_geodetic[2])
        zenith[name] = float(np.arccos(-np.dot(rays.direction_ecef, up)))
        reach[name] = float(np.linalg.norm(centre - rays.origin_ecef_m))
    a, b = zenith["forward"], zenith["backward"]
    return float(reach["forward"] * ARCSEC_RAD * np.cos(b) / np.sin(a + b))
