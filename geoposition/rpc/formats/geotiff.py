"""RPC of an image: the GeoTIFF tag, GDAL's RPC metadata, or a file beside the image.

Pixels: 0-based, first pixel's centre at (0, 0), in the tag and in GDAL's metadata (GDAL's own
transformer then adds half a pixel, because it counts from the corner; checked in the tests).
Heights: metres above the WGS 84 ellipsoid. *Source*: GDAL RFC 22; STDI-0002 appendix E.

A tag, or metadata that GDAL attributes to the file, is taken to give that file's own pixels. A
DIMAP or `.geom` file beside the image describes the whole image: if the image is a crop that
says so (a geotransform without map projection that only moves by whole pixels), the model is
moved to the crop's pixels.
"""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.rpc import RPC
from rasterio.windows import Window

from geoposition.errors import ProductError
from geoposition.rpc.formats import _fields as fields
from geoposition.rpc.formats import dimap, geom, rpb, rpc_txt
from geoposition.rpc.formats._files import read_head, whole_file
from geoposition.rpc.formats.tiff_tag import RPC_TAG, is_tiff, read_rpc_tag
from geoposition.rpc.model import RpcModel

_TAG_SCALARS = ("LINE_OFF", "SAMP_OFF", "LAT_OFF", "LONG_OFF", "HEIGHT_OFF",
                "LINE_SCALE", "SAMP_SCALE", "LAT_SCALE", "LONG_SCALE", "HEIGHT_SCALE")  # fmt: skip


def recognises(head: bytes) -> bool:
    """Tell whether a file that begins with `head` is an image that may carry an RPC."""
    return (
        is_tiff(head)
        or head.startswith((b"NITF02", b"NSIF01"))
        or head[4:12] == b"jP  \r\n\x87\n"
        or head.startswith(b"\xff\x4f\xff\x51")
    )


def read(path: Path) -> RpcModel:
    """Read the RPC of an image, in the image's own pixels, with its size."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as source:
                shape = (source.height, source.width)
                window = _crop(source)
                rpcs = source.rpcs
    except (RasterioError, KeyError, ValueError) as error:
        raise ProductError(path, "", f"a readable image expected ({error})") from None
    numbers = read_rpc_tag(path) if is_tiff(read_head(path)) else None
    if numbers is not None:
        return _from_tag(path, numbers, shape)
    for beside, read_beside in _beside(path):
        if beside.is_file():
            model = read_beside(beside)
            whole = read_beside in (geom.read, dimap.read)
            first = (window.row_off, window.col_off) if whole else (0, 0)
            return model.cropped(int(first[0]), int(first[1]), shape)
    if rpcs is not None:
        return _from_gdal(path, rpcs, shape)
    raise ProductError(path, "", "an image with an RPC expected: no tag, none beside it")


def _crop(source: Any) -> Window:
    t = source.transform
    moved = (t.a, t.b, t.d, t.e) == (1.0, 0.0, 0.0, 1.0) and t.c == int(t.c) and t.f == int(t.f)
    if source.crs is not None or not moved:
        return Window(0, 0, source.width, source.height)
    return Window(int(t.c), int(t.f), source.width, source.height)


def _beside(path: Path) -> list[tuple[Path, Callable[[Path], RpcModel]]]:
    """Files that carry the RPC of the image `path`, by the vendors' naming rules."""
    stem, folder = path.stem, path.parent
    names: list[tuple[str, Callable[[Path], RpcModel]]] = []
    for suffix in (".RPB", ".rpb"):
        names.append((stem + suffix, rpb.read))
    for suffix in ("_RPC.TXT", "_RPC.txt", "_rpc.txt"):
        names.append((stem + suffix, rpc_txt.read))
    names.append((stem + ".geom", geom.read))
    names.append((stem + "_RPC.XML", dimap.read))
    if stem.upper().startswith("IMG_"):
        # IMG_<product>[_R1C1] belongs to RPC_<product>; only an untiled image is the whole one.
        base, _, tile = stem[4:].rpartition("_")
        product = base if tile.upper() == "R1C1" else stem[4:]
        names.append((f"RPC_{product}.XML", dimap.read))
    return [(folder / name, reader) for name, reader in names]


