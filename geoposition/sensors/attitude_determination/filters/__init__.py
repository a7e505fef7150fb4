"""Estimates from the past: extended and unscented Kalman filter, complementary filter."""
