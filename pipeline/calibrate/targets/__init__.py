"""Calibration targets: what is printed on them, and where their marks are in an image."""
