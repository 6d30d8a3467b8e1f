"""A rig made of light and arithmetic: it implements the drivers' protocols on rendered pictures, and knows the truth."""
