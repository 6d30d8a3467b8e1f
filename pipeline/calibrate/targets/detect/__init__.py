"""Detection and numbering of marks in an image."""
