"""The models' own errors in an intersection: into its weights, and out as their part of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geoposition.arrays import BoolArray, FloatArray
from geoposition.ellipsoid import enu_axes
from geoposition.triangulate.part import Part, PartResult, Scene, inverse_roots
from geoposition.triangulate.scale import field_covariance


def model_covariances(scene: Scene, part: Part, height_m: FloatArray) -> FloatArray | None:
    """Covariances (observations, 2, 2) of the models' errors in the images; None without any."""
    if scene.errors is None:
        return None
    out = np.zeros((len(part.product), 2, 2))
    height = height_m[part.point]
    for k in np.unique(part.product):
        mine = part.product == k
        out[mine] = field_covariance(
            scene.errors[k], scene.fields[k], part.image_px[mine], height[mine]
        )
    # An image point that is none must not spoil a Cholesky factor; its ray is flagged anyway.
    out[~np.isfinite(out).all(axis=(1, 2))] = 0.0
    return out


def with_errors(part: Part, systematic_px2: FloatArray) -> Part:
    """Return the part with weights of image noise and models' errors together."""
    inverse = np.linalg.inv(part.root)
    noise = inverse @ inverse.transpose(0, 2, 1)
    return replace(part, root=inverse_roots(noise + systematic_px2))


def systematic_part(
    part: Part,
    rows: FloatArray,
    used: BoolArray,
    systematic_px2: FloatArray,
    found: PartResult,
) -> FloatArray:
    """Covariance (n, 3, 3), east, north, up, from the models' errors alone.

    C (sum Aᵀ L⁻¹ S L⁻ᵀ A) C with the covariance C of all errors together, from the weights that
    were used, and S the models' part of it in an image.
    """
    lon_lat = np.where(np.isfinite(found.geodetic), found.geodetic, 0.0)
    local = np.where(used[:, None, None], rows, 0.0) @ enu_axes(lon_lat)[part.point]
    whitened = part.root @ systematic_px2 @ part.root.transpose(0, 2, 1)
    each = local.transpose(0, 2, 1) @ whitened @ local
    total = np.add.reduceat(each, part.start[:-1], axis=0)
    covariance = found.covariance_enu_m2
    return np.asarray(covariance @ total @ covariance, dtype=np.float64)
