"""Accuracy of calibrations, and the detection of wrong ones."""
