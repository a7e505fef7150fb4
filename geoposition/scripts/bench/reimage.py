"""Steady re-imaging from file to file: speed, and peak memory as the image grows in rows.

Run it as `python -m geoposition.scripts.bench.reimage --rows 8192 --samples 8192`: one JSON
object. Memory is that of this process from its start, libraries and compilation included.
"""

from __future__ import annotations

import argparse
import json
import resource
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Final

from rasterio.errors import NotGeoreferencedWarning

from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.cog import Compression
from geoposition.scripts.bench.remap_scene import HEIGHT_M, image_file, shaken_model
from geoposition.scripts.reimage import run as reimage_run
from geoposition.scripts.results import unseen

TARGETS: Final = {"file_mpx_s": 40.0, "peak_gib": 1.0}
_WARM: Final = 1024


def files(rows: int, samples: int, folder: Path, compress: Compression) -> dict[str, object]:
    """Re-imaging from file to file, all products but the report; facts fit for JSON."""
    image_file(folder / "warm.tif", _WARM, _WARM)
    _reimage(shaken_model(_WARM, _WARM), folder / "warm.tif", folder / "warm", compress)
    taken = shaken_model(rows, samples)
    image_file(folder / "image.tif", rows, samples)
    begin, busy = perf_counter(), process_time()
    facts = _reimage(taken, folder / "image.tif", folder / "steady", compress)
    seconds, busy = perf_counter() - begin, process_time() - busy
    mega = 1e-6 * rows * samples
    return {
        "size": [rows, samples],
        "file_mpx_s": mega / seconds,
        "file_mpx_per_core_s": mega / busy,
        "file_s": seconds,
        "parts_s": facts["seconds"],
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "targets": TARGETS,
    }


def _reimage(
    model: PushbroomModel, image: Path, output: Path, compress: Compression
) -> dict[str, object]:
    product = Product(image, "simulated", "simulated", model)
    request = reimage_run.Request(image, output, height_m=HEIGHT_M, compress=compress, report=False)
    return reimage_run.run(product, request, unseen)


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=8192, help="lines of the image")
    parser.add_argument("--samples", type=int, default=8192, help="samples of the image")
    parser.add_argument("--compress", default="zstd", help="of the steady image")
    parser.add_argument("--folder", type=Path, default=None, help="for the files; a scratch one")
    given = parser.parse_args()
    with TemporaryDirectory(dir=given.folder) as place, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        facts = files(given.rows, given.samples, Path(place), given.compress)
    print(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main()
