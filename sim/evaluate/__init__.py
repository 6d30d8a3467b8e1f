"""Measured against the truth."""
