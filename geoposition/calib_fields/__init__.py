"""Known ground: calibration fields, evaluation against them."""
