"""Hundreds of random faults against a whole rig: what survives, what is lost, how soon it is well again."""
