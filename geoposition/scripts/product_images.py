"""The image that belongs to a product, in the pixels its model counts in."""

from __future__ import annotations

from pathlib import Path

from geoposition.errors import ProductError
from geoposition.matching import ImageSource, open_image
from geoposition.product import Product
from geoposition.rpc.model import RpcModel


def image_of(product: Product, path: Path | None) -> ImageSource:
    """Open the image at `path`, or the one beside the product."""
    path = path or product.image_path
    if path is None:
        raise ProductError(product.path, "", "no image lies beside it: name it with --image")
    if path == product.path and isinstance(product.model, RpcModel):
        # The RPC read from an image is in that image's own pixels, crop or not.
        return open_image(path, first_pixel=(0, 0))
    return open_image(path)
