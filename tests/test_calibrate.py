"""Camera calibration on known ground: planted look angles, mounting and attitude; the camera file.

Matches are simulated: where the true model puts ground points, with noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from field_scene import ALTITUDE_M, GSD_M, IFOV_RAD, LAT_RAD, LON_RAD
from scenes import Jitter, Orbit, Scene, build
from scipy.spatial.transform import Rotation

from geoposition.accuracy import enu_errors_m
from geoposition.adjust import adjust, adjusted_models, look_angles
from geoposition.arrays import FloatArray
from geoposition.calib_fields.calibrate import calibrate, check_scene
from geoposition.calib_fields.calibration import (
    ARCSEC_RAD,
    Calibration,
    CalibrationOptions,
    CalibrationScene,
)
from geoposition.calib_fields.camera_curves import camera_curves, turn_terms
from geoposition.calib_fields.evaluate import EvaluationOptions
from geoposition.calib_fields.matches import Cause, DomMatches
from geoposition.calib_fields.rematch import rematched
from geoposition.errors import ArgumentError, GeometryError, ProductError
from geoposition.observations import ControlPoints, TiePoints, diagonal_covariance
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.calibrated_camera import line_camera
from geoposition.sensors.directions import PolynomialDirections, TableDirections
from geoposition.sensors.line_camera import Ccd, LineCamera, Mounting
from geoposition.sensors.readers import open_product
from geoposition.sensors.readers.camera_file import read_camera_file
from geoposition.sensors.writers.model_file import write_model_file
from geoposition.sensors.writers.model_file_camera import write_camera_file

SHAPE = (2400, 1200)
NOISE_PX = 0.05
TURN_ARCSEC = (2.0, -3.0, 8.0)
CUBIC_PX = ((0.5, 2.0), (-1.0, 1.2))
"""Along and across, at the ends of the first and of the second CCD."""


def two_ccds(
    cubic_px: tuple[tuple[float, float], ...] = ((0.0, 0.0), (0.0, 0.0)),
) -> tuple[Ccd, ...]:
    """Two CCDs side by side, each 600 samples, with cubics over their own samples."""
    out = []
    for k, (along, across) in enumerate(cubic_px):
        middle = (k - 0.5) * 600.0 * IFOV_RAD
        x = [0.0, 0.0, 0.0, along * IFOV_RAD]
        y = [middle, 299.5 * IFOV_RAD, 0.0, across * IFOV_RAD]
        out.append(Ccd(600, PolynomialDirections(x, y, 600.0 * k + 299.5, 299.5)))
    return tuple(out)


def taken(
    roll_pitch_arcsec: tuple[float, float] = (0.0, 0.0),
    *,
    true: bool = False,
    jitter: tuple[Jitter, ...] = (),
) -> PushbroomModel:
    """Model of a scene; a true one has the planted camera and its own attitude error."""
    turn = Rotation.from_rotvec(np.array(TURN_ARCSEC) * ARCSEC_RAD)
    scene: Scene = build(
        SHAPE,
        orbit=Orbit.over(LON_RAD, LAT_RAD, ALTITUDE_M),
        gsd_m=GSD_M,
        roll_deg=roll_pitch_arcsec[0] / 3600.0,
        pitch_deg=roll_pitch_arcsec[1] / 3600.0,
        ccds=two_ccds(CUBIC_PX) if true else two_ccds(),
        mounting=Mounting(turn) if true else None,
        jitter=jitter,
        attitude="spline",
        height_range_m=(0.0, 1500.0),
    )
    return scene.model()


@dataclass(frozen=True)
class Planted:
    """A scene for calibration and the model that took it."""

    scene: CalibrationScene
    true: PushbroomModel


def planted(
    name: str,
    rng: np.random.Generator,
    roll_pitch_arcsec: tuple[float, float] = (0.0, 0.0),
    *,
    jitter: tuple[Jitter, ...] = (),
    spacing: int = 90,
) -> Planted:
    true, believed = taken(roll_pitch_arcsec, true=True, jitter=jitter), taken()
    place = np.stack(
        np.meshgrid(*(np.arange(20.0, n - 20.0, spacing) for n in SHAPE), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    # off the lattice: equal steps in time cannot tell a vibration from its aliases
    place = place + rng.uniform(-18.0, 18.0, place.shape)
    ground = believed.image_to_ground(place, rng.uniform(100.0, 900.0, len(place))).geodetic
    n = len(ground)
    observed = true.ground_to_image(ground).image_px + NOISE_PX * rng.standard_normal((n, 2))
    blank = np.zeros((n, 2))
    matches = DomMatches(
        ground=ground,
        model_px=place,
        image_px=observed,
        covariance_px2=np.broadcast_to(NOISE_PX**2 * np.eye(2), (n, 2, 2)),
        shift_en_m=blank,
        covariance_m2=np.broadcast_to(np.eye(2), (n, 2, 2)),
        correlation=np.full(n, 0.9),
        cause=np.full(n, Cause.USED, dtype=np.uint8),
        pixel_m=GSD_M,
        ground_sample_m=(GSD_M, GSD_M),
        window_px=16,
        spacing_px=spacing,
        lines_per_pixel=(1.0, 0.0),
    )
    return Planted(CalibrationScene(name, believed, rematched(matches, believed)), true)


@pytest.fixture(scope="module")
def pair() -> tuple[Planted, Planted]:
    rng = np.random.default_rng(1)
    wave = (Jitter(1, 0.3 * IFOV_RAD, 2.0, 0.7),)
    return planted("a", rng, (3.0, 0.0), jitter=wave), planted("b", rng, (-1.0, 2.0))


@pytest.fixture(scope="module")
def calibration(pair: tuple[Planted, Planted]) -> Calibration:
    return calibrate([p.scene for p in pair], CalibrationOptions(height_sigma_m=0.01))


def true_shape_px() -> FloatArray:
    """Planted less believed tangents on the curves' samples, without the turn that fits best."""
    change, at = [], []
    for k, (new, old) in enumerate(zip(two_ccds(CUBIC_PX), two_ccds(), strict=True)):
        sample = np.linspace(600.0 * k, 600.0 * k + 599.0, 65)
        change.append(new.directions.tangents(sample) - old.directions.tangents(sample))
        at.append(old.directions.tangents(sample))
    flat, turns = np.concatenate(change).ravel(), turn_terms(np.concatenate(at)).reshape(-1, 3)
    left = flat - turns @ np.linalg.lstsq(turns, flat, rcond=None)[0]
    return np.asarray(left.reshape(-1, 2) / IFOV_RAD)


