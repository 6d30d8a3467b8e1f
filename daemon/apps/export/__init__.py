"""Clouds for other programs: PLY, PCD, videos of depth maps."""
