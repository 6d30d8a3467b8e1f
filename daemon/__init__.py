"""The daemon composes everything: cameras, pairing, pipeline, sinks, control, and the command line."""

DISTRIBUTION = "fringed-rig"
"""Distinguishes this package from others of the name; see ``fringed.__main__``."""
