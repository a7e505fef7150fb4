"""An image pair to its surface: matches, relative bias removed, DSM, each through a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio

from geoposition.errors import GeometryError
from geoposition.rpc.formats import write_rpc
from geoposition.rpc.model import RpcModel
from geoposition.scripts import dsm_run
from geoposition.scripts.experiments.real.size import Size
from geoposition.scripts.experiments.real.sources import REUNION, VENTOUX
from geoposition.scripts.results import unseen
from geoposition.scripts.stereo import report as stereo_report
from geoposition.scripts.stereo import run as stereo_run
from geoposition.scripts.tie_tables import names_for, read_ties, write_ties
from geoposition.sensors.readers import open_product

STEPS: Final = 3


@dataclass(frozen=True, slots=True)
class PairCase:
    """What differs from pair to pair: the reference's name, cell size (None: the image's own)."""

    name: str
    reference: str
    cell_m: float | None


CASES: Final = (PairCase(VENTOUX, "SRTM", None), PairCase(REUNION, "s2p's surface", 0.5))


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """What the chain found: the sparse run, the facts of the surface, its cells' median sigma."""

    case: PairCase
    stereo: stereo_run.StereoRun
    surface: Mapping[str, Any]
    surface_sigma_m: float

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        summary: Any = self.stereo.summary
        sparse = {
            name: summary[name]
            for name in (
                "matches", "intersected", "residual_before_removal_px", "residual_px", "sigma_px",
                "convergence_deg", "base_to_height", "sigma_enu_m",
            )
        }  # fmt: skip
        removal = [dict(change) for change in summary["bias_removal"]]
        bias = [{"product": b["product"], "residual": b["residual"]}
                for b in summary["relative_bias_px"]]  # fmt: skip
        dense = {
            name: self.surface[name]
            for name in ("crs", "resolution", "shape", "points", "matched_share", "comparison")
        }
        return {
            "sparse": sparse | {"relative_bias_px": bias, "removal": removal},
            "sparse_less_reference": without(summary["reference"], "path"),
            "dense": dense | {"sigma_m": self.surface_sigma_m},
        }


def without(facts: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return `facts` without one of them."""
    return {key: value for key, value in facts.items() if key != name}


def run_pair(
    case: PairCase,
    files: Mapping[str, Path],
    folder: Path,
    size: Size,
    step: Callable[[], None],
) -> Pair:
    """Run the chain in `folder`, which it makes."""
    (folder / "agreeing").mkdir(parents=True)
    paths = [files["left"], files["right"]]
    images = [files["left_image"], files["right_image"]]
    products = [open_product(path) for path in paths]
    found = stereo_run.match_products(products, images, unseen, size.matching)
    names = names_for(paths)
    write_ties(folder / "ties.csv", [found], names)
    step()
    ties = read_ties(folder / "ties.csv", paths)
    options = stereo_run.Options(
        remove_bias=True, reference=files["reference"], geoid=files.get("geoid")
    )
    stereo = stereo_run.intersect(products, ties, options, unseen)
    stereo_run.write(folder / "points.csv", stereo)
    if size.reports:
        page = stereo_report.page(stereo, options, "ties.csv, images matched")
        stereo_report.write(folder / "stereo.html", page)
    agreeing = []
    for name, model in zip(names, stereo.models, strict=True):
        assert isinstance(model, RpcModel)
        agreeing.append(folder / f"agreeing/{name}.RPB")
        write_rpc(model, agreeing[-1])
    step()
    request = dsm_run.Request(
        folder / "dsm.tif",
        resolution=case.cell_m,
        reference=files["reference"],
        geoid=files.get("geoid"),
    )
    mended = [open_product(path) for path in agreeing]
    ties = read_ties(folder / "ties.csv", agreeing)
    surface = dsm_run.run(mended, images, request, unseen, ties)
    step()
    return Pair(case, stereo, surface, _median_sigma_m(folder / "dsm.tif"))


def _median_sigma_m(surface: Path) -> float:
    """Return the median over the cells of the height's standard deviation from matching."""
    with rasterio.open(surface) as file:
        sigma = file.read(3)
    known = sigma[np.isfinite(sigma)]
    if not known.size:
        raise GeometryError(f"{surface}: no cell has a standard deviation")
    return float(np.median(known))
