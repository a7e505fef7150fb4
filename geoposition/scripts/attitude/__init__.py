"""Attitude from telemetry to fused curves: inputs, checks, fusion, jitter, reports."""
