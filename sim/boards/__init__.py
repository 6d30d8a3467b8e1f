"""Calibration boards as scenes: views of them rendered for a session."""
