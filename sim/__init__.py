"""A rig made of light and arithmetic: the drivers' protocols on rendered pictures, with the truth beside them."""
