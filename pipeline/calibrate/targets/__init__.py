"""Calibration targets: their geometry, and the detection of their marks in an image."""
