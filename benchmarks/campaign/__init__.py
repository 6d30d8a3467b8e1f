"""Hundreds of random faults against a whole rig: survival, losses and recovery times."""
