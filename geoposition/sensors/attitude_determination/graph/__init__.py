"""The batch estimate: a factor graph of stars, gyro and their constants."""
