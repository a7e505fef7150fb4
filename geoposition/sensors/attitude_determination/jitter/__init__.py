"""Vibrations of the attitude: frequency, amplitude, phase."""
