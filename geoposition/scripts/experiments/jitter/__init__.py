"""P's experiment on known ground: telemetry, fusion, steady images, accuracy; tables 1 and 2."""
