"""Decoding compiled: rows, windows and what is fitted in them."""
