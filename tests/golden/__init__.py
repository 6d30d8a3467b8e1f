"""A small take of the simulated rig with the figures that its replay must give."""
