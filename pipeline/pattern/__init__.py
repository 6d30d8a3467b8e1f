"""What is projected: the colour fringe, frames, and sequences of them."""
