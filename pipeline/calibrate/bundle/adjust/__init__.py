"""The adjustment: parameters, observations, their projection, solver and uncertainty."""
