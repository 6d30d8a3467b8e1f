"""The adjustment itself: parameters, observations, their projection, solver and uncertainty."""