def test_planted_look_angles_are_found(calibration: Calibration) -> None:
    found = np.concatenate([curve.shape_px for curve in calibration.curves])
    sigma = np.concatenate([curve.shape_sigma_px for curve in calibration.curves])
    off = found - true_shape_px()
    assert np.max(np.abs(true_shape_px())) > 1.5
    assert np.max(np.abs(off)) < 0.05
    assert np.max(np.abs(off) / sigma) < 4.0
    # the deviation is that of so many points, not of one and not of millions
    assert 0.5 * NOISE_PX / np.sqrt(700.0) < np.median(sigma) < 5.0 * NOISE_PX / np.sqrt(100.0)


def test_vibration_is_found_and_taken_out(calibration: Calibration) -> None:
    with_wave, without = calibration.vibrations
    assert with_wave[0].frequency == pytest.approx(2.0, abs=0.02)
    assert with_wave[0].amplitude_px[0] == pytest.approx(0.3, rel=0.1)
    # what chance adds is small
    assert all(np.hypot(*line.amplitude_px) < 0.05 for line in (*with_wave[1:], *without))
    for check in calibration.checks:
        assert max(check.after_px) < 1.3 * NOISE_PX
        assert max(check.before_px) > 0.5


def test_a_scene_kept_out_is_right(calibration: Calibration, pair: tuple[Planted, Planted]) -> None:
    """The camera alone, on a scene whose attitude is the mean of those calibrated on."""
    held = planted("held", np.random.default_rng(7), (1.0, 1.0))
    model = PushbroomModel(
        calibration.camera,
        held.scene.model.ephemeris,
        held.scene.model.attitude,
        held.scene.model.corrections,
        held.scene.model.height_range_m,
    )
    check = check_scene(held.scene, model, EvaluationOptions(relative="attitude"))
    assert check.before.estimates["relative_px"].value > 0.3
    assert check.after.estimates["relative_px"].value < 0.05
    exact = held.true.ground_to_image(held.scene.matches.ground).image_px
    off = model.ground_to_image(held.scene.matches.ground).image_px - exact
    assert np.sqrt(np.mean(off**2)) < 0.05
    # each scene's own attitude error was told from the mounting
    for k, p in enumerate(pair):
        ground = p.scene.matches.ground
        seen = calibration.adjustment.models[k].ground_to_image(ground).image_px
        left = seen - p.true.ground_to_image(ground).image_px
        assert np.all(np.abs(left.mean(axis=0)) < 0.02)


