"""Calibration boards as scenes, and calibration sessions rendered from them."""
