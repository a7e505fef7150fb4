"""Attitude from one epoch: vectors, several heads, means."""
