"""What is known of the errors of products' models: from the products, or from the user."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.error_budget import ModelError
from geoposition.error_budget.influence import ARCSEC_RAD
from geoposition.errors import ArgumentError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.model import RpcModel


@dataclass(frozen=True, slots=True)
class StatedSigmas:
    """Standard deviations the user states for all products; None leaves it to the product.

    `attitude_arcsec` about each body axis, `orbit_m` along each axis, `rpc_px` of each image
    coordinate of an RPC. `image_only` leaves the models' errors out altogether.
    """

    attitude_arcsec: float | None = None
    orbit_m: float | None = None
    rpc_px: float | None = None
    image_only: bool = False

    def __post_init__(self) -> None:
        for name, option in (
            ("attitude_arcsec", "--attitude-sigma"),
            ("orbit_m", "--orbit-sigma"),
            ("rpc_px", "--rpc-sigma"),
        ):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0.0):
                raise ArgumentError(f"{option}: a number >= 0 expected, got {value}")
            if value is not None and self.image_only:
                raise ArgumentError(f"{option}: not with --image-noise-only")


def model_errors(products: Sequence[Product], stated: StatedSigmas) -> list[ModelError | None]:
    """Errors of each product's model; None where nothing is known, or wanted."""
    if stated.image_only:
        return [None] * len(products)
    found = [_error_of(product, stated) for product in products]
    return [None if error.nothing else error for error in found]


def _error_of(product: Product, stated: StatedSigmas) -> ModelError:
    model = product.model
    if isinstance(model, RpcModel):
        if stated.rpc_px is not None:
            return ModelError.of_sigmas(image_px=stated.rpc_px)
        return ModelError(ground_m=model.err_bias_m or 0.0)
    if not isinstance(model, PushbroomModel):
        return ModelError()
    if stated.attitude_arcsec is None:
        attitude = attitude_covariance(model)
    else:
        attitude = np.eye(3) * (stated.attitude_arcsec * ARCSEC_RAD) ** 2
    orbit = stated.orbit_m
    if orbit is None:
        given = product.details.get("position_sigma_ecef_m")
        orbit = float(np.sqrt(np.mean(np.square(given)))) if isinstance(given, list) else 0.0
    return ModelError(attitude_rad2=attitude, position_m2=np.eye(3) * orbit**2)


def attitude_covariance(model: PushbroomModel) -> FloatArray:
    """Covariance (3, 3) of the attitude at the image's middle, rad²; zero where unknown."""
    attitude, timing = model.attitude, model.camera.timing
    if attitude.covariance_rad2 is None or attitude.covariance_times_s is None:
        return np.zeros((3, 3))
    middle = timing.time_s(np.array([0.5 * (model.shape[0] - 1)]))
    at = float(middle[0]) + (timing.epoch - attitude.epoch)
    nearest = int(np.argmin(np.abs(attitude.covariance_times_s - at)))
    return np.asarray(attitude.covariance_rad2[nearest], dtype=np.float64)


def describe_error(error: ModelError | None) -> Mapping[str, object]:
    """Return the standard deviations by name, fit for JSON; empty where nothing is known."""
    if error is None:
        return {}
    facts: dict[str, object] = {}
    if np.any(error.attitude_rad2):
        sigma = np.sqrt(np.diag(error.attitude_rad2)) / ARCSEC_RAD
        facts["attitude_arcsec"] = sigma.tolist()
    if np.any(error.position_m2):
        facts["orbit_m"] = np.sqrt(np.diag(error.position_m2)).tolist()
    if np.any(error.image_px2):
        facts["image_px"] = np.sqrt(np.diag(error.image_px2)).tolist()
    if error.ground_m:
        facts["ground_m"] = error.ground_m
    return facts
