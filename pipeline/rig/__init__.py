"""The rig's model: cameras, calibration, lateral chromatic aberration."""
