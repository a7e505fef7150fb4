"""usgscsm, the C++ reference of the community sensor model: cannot be had from PyPI."""

from geoposition.scripts.bench.measure import Missing

MISSING = Missing("usgscsm", "not on PyPI: a C++ library, packaged for conda only")
