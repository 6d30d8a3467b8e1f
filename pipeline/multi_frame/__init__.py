"""Measuring modes of several pictures, for scenes at rest or slow ones, on the rig of the single shot."""
