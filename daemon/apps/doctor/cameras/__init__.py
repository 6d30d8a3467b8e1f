"""Checks of cameras, and of the libraries, buses and rights that they need."""
