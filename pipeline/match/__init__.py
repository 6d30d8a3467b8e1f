"""The match along the epipolar line to fractions of a pixel, and its result."""
