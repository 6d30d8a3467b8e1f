"""A rig made of light and arithmetic: the drivers' protocols on rendered images, with the truth beside them."""
