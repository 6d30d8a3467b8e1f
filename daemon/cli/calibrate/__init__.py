"""``fringed calibrate`` and its commands."""
