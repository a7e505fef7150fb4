"""What errors of orbit, attitude, time, height and image do on the ground, in closed form."""

from geoposition.error_budget.budget import Budget, BudgetLine, image_budget, pair_budget
from geoposition.error_budget.image_scale import ImageScale, image_scale_at
from geoposition.error_budget.influence import Influence, influence
from geoposition.error_budget.model_error import ModelError, image_error_covariance
from geoposition.error_budget.pair import intersection_gains

__all__ = [
    "Budget",
    "BudgetLine",
    "ImageScale",
    "Influence",
    "ModelError",
    "image_budget",
    "image_error_covariance",
    "image_scale_at",
    "influence",
    "intersection_gains",
    "pair_budget",
]
