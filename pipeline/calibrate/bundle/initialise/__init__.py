"""First values for the adjustment: single devices, relative poses, the board's symmetry."""
