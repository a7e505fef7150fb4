"""Steady-state re-imaging of a product: inputs, resampling to files, jitter tables, report."""
