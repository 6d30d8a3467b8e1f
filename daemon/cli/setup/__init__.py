"""Commands that set up and check a machine and a rig."""
