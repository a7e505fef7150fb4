"""`geoposition adjust` on real products: planted, vendors' and relative biases; both models."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from geoposition.adjust import adjusted_models, attitude_bias
from geoposition.flags import Flag
from geoposition.scripts.cli import run
from geoposition.sensors.readers import open_product


def adjusted(folder: Path, name: str, text: str) -> dict[str, Any]:
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    assert run(["adjust", str(path), "-o", str(folder / name), "--json"]) == 0
    facts: dict[str, Any] = json.loads((folder / name / "adjustment.json").read_text())
    return facts


def image(name: str, product: Path, *more: str) -> str:
    return "\n".join(["[[image]]", f'id = "{name}"', f'product = "{product}"', *more, ""])


def value(facts: dict[str, Any], name: str) -> float:
    return next(float(p["value"]) for p in facts["parameters"] if p["name"] == name)


def test_ventoux_planted_lines_are_found_beside_the_pairs_own_bias(
    real_data: Path, tmp_path: Path
) -> None:
    """No [[unknown]], no control: the right image follows the left, heights from the DEM."""
    folder = real_data / "stereo/pleiades_ventoux"
    found = []
    for name in ("right_image", "right_image_bias"):
        text = (
            image("left", folder / "left_image.geom", f'image = "{folder}/left_image.tif"')
            + image("right", folder / f"{name}.geom", f'image = "{folder}/right_image.tif"')
            + "[ties]\nmatch = true\n[heights]\n"
            + f'dem = "{real_data}/dem/N44E005.hgt"\ngeoid = "{real_data}/dem/egm96_15.gtx"\n'
        )
        facts = adjusted(tmp_path, name, text)
        assert facts["relative"]["after"]["residual_px"]["median"] < 0.1
        found.append([value(facts, f"right.image_bias.{axis}") for axis in ("line", "sample")])
    np.testing.assert_allclose(np.subtract(found[1], found[0]), [-60.0, 0.0], atol=0.3)


def test_reunion_relative_bias_is_removed(real_data: Path, tmp_path: Path) -> None:
    folder = real_data / "stereo/pleiades_reunion"
    text = image("a", folder / "img_01.tif") + image("b", folder / "img_02.tif")
    facts = adjusted(tmp_path, "reunion", text + "[ties]\nmatch = true\n")
    before, after = (facts["relative"][k]["residual_px"]["median"] for k in ("before", "after"))
    assert before > 0.3 > after
    # Nothing is known of the parallax: it stays where the vendor put it, within a pixel.
    assert abs(value(facts, "b.image_bias.line")) < 1.5
    assert (tmp_path / "reunion" / facts["models"][1]["rpc"]).is_file()


def test_quickbird_bias_with_each_point_left_out_in_turn(real_data: Path, tmp_path: Path) -> None:
    folder = real_data / "dom/quickbird2_baviaanskloof"
    control = f'[control]\nfile = "{folder}/gcps.geojson"\nsigma_m = 0.5\nimage_sigma_px = 0.5\n'
    facts = adjusted(tmp_path, "qb", image("qb", folder / "qb2_basic1b.tif") + control)
    found = [value(facts, f"qb.image_bias.{axis}") for axis in ("sample", "line")]
    np.testing.assert_allclose(found, (-2.95, -2.09), atol=0.1)
    alone = facts["leave_one_out"]
    assert len(alone["points"]) == 5
    assert alone["residual_px"]["max"] < 0.25
    rpc = open_product(tmp_path / "qb" / facts["models"][0]["rpc"]).model
    given = open_product(folder / "qb2_basic1b.tif").model
    middle = np.array([100.0, 500.0])
    ground = given.image_to_ground(middle, 300.0).geodetic
    np.testing.assert_allclose(
        rpc.ground_to_image(ground).image_px - middle, found[::-1], atol=1e-3
    )


def test_worldview_attitude_and_rpc_bias_agree(real_data: Path, tmp_path: Path) -> None:
    """The same simulated control by rigorous models and by the vendor's RPCs."""
    folder = real_data / "linescan/worldview2_pair"
    paths = [folder / f"wv_mvp_{k}.xml" for k in (1, 2)]
    models = [open_product(path).model for path in paths]
    rng = np.random.default_rng(0)
    blocks = [attitude_bias(f"image{k}", models, [k]) for k in range(2)]
    truth = adjusted_models(models, blocks, rng.normal(0.0, 2e-5, 6))
    size = np.array(models[0].shape) - 1.0
    height = rng.uniform(*models[0].height_range_m, 300)
    ground = models[0].image_to_ground(rng.uniform(0.0, size, (300, 2)), height).geodetic
    seen = [model.ground_to_image(ground) for model in truth]
    both = np.flatnonzero((seen[0].flag == Flag.OK) & (seen[1].flag == Flag.OK))
    with (tmp_path / "gcps.csv").open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["id", "lon", "lat", "height", "product", "row", "col"])
        for k, points in enumerate(seen):
            noisy = points.image_px[both] + rng.normal(0.0, 0.3, (len(both), 2))
            for i, px in zip(both.tolist(), noisy.tolist(), strict=True):
                lon, lat = np.degrees(ground[i, :2])
                out.writerow([i, repr(float(lon)), repr(float(lat)), ground[i, 2], k, *px])
    control = '[control]\nfile = "gcps.csv"\nsigma_m = 0.05\nimage_sigma_px = 0.3\n'
    rigorous = "".join(image(f"i{k}", path) for k, path in enumerate(paths))
    rpcs = "".join(image(f"i{k}", path, "rpc = true") for k, path in enumerate(paths))
    affine = '[[unknown]]\nkind = "image_bias"\ndegree = "affine"\n'
    quiet = "[output]\nreport = false\ncsm = false\n"
    first = adjusted(tmp_path, "rigorous", rigorous + control + quiet)
    second = adjusted(tmp_path, "rpc", rpcs + control + affine + quiet)
    assert not first["rejected"]
    line, sample = np.meshgrid(*(np.linspace(0.0, s, 60) for s in size), indexing="ij")
    grid = np.stack([line, sample], axis=-1).reshape(-1, 2)
    place = models[0].image_to_ground(grid, float(np.mean(models[0].height_range_m))).geodetic
    for a, b in zip(first["models"], second["models"], strict=True):
        one = open_product(tmp_path / "rigorous" / a["model"]).model.ground_to_image(place)
        two = open_product(tmp_path / "rpc" / b["rpc"]).model.ground_to_image(place)
        off = (one.image_px - two.image_px)[np.isfinite(one.image_px - two.image_px).all(axis=1)]
        assert len(off) > 1000
        assert np.all(np.abs(np.mean(off, axis=0)) < 0.05)
