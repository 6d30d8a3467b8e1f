"""The rig's devices opened, and its files read: calibration.yaml and pattern.json."""
