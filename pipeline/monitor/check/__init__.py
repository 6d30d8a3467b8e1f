"""The check of every pair against the calibration, by fixed limits."""
