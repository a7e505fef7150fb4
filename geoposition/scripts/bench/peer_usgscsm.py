"""usgscsm, the C++ reference of the community sensor model: pip cannot have it."""

from geoposition.scripts.bench.measure import Missing

MISSING = Missing("usgscsm", "packaged for conda only: neither on PyPI nor in Debian")
