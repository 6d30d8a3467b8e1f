"""Simulated rigs: layout, optics, disturbances, files."""
