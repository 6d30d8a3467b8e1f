"""From the marks of all views to calibration.yaml: solved, checked, written, the old one kept."""
