"""An image's accuracy on known ground: settings, run, report."""
