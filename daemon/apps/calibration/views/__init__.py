"""Views for a calibration: opened from folders and takes, and the marks detected in them."""
