"""Images of an adjustment run: products opened, each with the model that is to be adjusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from geoposition.errors import ProductError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.formats import read_rpc
from geoposition.rpc.model import RpcModel
from geoposition.scripts.adjust.request import ImageInput
from geoposition.scripts.image_names import ImageNames
from geoposition.sensor_model import SensorModel
from geoposition.sensors.readers import open_product


@dataclass(frozen=True, slots=True, eq=False)
class RunImage:
    """One image: `model` is the product's, or the RPC that was asked for; `fixed` ones stay."""

    id: str
    product: Product
    model: SensorModel
    pixels: Path | None
    fixed: bool

    @property
    def is_rigorous(self) -> bool:
        """Whether its attitude, orbit, times and camera can be adjusted."""
        return isinstance(self.model, PushbroomModel)


def open_images(inputs: Sequence[ImageInput], path: Path) -> tuple[RunImage, ...]:
    """Open all products; what cannot be used is a `ProductError`."""
    return tuple(_opened(image, path) for image in inputs)


def _opened(image: ImageInput, path: Path) -> RunImage:
    product = open_product(image.product)
    model = product.model
    if isinstance(image.rpc, Path):
        model = read_rpc(image.rpc)
    elif image.rpc and not isinstance(model, RpcModel):
        if product.vendor_rpc is None:
            raise ProductError(
                path, f"[[image]] {image.id} rpc", f"{image.product} came without an RPC"
            )
        model = product.vendor_rpc
    return RunImage(image.id, product, model, image.pixels, image.fixed)


def names_of(images: Sequence[RunImage]) -> ImageNames:
    """Names by which tables may call the images."""
    return ImageNames(
        tuple(image.id for image in images),
        tuple(image.product.path for image in images),
        tuple(
            tuple(p for p in (image.pixels, image.product.image_path) if p is not None)
            for image in images
        ),
    )
