"""The image that belongs to a product, in the pixels its model counts in."""

from __future__ import annotations

from pathlib import Path

from geoposition.errors import ProductError
from geoposition.matching import ImageSource, open_image
from geoposition.product import Product
from geoposition.reimage.raster_files import ImageFile
from geoposition.rpc.model import RpcModel
from geoposition.sensor_model import SensorModel


def image_of(product: Product, path: Path | None) -> ImageSource:
    """Open the image at `path`, or the one beside the product."""
    path = path or product.image_path
    if path is None:
        raise ProductError(product.path, "", "no image lies beside it: name it with --image")
    if path == product.path and isinstance(product.model, RpcModel):
        # The RPC read from an image is in that image's own pixels, crop or not.
        return open_image(path, first_pixel=(0, 0))
    return open_image(path)


def check_size(model: SensorModel, image: ImageFile) -> None:
    """Refuse an image that reaches beyond what `model` describes."""
    if isinstance(model, RpcModel) and not model.shape_known:
        return
    end = image.first_line + image.shape[0], image.first_sample + image.shape[1]
    if end[0] > model.shape[0] or end[1] > model.shape[1]:
        raise ProductError(
            image.path, "size",
            f"an image of {model.shape[0]} x {model.shape[1]} or a crop of it expected, this one "
            f"ends at line {end[0] - 1} and sample {end[1] - 1}",
        )  # fmt: skip


def nodata_of(image: ImageFile, asked: float | None) -> float | None:
    """Value of missing pixels: as asked, else the image's own."""
    return image.nodata if asked is None else asked
