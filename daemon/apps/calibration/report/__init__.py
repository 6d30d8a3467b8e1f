"""The report of a calibration: one HTML file without scripts or external files."""
