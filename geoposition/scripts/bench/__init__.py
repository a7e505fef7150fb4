"""Benchmarks beside peers, side by side in one run."""
