"""Connected surfaces, tested as a whole: texture, projector, size, surroundings."""
