"""The satellite's side: cameras, instruments, readers."""
