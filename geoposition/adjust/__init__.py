"""Adjustment of image geometry: attitude biases and their kin from control and tie points."""

from geoposition.adjust.adjustment import (
    Adjustment,
    PointResults,
    Rejection,
    Status,
    WeakCombination,
)
from geoposition.adjust.attitude_prior import attitude_process
from geoposition.adjust.control import (
    HeightControl,
    selected_control,
    split_control,
    terrain_heights,
)
from geoposition.adjust.diagnose import Finding, diagnose, explain_rejections
from geoposition.adjust.planning import Plan, best_layout, measured_without_error, predict
from geoposition.adjust.robust import RobustOptions
from geoposition.adjust.run import adjust, adjusted_models
from geoposition.adjust.unknowns import (
    Block,
    attitude_bias,
    attitude_spline,
    image_bias,
    look_angles,
    mounting,
    orbit,
    time_offset,
)

__all__ = [
    "Adjustment",
    "Block",
    "Finding",
    "HeightControl",
    "Plan",
    "PointResults",
    "Rejection",
    "RobustOptions",
    "Status",
    "WeakCombination",
    "adjust",
    "adjusted_models",
    "attitude_bias",
    "attitude_process",
    "attitude_spline",
    "best_layout",
    "diagnose",
    "explain_rejections",
    "image_bias",
    "look_angles",
    "measured_without_error",
    "mounting",
    "orbit",
    "predict",
    "selected_control",
    "split_control",
    "terrain_heights",
    "time_offset",
]
