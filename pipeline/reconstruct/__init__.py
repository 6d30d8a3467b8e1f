"""The single shot: all stages in order, from a pair of raw images to a cloud."""
