"""How the daemon and its calibration fare."""
