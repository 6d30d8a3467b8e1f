"""Marks detected in an image, and numbered."""
