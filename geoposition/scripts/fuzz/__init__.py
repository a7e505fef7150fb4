"""Hostile files by the million: every reader, and the command line, against mutated inputs.

`python -m geoposition.scripts.fuzz --data ../shared/real` runs a campaign; see `--help`.
"""
