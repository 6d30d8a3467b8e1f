"""Measuring modes of several images, for scenes at rest or slow ones."""
