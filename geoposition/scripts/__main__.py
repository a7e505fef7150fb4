"""`python -m geoposition.scripts` is the command line."""

from geoposition.scripts.cli import main

main()
