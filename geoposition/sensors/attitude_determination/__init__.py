"""From star-sensor and gyro telemetry to the fused attitude, its covariance and its jitter."""
