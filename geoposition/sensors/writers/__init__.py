"""Writers of camera models: CSM states and the toolkit's own model files."""
