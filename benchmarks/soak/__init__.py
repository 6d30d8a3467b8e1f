"""A long run of the daemon."""
