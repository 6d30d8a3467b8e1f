"""Calibration of a rig from what was detected in images, and its check and correction."""
