"""RPCs of changed images: exact where algebra allows, refitted with a stated error elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import build

from geoposition.errors import ArgumentError
from geoposition.rpc.fit import fit_model
from geoposition.rpc.formats import read_rpc, write_rpc
from geoposition.rpc.model import RpcModel
from geoposition.rpc.transform import ImageAffine, bias_compensated, transformed

SHAPE = (6000, 4000)


@pytest.fixture(scope="module")
def separate() -> RpcModel:
    return fit_model(build(SHAPE, roll_deg=10.0).model()).model


@pytest.fixture(scope="module")
def equal() -> RpcModel:
    return fit_model(build(SHAPE, roll_deg=10.0).model(), denominators="equal").model


def places(model: RpcModel) -> tuple[np.ndarray, np.ndarray]:
    """Image points, and their ground at heights of the model's range."""
    rng = np.random.default_rng(1)
    image = rng.uniform(0.0, 1.0, (300, 2)) * model.shape
    return image, model.image_to_ground(image, rng.uniform(-300.0, 8000.0, 300)).geodetic


def error_px(old: RpcModel, new: RpcModel, affine: ImageAffine) -> float:
    image, ground = places(old)
    found = new.ground_to_image(ground)
    return float(np.abs(found.image_px - affine.apply(image)).max())


@settings(max_examples=20)
@given(line=st.floats(-500, 500), samp=st.floats(-500, 500))
def test_a_shift_is_exact(line: float, samp: float, separate: RpcModel) -> None:
    found = bias_compensated(separate, (line, samp))
    assert found.misfit_px is None
    assert error_px(separate, found.model, ImageAffine.correction([line, samp])) < 1e-7
    for name in ("line_num", "line_den", "samp_num", "samp_den"):
        np.testing.assert_array_equal(getattr(found.model, name), getattr(separate, name))
    assert found.model.image_shape == SHAPE
    assert found.model.direct is not None


PLANE = np.array([[1.5, 1e-4, -3e-5], [-2.0, 2e-5, -1e-4]])


def test_a_plane_is_exact_over_one_denominator(equal: RpcModel) -> None:
    found = bias_compensated(equal, PLANE)
    assert found.misfit_px is None
    assert error_px(equal, found.model, ImageAffine.correction(PLANE)) < 1e-7


def test_a_plane_over_two_denominators_is_refitted_with_its_error(separate: RpcModel) -> None:
    found = bias_compensated(separate, PLANE)
    assert found.misfit_px is not None
    error = error_px(separate, found.model, ImageAffine.correction(PLANE))
    assert 0.3 * error < found.misfit_px < 1e-3
    assert found.model.direct is not None
    assert found.model.shape == SHAPE


def test_scales_of_the_axes_are_exact(separate: RpcModel) -> None:
    bias = np.array([[1.0, 2e-3, 0.0], [4.0, 0.0, -1e-3]])
    found = bias_compensated(separate, bias)
    assert found.misfit_px is None
    assert error_px(separate, found.model, ImageAffine.correction(bias)) < 1e-7


@pytest.mark.parametrize("factor", [2.0, 4.0, 2.5])
def test_an_overview_keeps_the_images_corner(factor: float, separate: RpcModel) -> None:
    affine = ImageAffine.overview(factor)
    np.testing.assert_allclose(affine.apply([-0.5, -0.5]), [-0.5, -0.5], atol=1e-12)
    np.testing.assert_allclose(
        affine.apply([factor - 0.5, 0.0]), [0.5, 0.5 / factor - 0.5], atol=1e-12
    )
    found = transformed(separate, affine, (3000, 2000))
    assert found.misfit_px is None
    assert error_px(separate, found.model, affine) < 1e-7
    assert found.model.fit_error_px is not None
    assert separate.fit_error_px is not None
    assert found.model.fit_error_px[0] == pytest.approx(separate.fit_error_px[0] / factor)


@pytest.mark.parametrize("turns", [0, 1, 2, 3, -1, 6])
def test_a_turned_image_is_numpys(turns: int, separate: RpcModel) -> None:
    small = np.arange(12).reshape(3, 4)
    turned = np.rot90(small, turns)
    affine = ImageAffine.quarter_turns(turns, small.shape)
    for line in range(3):
        for samp in range(4):
            there = tuple(np.rint(affine.apply([line, samp])).astype(int))
            assert turned[there] == small[line, samp]
    affine = ImageAffine.quarter_turns(turns, SHAPE)
    shape = SHAPE[::-1] if turns % 2 else SHAPE
    found = transformed(separate, affine, (shape[0], shape[1]))
    assert found.misfit_px is None
    assert error_px(separate, found.model, affine) < 1e-7
    image, ground = places(separate)
    direct = found.model.direct_image_to_ground(affine.apply(image), ground[:, 2])
    before = separate.direct_image_to_ground(image, ground[:, 2])
    np.testing.assert_allclose(direct[:, :2], before[:, :2], rtol=0, atol=1e-13)
    assert found.model.line_scale_px > 0.0
    assert found.model.validity is not None
    assert found.model.validity.line_px == pytest.approx((-0.5, shape[0] - 0.5))


def test_there_and_back_is_where_one_was(separate: RpcModel) -> None:
    affine = ImageAffine(np.array([[0.8, -0.6], [0.6, 0.8]]), np.array([100.0, -20.0]))
    image, _ = places(separate)
    np.testing.assert_allclose(affine.undo(affine.apply(image)), image, atol=1e-9)


def test_a_turn_by_any_angle(equal: RpcModel, separate: RpcModel) -> None:
    angle = np.radians(12.0)
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    affine = ImageAffine(matrix, np.array([1000.0, 0.0]))
    exact = transformed(equal, affine, (8000, 6000))
    assert exact.misfit_px is None
    assert error_px(equal, exact.model, affine) < 1e-6
    fitted = transformed(separate, affine, (8000, 6000))
    assert fitted.misfit_px is not None
    assert fitted.misfit_px < 0.01
    assert error_px(separate, fitted.model, affine) < 0.01


def test_corrected_rpcs_survive_files(separate: RpcModel, tmp_path: object) -> None:
    from pathlib import Path

    corrected = bias_compensated(separate, (0.25, -1.75)).model
    for name in ("a.RPB", "a_RPC.TXT", "a.XML", "a.geom", "a.json"):
        path = Path(str(tmp_path)) / name
        write_rpc(corrected, path)
        back = read_rpc(path)
        assert back.line_off_px == corrected.line_off_px
        np.testing.assert_array_equal(back.samp_num, corrected.samp_num)


def test_unusable_affines_are_refused(separate: RpcModel) -> None:
    with pytest.raises(ArgumentError, match="bias"):
        bias_compensated(separate, [1.0, 2.0, 3.0])
    with pytest.raises(ArgumentError, match="invertible"):
        ImageAffine(np.zeros((2, 2)), np.zeros(2))
    with pytest.raises(ArgumentError, match="overview"):
        ImageAffine.overview(0.0)
    with pytest.raises(ArgumentError, match="invertible"):
        bias_compensated(separate, (np.nan, 0.0))
