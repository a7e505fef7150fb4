"""How much of an image's overlap with the reference its matches cover."""

from __future__ import annotations

import numpy as np

from geoposition.calib_fields.match import Cause, DomMatches


def coverage(matches: DomMatches) -> float:
    """Share of the tiles of an 8 × 8 division of the overlap that hold a match.

    Patches beyond the image or the orthophoto do not count; those lost to clouds and holes do.
    """
    known = np.isfinite(matches.model_px).all(axis=1) & (matches.cause != Cause.OUTSIDE)
    place = matches.model_px[known]
    low, size = place.min(axis=0), np.maximum(np.ptp(place, axis=0), 1.0)
    tile = np.minimum(((place - low) / size * 8.0).astype(np.int64), 7) @ np.array([8, 1])
    return len(np.unique(tile[matches.used[known]])) / len(np.unique(tile))
