"""The measurement under load."""
