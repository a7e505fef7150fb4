"""Thin: arguments to library to files. The command line, experiments and benchmarks."""
