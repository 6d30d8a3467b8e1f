"""The report of a calibration: one HTML file that needs nothing else, neither scripts nor other files."""