def test_what_cannot_be_told_apart_is_said(
    calibration: Calibration, pair: tuple[Planted, Planted]
) -> None:
    options = CalibrationOptions(height_sigma_m=0.01)
    alone = calibrate([pair[0].scene], options)
    weak = {name for combination in alone.adjustment.weak for name, _ in combination.parts}
    assert {"attitude1.roll_0", "attitude1.pitch_0"} <= weak
    sigma = options.attitude_sigma_rad
    assert np.all(alone.mounting_sigma_rad[:2] > 0.99 * sigma)
    # two scenes share the prior of their attitudes; what is left is that of the looks' constants
    gauge = options.look_sigma_rad**2 / 2.0
    two = np.sqrt(np.square(calibration.mounting_sigma_rad[:2]) - gauge)
    one = np.sqrt(np.square(alone.mounting_sigma_rad[:2]) - gauge)
    assert two == pytest.approx(one / np.sqrt(2.0), rel=0.02)
    # the shape does not hang on any of this
    for curve in alone.curves:
        assert np.max(curve.shape_sigma_px) < 0.1
        assert np.min(curve.sigma_px) > 0.9 * sigma / IFOV_RAD
    camera = pair[0].scene.model.camera
    wide = camera_curves(camera, alone.adjustment, 1e-3).mounting_sigma_rad
    assert wide[0] == pytest.approx(np.hypot(alone.mounting_sigma_rad[0], 1e-3), rel=1e-6)


def test_scenes_of_another_camera_and_empty_ccds_are_refused(
    pair: tuple[Planted, Planted],
) -> None:
    first = pair[0].scene
    other = CalibrationScene("other", pair[1].true, pair[1].scene.matches)
    with pytest.raises(GeometryError, match="other"):
        calibrate([first, other])
    cause = np.where(first.matches.model_px[:, 1] < 600.0, Cause.LOW_CORRELATION, Cause.USED)
    half = replace(first.matches, cause=cause.astype(np.uint8))
    with pytest.raises(GeometryError, match="CCD 0 has 0 matches"):
        calibrate([CalibrationScene("half", first.model, half)])
    with pytest.raises(ArgumentError, match="degree"):
        CalibrationOptions(degree=9)


def test_look_angles_of_one_ccd_move_it_alone() -> None:
    """Data made by corrected models, without noise, are fitted exactly by the same unknowns."""
    model = taken()
    blocks = [look_angles(f"ccd{k}", [0], degree=3, detector=k, sigma_rad=1e-4) for k in (0, 1)]
    theta = 2e-5 * np.random.default_rng(2).standard_normal(16)
    (moved,) = adjusted_models([model], blocks[:1], theta[:8])
    place = np.array([[100.0, 20.0], [900.0, 300.0], [1500.0, 700.0], [2000.0, 1190.0]])
    ground = model.image_to_ground(place, 500.0).geodetic
    step = moved.ground_to_image(ground).image_px - place
    assert np.min(np.abs(step[:2]).max(axis=1)) > 0.05
    assert np.max(np.abs(step[2:])) < 1e-6
    (truth,) = adjusted_models([model], blocks, theta)
    rng = np.random.default_rng(3)
    ground = model.image_to_ground(
        rng.uniform(30.0, np.array(SHAPE) - 30.0, (200, 2)), rng.uniform(0.0, 900.0, 200)
    ).geodetic
    ids = np.arange(200)
    image = TiePoints(ids, np.zeros(200, dtype=np.int64), truth.ground_to_image(ground).image_px)
    control = ControlPoints(ids, ground, diagonal_covariance(1e-3, 200, 3), image)
    done = adjust([model], blocks, control=control, control_sigma_px=1e-3, robust=None)
    off = done.models[0].ground_to_image(ground).image_px - image.image_px
    assert np.max(np.abs(off)) < 1e-3
    with pytest.raises(ArgumentError, match="2 CCDs"):
        adjusted_models([model], [look_angles("ccd5", [0], detector=5)], np.zeros(6))


