"""Image files of calibration views, read within limits."""
