"""From the marks of all views to calibration.yaml: solution, checks, report and file."""
