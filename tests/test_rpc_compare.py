"""Comparison of models: planted differences must come out, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from test_rpc_model import example

from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import Flag
from geoposition.rpc.compare import compare


def test_a_planted_shift_is_other_minus_reference() -> None:
    reference = example()
    result = compare(reference, reference.shifted(0.25, -1.5))
    assert result.points == 21 * 21 * 5
    assert result.missed == 0
    assert result.row.mean == pytest.approx(0.25, abs=1e-8)
    assert result.col.mean == pytest.approx(-1.5, abs=1e-8)
    assert max(result.row.std, result.col.std, result.col.max_without_mean) < 1e-8
    assert result.col.max == pytest.approx(1.5, abs=1e-8)
    assert np.abs(result.residual_px).max() < 1e-8
    assert set(result.as_dict()) == {"points", "missed", "row", "col"}
    assert {"mean", "std", "max"} <= set(result.as_dict()["row"])  # type: ignore[call-overload]


def test_the_grid_has_the_image_edges_and_the_other_models_heights() -> None:
    reference = example()
    other = example(height_off_m=500.0, height_scale_m=100.0)
    result = compare(reference, other, grid=(5, 4, 3))
    assert result.line_px.tolist() == np.linspace(0, 23999, 5).tolist()
    assert result.sample_px[[0, -1]].tolist() == [0.0, 35999.0]
    assert result.height_m.tolist() == [400.0, 500.0, 600.0]
    assert result.difference_px.shape == (3, 5, 4, 2)
    given = compare(reference, other, heights_m=[10.0, 20.0], grid=(5, 4, 3))
    assert given.height_m.tolist() == [10.0, 20.0]


def test_what_depends_on_the_line_alone_is_in_the_profile() -> None:
    reference = example()
    line_num = reference.line_num.copy()
    line_num[0] += 1e-4
    line_num[2] += 2e-4
    other = example(line_num=line_num)
    result = compare(reference, other, grid=(11, 7, 3))
    spread = result.difference_px[..., 0] - result.profile_px[:, 0][None, :, None]
    assert result.row.std > 0.5
    assert np.abs(result.profile_px[:, 1]).max() < 1e-7
    assert np.abs(spread).max() < 0.6 * np.abs(result.residual_px[..., 0]).max()


def test_points_that_one_model_misses_are_counted_not_used() -> None:
    reference = example()
    shifted = example(lat_off_deg=44.13 + 0.25)
    result = compare(reference, shifted)
    assert result.missed > 0
    assert result.points + result.missed == 21 * 21 * 5
    assert np.isnan(result.difference_px[result.flag > Flag.OUTSIDE_IMAGE]).all()
    assert np.isfinite(result.row.mean)


def test_unusable_comparisons_are_refused() -> None:
    reference = example()
    with pytest.raises(GeometryError):
        compare(reference, example(lon_off_deg=80.0))
    with pytest.raises(ArgumentError, match="grid"):
        compare(reference, reference, grid=(0, 3, 3))
    with pytest.raises(ArgumentError, match="heights_m"):
        compare(reference, reference, heights_m=[np.nan])
