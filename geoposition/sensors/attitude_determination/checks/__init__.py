"""Telemetry before it is used: cleaning, axis angles, the gyro against the stars, conventions."""
