"""The rigorous push-broom model: tables, kernels, and the model around them."""

from geoposition.pushbroom.model import PushbroomModel

__all__ = ["PushbroomModel"]
