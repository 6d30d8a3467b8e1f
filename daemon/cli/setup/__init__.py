"""Commands that set up a machine and a rig, and check them."""
