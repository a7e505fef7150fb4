"""One module per command: arguments to library to files."""
