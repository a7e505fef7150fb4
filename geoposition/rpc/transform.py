"""New RPCs from old ones: image-space corrections, crops, overviews, mosaics, turned images.

All are affine in the image: new = B old + b, with image points as (line, sample). Each row of B
that has one number other than zero only rescales one ratio, and ratios over one denominator can
be added: both are exact. Two different denominators cannot; then new ratios are fitted, and the
fit's error is stated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray, as_components, read_only
from geoposition.errors import ArgumentError
from geoposition.rays import Rays
from geoposition.rpc.fit import fit_model
from geoposition.rpc.fit_build import RpcFit
from geoposition.rpc.fit_grid import Normalisation, Samples
from geoposition.rpc.model import RpcModel
from geoposition.sensor_model import GroundPoints, ImagePoints

__all__ = ["AffineImage", "Transformed", "bias_compensated", "overview", "transformed", "turned"]
