"""Projected patterns: the colour fringe, frames, and sequences of them."""
