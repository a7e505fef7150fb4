"""Ground control and tie points as people have them: tables, vector layers, ASP's and QGIS's files.

Each reader turns its file into a `ControlFile`: positions in the file's own system beside image
points counted from 0, the first pixel's centre at (0, 0). `positions` makes WGS 84 of them.
"""

from geoposition.scripts.control_files.formats import SUFFIXES, read_control_file
from geoposition.scripts.control_files.matches import is_match_file, read_match_file
from geoposition.scripts.control_files.parts import ControlFile, GroundTable, ImageTable
from geoposition.scripts.control_files.positions import Heights, covariance_enu_m2, geodetic_of

__all__ = [
    "SUFFIXES",
    "ControlFile",
    "GroundTable",
    "Heights",
    "ImageTable",
    "covariance_enu_m2",
    "geodetic_of",
    "is_match_file",
    "read_control_file",
    "read_match_file",
]