def test_the_camera_file_holds_the_camera(calibration: Calibration, tmp_path: Path) -> None:
    camera = line_camera(calibration.camera)
    assert isinstance(camera, LineCamera)
    write_camera_file(camera, tmp_path / "camera.toml", sensor="two", remarks=["by a test"])
    shared = read_camera_file(tmp_path / "camera.toml")
    assert shared.sensor == "two"
    held = taken((5.0, -4.0))
    ground = held.image_to_ground(np.array([[5.0, 7.0], [1200.0, 650.0]]), 300.0).geodetic
    model = shared.applied_to(held)
    expected = PushbroomModel(
        calibration.camera, held.ephemeris, held.attitude, held.corrections, held.height_range_m
    )
    seen, wanted = (m.ground_to_image(ground).image_px for m in (model, expected))
    assert np.max(np.abs(seen - wanted)) < 1e-6
    assert np.max(np.abs(seen - held.ground_to_image(ground).image_px)) > 0.3
    # a model file may name it in place of its own camera
    write_model_file(held, tmp_path / "held.toml")
    text = (tmp_path / "held.toml").read_text(encoding="utf-8")
    before, rest = text.split("[mounting]")
    after = rest[rest.index("[ephemeris]") :]
    head, timing = before.split("\n[timing]")
    named = f'{head}camera = "camera.toml"\n\n[timing]{timing}{after}'
    (tmp_path / "named.toml").write_text(named, encoding="utf-8")
    again = open_product(tmp_path / "named.toml").model.ground_to_image(ground).image_px
    assert np.max(np.abs(again - wanted)) < 1e-6
    (tmp_path / "both.toml").write_text(
        text.replace("\n[timing]", 'camera = "camera.toml"\n\n[timing]'), encoding="utf-8"
    )
    with pytest.raises(ProductError, match="given by the camera file"):
        open_product(tmp_path / "both.toml")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("samples = 600", "samples = 601", "CCDs of"),
        ("version = 1", "version = 9", "newer"),
        ("geoposition camera", "geoposition lens", "geoposition camera"),
        ("scale =", "skale =", "skale"),
    ],
)
def test_a_wrong_camera_file_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "camera.toml"
    write_camera_file(taken().camera, path)
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(ProductError, match=words):
        read_camera_file(path).applied_to(taken())


def test_straight_rows_become_polynomials_and_rough_ones_tables(tmp_path: Path) -> None:
    """SPOT's two-entry tables stay exact; a measured table is tabulated again, closely."""
    sample = np.arange(1200.0)
    line = np.stack([0.0 * sample, (sample - 599.5) * IFOV_RAD], axis=-1)
    base = taken()
    for samples, table in ((sample[[0, -1]], line[[0, -1]]), (sample, line)):
        camera = LineCamera.single(SHAPE, base.camera.timing, TableDirections(samples, table))
        model = PushbroomModel(
            camera, base.ephemeris, base.attitude, base.corrections, base.height_range_m
        )
        theta = 1e-5 * np.arange(1.0, 9.0)
        (moved,) = adjusted_models([model], [look_angles("look", [0], degree=3)], theta)
        assert isinstance(moved, PushbroomModel)
        write_camera_file(line_camera(moved.camera), tmp_path / "camera.toml")
        again = read_camera_file(tmp_path / "camera.toml").applied_to(model).camera
        at = np.linspace(0.0, 1199.0, 333)
        assert np.max(np.abs(again.tangents(0, at) - moved.camera.tangents(0, at))) < 1e-9


def test_a_turn_moves_tangents_as_the_terms_say() -> None:
    tangents = np.array([[0.1, -0.05], [0.0, 0.2], [-0.02, 0.0]])
    turn = np.array([1e-6, -2e-6, 3e-6])
    direction = Rotation.from_rotvec(turn).apply(np.column_stack([tangents, np.ones(3)]))
    moved = direction[:, :2] / direction[:, 2:] - tangents
    assert np.allclose(turn_terms(tangents) @ turn, moved, atol=1e-11)


def test_matches_judged_by_the_true_model_have_noise_alone() -> None:
    drawn = planted("a", np.random.default_rng(4), (3.0, -2.0), spacing=160)
    by_truth = rematched(drawn.scene.matches, drawn.true)
    assert np.std(by_truth.error_px) == pytest.approx(NOISE_PX, rel=0.15)
    seen = drawn.true.image_to_ground(by_truth.image_px, by_truth.ground[:, 2]).geodetic
    shift = -enu_errors_m(seen, by_truth.ground)[:, :2]
    assert np.allclose(by_truth.shift_en_m, shift, atol=1e-6)
    assert np.std(by_truth.shift_en_m) == pytest.approx(NOISE_PX * GSD_M, rel=0.15)