def _from_tag(path: Path, numbers: tuple[float, ...], shape: tuple[int, int]) -> RpcModel:
    texts = {key: repr(value) for key, value in zip(_TAG_SCALARS, numbers[2:12], strict=True)}
    place = f"TIFF tag {RPC_TAG}"
    entries = fields.Entries(path, texts, lambda key: f"{place}, {key}")
    values: dict[str, Any] = {
        field: entries.number(key) for key, field in fields.SCALAR_FIELDS.items()
    }
    for i, (key, field) in enumerate(fields.COEFFICIENT_FIELDS.items()):
        words = [repr(value) for value in numbers[12 + 20 * i : 32 + 20 * i]]
        values[field] = fields.twenty_numbers(path, entries.place(key), words)
    values["err_bias_m"], values["err_rand_m"] = (_known(value) for value in numbers[:2])
    values["image_shape"] = shape
    names = {field: entries.place(key) for key, field in fields.SCALAR_FIELDS.items()}
    return fields.build(path, names.__getitem__, values)


def _from_gdal(path: Path, rpcs: RPC, shape: tuple[int, int]) -> RpcModel:
    values: dict[str, Any] = {
        field: float(getattr(rpcs, key.lower())) for key, field in fields.SCALAR_FIELDS.items()
    }
    for key, field in fields.COEFFICIENT_FIELDS.items():
        words = [repr(value) for value in getattr(rpcs, key.lower())]
        values[field] = fields.twenty_numbers(path, f"RPC metadata, {key}", words)
    values["err_bias_m"], values["err_rand_m"] = _known(rpcs.err_bias), _known(rpcs.err_rand)
    values["image_shape"] = shape
    names = {field: f"RPC metadata, {key}" for key, field in fields.SCALAR_FIELDS.items()}
    return fields.build(path, names.__getitem__, values)


def _known(error_m: float | None) -> float | None:
    """GDAL and the tag write -1 for an error that is not known."""
    return None if error_m is None or not error_m >= 0.0 else float(error_m)


def gdal_rpc(model: RpcModel) -> RPC:
    """Return `model` as GDAL's metadata of an image has it."""
    return RPC(
        **{key.lower(): getattr(model, field) for key, field in fields.SCALAR_FIELDS.items()},
        **{
            key.lower(): getattr(model, field).tolist()
            for key, field in fields.COEFFICIENT_FIELDS.items()
        },
        err_bias=model.err_bias_m,
        err_rand=model.err_rand_m,
    )


def write(model: RpcModel, path: Path) -> None:
    """Write `model` as the RPC tag of the TIFF file `path`, at full precision.

    An existing TIFF keeps its pixels and gets the tag (through a copy, so that it is whole at
    any time); otherwise a new image of the model's shape without pixel data (sparse) holds it.
    """
    if path.exists() and not is_tiff(read_head(path)):
        raise ProductError(path, "", "a TIFF file expected, to put the RPC tag into")
    rpcs = gdal_rpc(model)
    with whole_file(path) as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            if path.exists():
                shutil.copyfile(path, temporary)
                target = rasterio.open(temporary, "r+")
            else:
                lines, samples = model.shape
                target = rasterio.open(
                    temporary, "w", driver="GTiff", width=samples, height=lines, count=1,
                    dtype="uint8", tiled=True, blockxsize=1024, blockysize=1024, sparse_ok=True,
                )  # fmt: skip
            with target:
                if target.shape != model.shape and model.shape_known:
                    raise ProductError(
                        path, "image size", f"{model.shape} expected, got {target.shape}"
                    )
                target.rpcs = rpcs
                target.update_tags(
                    RPC_PIXEL_ORIGIN=fields.PIXEL_ORIGIN, RPC_HEIGHT_DATUM=fields.HEIGHT_DATUM
                )
        except RasterioError as error:
            raise ProductError(path, "", f"a writable TIFF file expected ({error})") from None
