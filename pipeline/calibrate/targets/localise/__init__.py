"""Detected marks localised to fractions of a pixel."""
