"""Checks of a rig: its file, calibration, exposure timing and display."""
