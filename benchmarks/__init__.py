"""History of our own speed, for asv."""
