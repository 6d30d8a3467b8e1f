"""The pieces of the point-cloud stream on the daemon's side."""
