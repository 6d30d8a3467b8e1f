"""Calibration drift monitor: whether the calibration still fits the rig, from the ordinary pairs."""
