"""Sub-pixel localisation of detected marks."""
