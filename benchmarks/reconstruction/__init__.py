"""Speed, scale and accuracy of the reconstruction, and of other programs on the same images."""
