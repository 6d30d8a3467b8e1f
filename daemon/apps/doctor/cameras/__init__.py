"""Checks of cameras, and of the libraries, buses and permissions that they need."""
