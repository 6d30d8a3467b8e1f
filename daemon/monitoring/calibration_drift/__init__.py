"""The continuous self-check: does the calibration still fit the rig? Told from the pairs that are measured anyway."""
