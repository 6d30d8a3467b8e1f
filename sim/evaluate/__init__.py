"""Scores of clouds and calibrations against the truth."""
