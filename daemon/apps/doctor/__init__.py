"""Checks of a machine and a rig, one area after the other; never imported by the measuring daemon."""
