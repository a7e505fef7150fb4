"""Spectra, the lines in them, and filters without a phase."""
