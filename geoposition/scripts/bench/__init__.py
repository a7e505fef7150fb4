"""Benchmarks beside peers: `python -m geoposition.scripts.bench`."""
