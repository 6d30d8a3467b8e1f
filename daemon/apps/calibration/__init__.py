"""Calibration from images: sources of views, the solved rig's file and report, other programs' formats."""
