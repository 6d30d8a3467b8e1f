"""Multi-frame modes in the daemon: several pictures shown one after the other make one cloud."""
