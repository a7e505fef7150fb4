"""How noisy stars and gyro are, from the data."""
