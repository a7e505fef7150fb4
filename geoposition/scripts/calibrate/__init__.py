"""A camera calibrated on known ground: run, summary, report."""
