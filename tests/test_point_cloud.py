"""LAS and LAZ files: coordinates to the millimetre, system, extra dimension, many chunks."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from geoposition.errors import ArgumentError
from geoposition.surface.point_cloud import PointCloud

ORIGIN = np.array([700_000.0, 4_900_000.0, 500.0])


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_what_is_written_is_read(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(0)
    points = ORIGIN + rng.uniform(-5e3, 5e3, (4000, 3))
    sigma = rng.uniform(0.1, 1.0, 4000).astype(np.float32)
    grey = rng.uniform(0, 4095, 4000).astype(np.float32)
    rays = rng.integers(2, 5, 4000).astype(np.uint8)
    path = tmp_path / f"cloud{suffix}"
    with PointCloud(path, "EPSG:32631", ORIGIN) as cloud:
        for first in (0, 1500):
            part = slice(first, 1500 if first == 0 else None)
            cloud.add(points[part], sigma[part], grey[part], rays[part])
    assert cloud.points == 4000
    read = laspy.read(path)
    np.testing.assert_allclose(read.xyz, points, atol=5.1e-4)
    np.testing.assert_array_equal(read["sigma_z"], sigma)
    np.testing.assert_array_equal(read.user_data, rays)
    np.testing.assert_allclose(read.intensity, grey, atol=1.0)
    assert np.all(read.return_number == 1)
    assert str(read.header.version) == "1.4"
    assert read.header.are_points_compressed == (suffix == ".laz")
    assert any("32631" in vlr.string for vlr in read.header.vlrs if hasattr(vlr, "string"))
    np.testing.assert_allclose(read.header.mins, points.min(axis=0), atol=1e-3)


def test_degrees_keep_their_digits(tmp_path: Path) -> None:
    points = np.array([[5.123456789, 44.987654321, 500.0]] * 3)
    with PointCloud(tmp_path / "a.las", "EPSG:4326", points[0]) as cloud:
        cloud.add(points, np.ones(3, np.float32), np.ones(3, np.float32), np.full(3, 2, np.uint8))
    np.testing.assert_allclose(laspy.read(tmp_path / "a.las").xyz[:, :2], points[:, :2], atol=1e-8)


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"\.las"):
        PointCloud(tmp_path / "cloud.ply", "EPSG:32631", ORIGIN)
