"""Intersection of image pairs: points, bias, checks against references, report."""
