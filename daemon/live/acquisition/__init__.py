"""From the cameras' frames to pairs, and to sets of pairs."""
