"""What a reader returns: the models of one image and what its maker says of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from geoposition.rpc.model import RpcModel
from geoposition.sensor_model import SensorModel
from geoposition.timescale import Epoch


@dataclass(frozen=True, slots=True)
class Product:
    """One image's geometry, as read.

    `model` is the rigorous model where the product allows one, else its RPC. `vendor_rpc` is
    the RPC that came with the product, if any. `image_path` is the image file where it lies
    beside the metadata. `details` are facts for people: scan direction, maker's corners, notes
    on what was assumed.
    """

    path: Path
    format: str
    sensor: str
    model: SensorModel
    vendor_rpc: RpcModel | None = None
    image_path: Path | None = None
    start: Epoch | None = None
    details: Mapping[str, object] = field(default_factory=dict)

    @property
    def is_rigorous(self) -> bool:
        """Whether `model` is a rigorous one rather than an RPC."""
        return not isinstance(self.model, RpcModel)
