"""The error family: every refusal is a `GeopositionError` that also is the builtin one expects.

Misuse and unusable input raise; an expected miss of one point (horizon, nodata, outside the
scene) is NaN plus a `Flag` and never raises.
"""

from __future__ import annotations

from os import PathLike
from typing import Final

_LONGEST: Final = 600
"""Characters of a message: enough for a path and a reason, not for a file's own text."""


class GeopositionError(Exception):
    """Root of all errors raised on purpose; the message is one line, fit for a user."""


class ArgumentError(GeopositionError, ValueError):
    """An argument has the wrong shape, range or unit."""


class SpanError(GeopositionError, ValueError):
    """A time or line lies outside the span of an interpolant, which never extrapolates."""

    def __init__(self, what: str, requested: tuple[float, float], span: tuple[float, float]):
        self.requested = requested
        self.span = span
        super().__init__(
            f"{what}: {requested[0]:.6f} .. {requested[1]:.6f} s asked, "
            f"outside the span {span[0]:.6f} .. {span[1]:.6f} s"
        )


class EarthOrientationError(GeopositionError, ValueError):
    """An epoch lies outside the Earth-orientation tables."""


class ConvergenceError(GeopositionError, ArithmeticError):
    """An iteration that must converge did not."""


class GeometryError(GeopositionError, ValueError):
    """The geometry cannot answer: nothing overlaps, nothing is seen, rays are parallel."""


class ProductError(GeopositionError, ValueError):
    """A file cannot be used; names the file, the place in it and what was expected."""

    def __init__(self, path: str | PathLike[str], place: str, expected: str):
        self.path = str(path)
        self.place = place
        self.expected = expected
        where = f"{self.path}: {place}" if place else self.path
        line = " ".join(f"{where}: {expected}".split())
        super().__init__(line if len(line) <= _LONGEST else f"{line[: _LONGEST - 1]}…")


class MissingFileError(ProductError, FileNotFoundError):
    """A file that was asked for is not there."""


class UnsupportedError(ProductError):
    """A file is recognised, and it is of a kind that cannot be used."""
