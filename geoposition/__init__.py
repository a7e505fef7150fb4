"""geoposition: where each pixel of a push-broom image is on the ground, and how well.

The ground's side of the house: time, frames, models, location, intersection, products. It
knows no mission. `geoposition.sensors` is the satellite's side (cameras and readers),
`geoposition.calib_fields` is known ground, `geoposition.scripts` is the command line.
Conventions (frames, units, pixel origin, quaternion order) are in CONVENTIONS.md.
"""

__version__ = "0.1.0"
