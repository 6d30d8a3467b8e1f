"""Cases, speed and scale of the reconstruction, and other programs on the same images."""
