"""A calibration board as a PDF page, to scale."""
