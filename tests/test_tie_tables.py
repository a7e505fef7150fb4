"""Ties written as a table are the ties that are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geoposition.observations import TiePoints
from geoposition.scripts.tie_tables import names_for, read_ties, write_ties


@pytest.mark.parametrize(
    ("products", "names"),
    [
        (["a/left.tif", "a/right.tif"], ["left", "right"]),
        (["a/scene.tif", "a/scene.xml"], ["scene.tif", "scene.xml"]),
        (["a/scene.tif", "b/scene.tif"], ["0", "1"]),
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_round_trip(tmp_path: Path, products: list[str], names: list[str], suffix: str) -> None:
    paths = [Path(name) for name in products]
    assert names_for(paths) == names
    rng = np.random.default_rng(1)
    matched = TiePoints.of_pair(*rng.uniform(0.0, 1000.0, (2, 20, 2)))
    marks = TiePoints.of_pair(*rng.uniform(0.0, 1000.0, (2, 3, 2)), ids=["g1", "g2", "g3"])
    path = tmp_path / f"ties{suffix}"
    write_ties(path, [matched, marks], names)
    found = read_ties(path, paths)
    assert found.ids.tolist() == [*map(str, matched.ids), *marks.ids]
    assert np.array_equal(found.product, np.concatenate([matched.product, marks.product]))
    wanted = np.concatenate([matched.image_px, marks.image_px])
    # four decimals are kept
    np.testing.assert_allclose(found.image_px, wanted, atol=0.51e-4)
