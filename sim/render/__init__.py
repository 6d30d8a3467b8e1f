"""Rendering: projector light, surfaces, lens, sensor, and the ground truth."""
