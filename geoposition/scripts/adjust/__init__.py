"""Adjustment of a run: control, ties and models in, adjusted models, tables and report out."""
