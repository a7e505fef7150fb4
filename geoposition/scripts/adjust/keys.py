"""Keys of each table of RUN.toml, with the other names under which they are taken."""

from typing import Final

IMAGE: Final = {
    "id": ("name",),
    "product": ("file", "path", "model"),
    "rpc": ("use_rpc",),
    "image": ("pixels", "raster"),
    "fixed": ("reference", "held"),
}
CONTROL: Final = {
    "file": ("path", "gcps", "points", "table"),
    "image_points": ("observations", "image_file", "measurements"),
    "sigma_m": ("sigma", "sigma_ground_m", "ground_sigma_m"),
    "image_sigma_px": ("sigma_px", "sigma_image_px"),
    "crs": ("datum", "srs", "epsg"),
    "heights": ("height", "height_datum", "vertical"),
    "geoid": (),
    "dem": (),
    "dem_geoid": (),
}
TIES: Final = {
    "file": ("path", "files", "table"),
    "match": ("matching", "automatic"),
    "sigma_px": ("image_sigma_px", "sigma"),
    "images": ("pair",),
}
CHECK: Final = {
    "file": ("path", "gcps", "points", "table"),
    "image_points": ("observations", "image_file", "measurements"),
    "ids": ("id", "points_ids", "names"),
    "every": ("every_nth", "nth"),
    "fraction": ("share", "part"),
    "leave_one_out": ("loo", "cross_validation"),
}
UNKNOWN: Final = {
    "kind": ("type",),
    "name": ("id",),
    "images": ("image",),
    "shared": ("common",),
    "degree": ("order", "model"),
    "knots": ("knots_line", "knots_lines"),
    "smooth": (),
    "spacing_s": ("spacing",),
    "sigma": (),
    "sigma_arcsec": (),
    "sigma_rad": (),
    "sigma_m": (),
    "sigma_s": (),
    "sigma_px": (),
    "drift_sigma_m_s": ("drift_sigma", "sigma_m_s"),
}
HEIGHTS: Final = {
    "dem": ("file", "path", "dsm"),
    "geoid": (),
    "sigma_m": ("sigma",),
}
ROBUST: Final = {
    "enabled": ("use", "on", "active"),
    "family_risk": ("risk",),
    "adapt": ("adaptive",),
    "method": (),
}
PLAN: Final = {
    "count": ("points", "number"),
    "candidates": ("file", "grid"),
    "height_m": ("height",),
    "sigma_m": ("sigma",),
    "image_sigma_px": ("sigma_px",),
}
OUTPUT: Final = {
    "rpc": ("rpcs", "write_rpc"),
    "csm": ("write_csm",),
    "models": ("model", "write_models"),
    "report": ("html",),
}
KINDS: Final = {
    "attitude_bias": ("attitude",),
    "attitude_spline": ("spline",),
    "attitude_process": ("fused_attitude", "process"),
    "mounting": ("camera_mounting", "boresight"),
    "orbit": ("orbit_offset", "position", "ephemeris"),
    "time_offset": ("time", "timing"),
    "look_angles": ("look_angle", "look", "camera"),
    "image_bias": ("rpc_bias", "bias", "image_shift", "image"),
}
"""Kinds of unknowns, with their other names."""
DEGREES: Final = {"constant": 0, "shift": 0, "linear": 1, "affine": 1, "quadratic": 2}
