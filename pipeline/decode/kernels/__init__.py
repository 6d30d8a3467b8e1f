"""Compiled decoding: rows, windows and the fits in them."""
