"""The point-cloud stream, on the daemon's side."""
