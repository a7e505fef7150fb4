"""The demonstration: a simulated three-line scene's files and report."""
