"""Multi-frame modes in the daemon: several images shown one after the other make one cloud."""
