"""Sparse matching of images, guided by their models: the only door to OpenCV."""

from geoposition.matching.image import ImageSource, open_image
from geoposition.matching.pairs import match_images, match_pair
from geoposition.matching.tiles import MatchOptions

__all__ = ["ImageSource", "MatchOptions", "match_images", "match_pair", "open_image"]
