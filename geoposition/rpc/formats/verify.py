"""Proof that a written RPC places pixels where the model does, through GDAL where it reads it.

GDAL finds an image's RPC in the image's tag or in a file beside it whose name follows the
vendors' rules; so the file is put beside an image without pixels. GDAL's transformer counts from
the corner of the first pixel, half a pixel from its centre.
"""

from __future__ import annotations

import shutil
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.rpc import RPC
from rasterio.transform import RPCTransformer

from geoposition.arrays import FloatArray
from geoposition.errors import ProductError
from geoposition.flags import has_result
from geoposition.rpc.formats import _fields as fields
from geoposition.rpc.formats import dialect_for, read_rpc, sniff, write_rpc
from geoposition.rpc.formats._files import whole_file
from geoposition.rpc.model import RpcModel

TOLERANCE_PX: Final = 1e-6
"""Two programs that do the same sums differ by less."""

_BESIDE: Final = {
    "rpb": ("image.tif", "image.RPB"),
    "rpc_txt": ("image.tif", "image_RPC.TXT"),
    "dimap": ("IMG_X_R1C1.TIF", "RPC_X.XML"),
}


@dataclass(frozen=True, slots=True)
class Verification:
    """Largest distance `max_px` over `points` ground points; `reader` read the file."""

    points: int
    max_px: float
    reader: str

    @property
    def passed(self) -> bool:
        """Whether every point is where it should be."""
        return self.max_px <= TOLERANCE_PX

    def as_dict(self) -> dict[str, object]:
        """Return the facts by name."""
        return {
            "points": self.points,
            "max_px": self.max_px,
            "reader": self.reader,
            "passed": self.passed,
        }


def verify_rpc(model: RpcModel, path: str | Path, points: int = 1000) -> Verification:
    """Read `path` again and compare with `model` at `points` places over its whole domain.

    Dialects that GDAL does not know (`.geom`, JSON, Maxar's XML) are read by our own reader and
    their numbers given to GDAL's transformer.
    """
    path = Path(path)
    rpcs = _through_gdal(path)
    reader = "GDAL" if rpcs is not None else "geoposition, then GDAL's transformer"
    geodetic = _places(model, points)
    expected = model.ground_to_image(geodetic)
    good = has_result(expected.flag)
    lon_deg, lat_deg = np.degrees(geodetic[good, :2]).T
    with RPCTransformer(rpcs if rpcs is not None else _rpcs(read_rpc(path))) as gdal:
        line, samp = gdal.rowcol(lon_deg, lat_deg, zs=geodetic[good, 2], op=_same)
    found = np.stack([line, samp], axis=-1) - 0.5
    distance = np.hypot(*(found - expected.image_px[good]).T)
    return Verification(int(good.sum()), float(distance.max(initial=0.0)), reader)


def write_verified(model: RpcModel, path: str | Path) -> Verification:
    """Write `model` to `path` once `verify_rpc` has passed on it; else nothing is written.

    Raises
    ------
    ProductError
        What is read again is off by more than `TOLERANCE_PX`.
    """
    path = Path(path)
    with whole_file(path) as trial:
        if path.exists():  # a TIFF keeps its pixels
            shutil.copyfile(path, trial)
        write_rpc(model, trial, dialect_for(path))
        verified = verify_rpc(model, trial)
        if not verified.passed:
            raise ProductError(
                path,
                "",
                f"not written: read again by {verified.reader} it differs by "
                f"{verified.max_px:.3g} px, {TOLERANCE_PX:g} px expected",
            )
    return verified


def _same(values: FloatArray) -> FloatArray:
    return values


def _places(model: RpcModel, points: int) -> FloatArray:
    """Ground of pixels and heights strewn over the image by an additive recurrence."""
    golden = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
    spread = np.mod(0.5 + np.arange(points)[:, None] * golden, 1.0)
    image = spread[:, :2] * model.shape - 0.5
    low, high = model.height_range_m
    return model.image_to_ground(image, low + spread[:, 2] * (high - low)).geodetic


def _rpcs(model: RpcModel) -> RPC:
    scalars = {key.lower(): getattr(model, name) for key, name in fields.SCALAR_FIELDS.items()}
    lists = {
        key.lower(): getattr(model, name).tolist()
        for key, name in fields.COEFFICIENT_FIELDS.items()
    }
    return RPC(**scalars, **lists)


def _through_gdal(path: Path) -> RPC | None:
    """GDAL's own reading of the file, or None for a dialect that it does not know."""
    dialect = sniff(path)
    if dialect == "geotiff":
        return _open(path, path)
    if dialect not in _BESIDE:
        return None
    image, name = _BESIDE[dialect]
    with tempfile.TemporaryDirectory(prefix="geoposition-") as folder:
        there = Path(folder)
        shutil.copyfile(path, there / name)
        if dialect == "dimap":
            # GDAL takes an image for a DIMAP one if its DIM_ file is there, whatever is in it.
            (there / "DIM_X.XML").write_text("<Dimap_Document/>", encoding="utf-8")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(
                there / image, "w", driver="GTiff", width=1, height=1, count=1, dtype="uint8"
            ):
                pass
        return _open(there / image, path)


def _open(image: Path, path: Path) -> RPC:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(image) as source:
                rpcs = source.rpcs
    except (RasterioError, KeyError, ValueError) as error:
        raise ProductError(path, "", f"a file that GDAL reads expected ({error})") from None
    if rpcs is None:
        raise ProductError(path, "", "GDAL finds no RPC in what was written")
    return rpcs
